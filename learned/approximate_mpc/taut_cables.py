"""Tensions whose forces add up to nothing, by which weak cables are pulled taut.

A platform on more than three cables rests at one place in many attitudes, each with other tensions.
MPC holds none of these against another for long, and small errors of a plan wander among them until
a cable is slack. Such tensions turn the platform slowly to where its cables pull more alike.

References:
    Pott, *Cable-Driven Parallel Robots*, Springer, 2018 (tensions in the null space).
"""

from __future__ import annotations

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot

MARGIN = 0.17  # over the least tension, in the weight per cable: below it a cable is weak
GAIN = 0.5  # of what weak cables miss: that is gained in the time in which tensions are usual
SHARE_MIN = 1e-2  # of what weak cables miss: cables that can hardly gain more are left alone


class TautCables:
    """Tells tensions to add to those of a plan."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._wanted = robot.tension_min + MARGIN * robot.weight / robot.n

    def push(self, position: Array, rotation: Array, usual: Array) -> Array | None:
        """Return the tensions to add [N], shape (n,); None: nothing.

        Cables that are not weak do not become so.

        Args:
            position: Of the platform in W [m], shape (3,).
            rotation: From P to W, shape (3, 3).
            usual: Tensions of the last half second [N], shape (n,).
        """
        more = usual - self._wanted
        if more.min() >= 0.0:
            return None
        robot = self._robot
        chord = robot.exit_points - position - robot.anchor_points @ rotation.T
        along = chord / np.linalg.norm(chord, axis=1)[:, None]
        missing = np.maximum(-more, 0.0)
        push = missing - along @ np.linalg.lstsq(along, missing, rcond=None)[0]
        gained, square = float(missing @ push), float(missing @ missing)
        if gained <= SHARE_MIN * square:
            return None
        push *= GAIN * square / gained
        falls = push < 0.0
        room = np.maximum(more[falls], 0.0) / -push[falls]
        return np.asarray(min(1.0, room.min(initial=1.0)) * push)
