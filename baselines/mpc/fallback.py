"""The safe end: rest near where the platform is."""

from __future__ import annotations

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

REST_APPROACH_RATE = Scaled(2.0, "Hz")  # at which the lengths approach those of rest
ACCELERATION_SHARE_MAX = 0.5  # of the winches' acceleration that is used
SPEED_SHARE_MAX = 0.2  # of their speed
REST_DISTANCE_MAX = Scaled(3.0, "m")  # equilibrium lengths that are farther away are not near


class RestFallback:
    """Leads the lengths to those of the catenary equilibrium at the position first believed."""

    def __init__(self, robot: Robot) -> None:
        self._robot, ratios = robot, Scales(robot).ratios
        self._rate, self._far = REST_APPROACH_RATE.of(ratios), REST_DISTANCE_MAX.of(ratios)
        self.reset()

    def reset(self) -> None:
        """Forget where."""
        self._asked = False
        self._goal: Array | None = None

    def acceleration(
        self, position: Array, length: Array, rate: Array, offset: Array
    ) -> tuple[Array, bool]:
        """Return the acceleration of the lengths now, critically damped and limited.

        Args:
            position: Platform origin in W last believed [m], shape (3,); its first value since
                `reset`, moved into the workspace box, is where the platform comes to rest.
            length: Of the winches now [m], shape (n,).
            rate: [m/s], shape (n,).
            offset: Of lengths sent to modelled ones [m], shape (n,).

        Returns:
            Shape (n,) [m/s^2], and whether equilibrium lengths were found nearby; else the winches
            brake to a stop where they are.
        """
        if not self._asked:
            self._asked = True
            self._goal = self._rest_near(position, length, offset)
        most = ACCELERATION_SHARE_MAX * self._robot.acceleration_max
        if self._goal is None:
            wanted = -self._rate * self._rate * rate
        else:
            fastest = SPEED_SHARE_MAX * self._robot.speed_max
            slow = np.clip(self._rate * (self._goal - length), -fastest, fastest)
            wanted = 2.0 * self._rate * (slow - rate)
        return np.clip(wanted, -most, most), self._goal is not None

    def _rest_near(self, position: Array, length: Array, offset: Array) -> Array | None:
        """Return the equilibrium lengths, if there are any within reach."""
        robot = self._robot
        inside = np.clip(position, robot.workspace_min, robot.workspace_max)
        rest = statics.inverse_kinematics(robot, inside[None])
        if not (rest.converged[0] and rest.in_winch_range[0].all()):
            return None
        goal = rest.unstrained_length[0] + offset
        return goal if np.abs(goal - length).max() < self._far else None
