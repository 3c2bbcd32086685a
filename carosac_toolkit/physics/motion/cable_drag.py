"""Air drag of cables."""

from __future__ import annotations

import numpy as np

from carosac_toolkit.physics.scales import (
    CAROSAC_GRAVITY_M_PER_S2,
    CAROSAC_WORKSPACE_M,
    Scales,
)
from carosac_toolkit.robot.robot import Robot

CAROSAC_CABLE_DRAG_PER_S = 0.5  # of ``carosac``, per mass


def cable_drag_of(robot: Robot) -> float:
    """Return the air drag of the cables per mass [1/s].

    Where it is unknown, it is less for a larger robot, and goes by the workspace, which is the same
    for a robot and all plants drawn from it.
    """
    if robot.cable_drag is not None:
        return robot.cable_drag
    length = Scales(robot).workspace / CAROSAC_WORKSPACE_M
    gravity = robot.gravity / CAROSAC_GRAVITY_M_PER_S2
    return float(CAROSAC_CABLE_DRAG_PER_S / np.sqrt(length / gravity))
