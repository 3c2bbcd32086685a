"""Sizes of a robot of which the errors of its plants are parts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from carosac_toolkit.robot.robot import Robot

CAROSAC_SIZES = {  # of the robot `carosac`, where a part has a known value in SI units
    "frame": 6.955827729166207, "platform": 0.29718849237478895, "weight": 232.05555,
    "cable": 9.141812876044355, "time": 0.9653430184797842,
}  # fmt: skip
SURFACE_CABLES = 2  # so many cables hold a platform on a surface, more of them in a volume


def frame_size(robot: Robot) -> float:
    """Return the root mean square distance of the exit points from their centre [m]."""
    apart = robot.exit_points - robot.exit_points.mean(axis=0)
    return float(np.sqrt((apart**2).sum(axis=1).mean()))


def platform_size(robot: Robot) -> float:
    """Return the largest distance of an anchor point or the centre of mass from the origin [m]."""
    points = np.vstack([robot.anchor_points, robot.center_of_mass[None]])
    return float(np.sqrt((points**2).sum(axis=1).max()))


def cable_size(robot: Robot) -> float:
    """Return the mean distance from exit to anchor points at home [m]."""
    anchors = robot.home_position + robot.anchor_points @ robot.home_rotation.T
    return float(np.linalg.norm(robot.exit_points - anchors, axis=1).mean())


def time_scale(robot: Robot) -> float:
    """Return the time in which a body falls by half of `cable_size` [s]."""
    return float(np.sqrt(cable_size(robot) / robot.gravity))


SIZES: Mapping[str, tuple[str, Callable[[Robot], float]]] = {
    "frame": ("m", frame_size),
    "platform": ("m", platform_size),
    "cable": ("m", cable_size),
    "weight": ("N", lambda robot: robot.weight),
    "time": ("s", time_scale),
}


@dataclass(frozen=True)
class Part:
    """A quantity that is proportional to a size of a robot.

    Attributes:
        amount: Its value on a robot whose size is `at` [SI]; with `at` 1, the share of the size.
        size: A key of `SIZES`.
        at: That size [SI].
    """

    amount: float
    size: str
    at: float = 1.0

    def of(self, robot: Robot) -> float:
        """Return the quantity for a robot [SI]."""
        return self.amount * (SIZES[self.size][1](robot) / self.at)
