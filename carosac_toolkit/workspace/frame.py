"""Positions where no cable can pull the platform, whatever its rotation: a proof, no search."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.arrays import Array
from carosac_toolkit.physics.straight_line import straight_length
from carosac_toolkit.robot import Robot


def beyond_frame(robot: Robot, position: Array) -> NDArray[np.bool_]:
    """Whether all exit points lie on one side of the platform so that nothing balances its weight.

    All of them below every anchor point there can be, or all of them on one side of a vertical
    plane, for any rotation. A hanging cable pulls into the vertical plane of its ends and lower
    than its chord, so this holds with sag as well.

    Args:
        robot: Robot description.
        position: Platform origin in W [m], shape (B, 3).

    Returns:
        Shape (B,).
    """
    from scipy.spatial import ConvexHull, QhullError

    reach = float(np.linalg.norm(robot.anchor_points, axis=1).max())
    reach += 2.0 * float(robot.pulley_radius.max())
    beyond = position[:, 2] > robot.exit_points[:, 2].max() + reach
    try:
        sides = ConvexHull(robot.exit_points[:, :2]).equations
    except (QhullError, ValueError):  # exit points above one line
        return beyond
    distance = position[:, :2] @ sides[:, :2].T + sides[:, 2]
    return beyond | (distance.max(axis=1) > reach)


def without_cable(robot: Robot, position: Array, rotation: Array | None) -> NDArray[np.bool_]:
    """Whether an anchor point is on its exit point or inside its pulley, shape (B,)."""
    cables = straight_length(robot, position, rotation)
    return ~(cables.valid & (cables.length > 1e-6)).all(axis=1)
