"""Sizes of a robot from which everything is derived that depends on its size.

Settings in metres, seconds or newtons that are not stated by the user, by the robot file or as a
property of a sensor come from here, so that a robot on a desk and one over a stadium are treated
alike: scaled by Froude's law, all dimensionless results stay as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from carosac_toolkit.base.scaled import Ratios
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.robot.sizes import CAROSAC_SIZES, cable_size, time_scale

# Of the robot `carosac`, on which defaults are stated (`carosac_toolkit.base.scaled.Scaled`).
CAROSAC_CABLE_M = CAROSAC_SIZES["cable"]
CAROSAC_MASS_KG = 23.655
CAROSAC_WORKSPACE_M = 3.9999999999999996
CAROSAC_GRAVITY_M_PER_S2 = 9.81


@dataclass(frozen=True)
class Scales:
    """Sizes of a robot.

    Attributes:
        robot: Its description, n cables.
    """

    robot: Robot

    @cached_property
    def length(self) -> float:
        """Mean distance from exit to anchor points at home [m]: that of a cable."""
        return cable_size(self.robot)

    @property
    def time(self) -> float:
        """Time in which a body falls by half of `length` [s]; a sway takes 2 pi of it and less."""
        return time_scale(self.robot)

    @property
    def tension(self) -> float:
        """Weight of the platform per cable [N]."""
        return self.robot.weight / self.robot.n

    @property
    def workspace(self) -> float:
        """Geometric mean of the sides of the workspace box [m]."""
        return float(np.prod(self.robot.workspace_max - self.robot.workspace_min) ** (1.0 / 3.0))

    @cached_property
    def ratios(self) -> Ratios:
        """Mass, length and time over those of ``carosac``, by which `Scaled` numbers grow."""
        length = self.length / CAROSAC_CABLE_M
        gravity = self.robot.gravity / CAROSAC_GRAVITY_M_PER_S2
        mass = self.robot.mass / CAROSAC_MASS_KG
        return Ratios(mass, length, float(np.sqrt(length / gravity)))

    def reach(self, delay: ArrayLike) -> float:
        """Return how far a winch winds at full speed within its lag and a delay [s]: [m].

        Args:
            delay: One for all winches, or one each, shape (n,).
        """
        robot = self.robot
        return float((robot.speed_max * (robot.winch_lag + np.asarray(delay))).max())

    def jerk(self, period: float) -> float:
        """Return the change of acceleration that winches can follow [m/s^3].

        It takes them to full acceleration in half their lag, and in a period [s] at the least.
        """
        robot = self.robot
        return float((robot.acceleration_max / np.maximum(0.5 * robot.winch_lag, period)).min())
