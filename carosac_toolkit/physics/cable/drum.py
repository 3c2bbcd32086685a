r"""Drums: from motor angles to lengths of cable, and back.

A drum pays out line from its outermost layer. Line is all that leaves the drum: with a tackle of
mechanical advantage `a` a cable that becomes longer by L takes a L of it. The squared radius falls
by `buildup` per length of line, from `radius` at unstrained length 0, so that at a drum angle
:math:`\varphi`, counted from there, positive paying out,

.. math:: a L = r_0 \varphi - \tfrac{1}{4} b \varphi^2, \qquad r = r_0 - \tfrac{1}{2} b \varphi.

The simulator's winches turn by the same law (`carosac_toolkit.physics.motion.winch_kernels`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.robot.robot import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class Drums:
    """The drums of n cables.

    Attributes:
        radius: At unstrained length 0, all cable wound in [m], shape (n,).
        buildup: Decrease of the squared radius per length of line paid out [m], shape (n,).
        gear: Turns of the motor per turn of the drum, shape (n,).
        advantage: Line paid out per change of the cable's length, shape (n,).
    """

    radius: Array
    buildup: Array
    gear: Array
    advantage: Array

    def length(self, motor_angle: Array) -> Array:
        """Return the unstrained length at a motor angle from length 0 [rad]; shapes (..., n).

        The law ends where the drum is empty, at an angle of 2 radius / buildup of the drum.
        """
        angle = motor_angle / self.gear
        return angle * (self.radius - 0.25 * self.buildup * angle) / self.advantage

    def motor_angle(self, unstrained_length: Array) -> Array:
        """Return the motor angle from length 0 [rad] at a length [m]; shapes (..., n).

        Raises:
            InvalidField: The drum is empty before.
        """
        line = self.advantage * unstrained_length
        left = self.radius**2 - self.buildup * line  # squared radius [m^2]
        if (left <= 0.0).any():
            *_, i = np.unravel_index(int(np.argmin(left)), left.shape)  # the cable
            asked = float(np.broadcast_to(unstrained_length, left.shape)[..., i].max())
            most = self.radius[i] ** 2 / (self.advantage[i] * self.buildup[i])
            allowed = f"less than the drum holds, {most:.6g} m"
            raise InvalidField(f"unstrained_length[{i}]", f"{asked:.6g} m", allowed)
        return self.gear * 2.0 * line / (self.radius + np.sqrt(left))


def drums_of(robot: Robot) -> Drums:
    """Return the drums of a robot.

    Raises:
        InvalidField: The robot file does not say how angle and length belong together.
    """
    for name in ("drum_radius", "drum_buildup", "drum_gear"):
        if getattr(robot, name) is None:
            allowed = "a drum with radius, buildup and gear in each winch of the robot file"
            raise InvalidField(name, f"unknown for robot {robot.name!r}", allowed)
    advantage = np.ones(robot.n) if robot.drum_advantage is None else robot.drum_advantage
    assert robot.drum_radius is not None and robot.drum_buildup is not None
    assert robot.drum_gear is not None
    return Drums(
        radius=robot.drum_radius,
        buildup=robot.drum_buildup,
        gear=robot.drum_gear,
        advantage=advantage,
    )
