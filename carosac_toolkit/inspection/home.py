"""A robot at its home position: its description, its equilibrium and what follows from both."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot

if TYPE_CHECKING:
    from carosac_toolkit.physics.cable.straight_line import StraightCables
    from carosac_toolkit.physics.rest.statics import Equilibrium
    from carosac_toolkit.robot.schema import RobotFile

HOME_TILT_MAX_DEG = (
    60.0  # [deg]: a platform that hangs more tilted at home was meant to hang otherwise
)


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotAtHome:
    """Robot at its home position: what its file says and its equilibrium there.

    Attributes:
        robot: The robot.
        equilibrium: Equilibrium at home, B = 1; check `feasible` first.
        shape: Points along each cable at home in W [m], shape (n, samples, 3); straight lines
            where there is no equilibrium.
        sag: Largest distance of each cable to its chord at home [m], shape (n,); NaN where there
            is no equilibrium.
        frequencies: Natural frequencies at home [Hz], slowest first, shape (6,); negative for an
            unstable mode, NaN where there is no equilibrium.
        directions: Main direction of each of these modes, x to yaw; none without an equilibrium.
        straight: Straight cables at home over their pulleys, B = 1.
        wrap: Angle of contact with each pulley at home [rad], shape (n,), of the hanging cable
            where there is an equilibrium, else of the straight one; 0 without a pulley.
        file: The checked robot file, where the robot comes from one; it knows the payloads.
    """

    robot: Robot
    equilibrium: Equilibrium
    shape: Array
    sag: Array
    frequencies: Array
    directions: tuple[str, ...]
    straight: StraightCables
    wrap: Array
    file: RobotFile | None = None

    @property
    def rotation(self) -> Array:
        """Rotation from P to W at home, the nominal one where there is no equilibrium, (3, 3)."""
        home = self.equilibrium
        return home.rotation[0] if home.converged[0] else self.robot.home_rotation

    @property
    def tilt(self) -> float:
        """Angle between the z axes of platform and world at home [rad]."""
        return float(np.arccos(np.clip(self.equilibrium.rotation[0, 2, 2], -1.0, 1.0)))
