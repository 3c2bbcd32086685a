"""Whether the platform bounces on its cables, so that they go slack in turn.

The energy of a bounce is in the platform's motion against the winches and, a quarter of a period
later, in a stretch that no plan has asked for. What a belief has of one alone is its own error, as
on small stiff robots, or something of the plant.
"""

from __future__ import annotations

import numpy as np

from baselines.mpc.length_offsets import OFFSET_TIME
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

# Energy of a bounce, over that of the usual stretch, chosen on drawn robots: with several times as
# much, cables go slack in turn.
BOUNCE_MAX = 0.7


class BounceGuard:
    """Compares both energies with that which cables of the usual tensions hold by their stretch."""

    def __init__(self, robot: Robot, period: float) -> None:
        """Take the robot of n cables and the time between two commands [s]."""
        self._robot = robot
        self._share = period / OFFSET_TIME.of(Scales(robot).ratios)
        self.reset()

    def reset(self) -> None:
        """Forget all energies, and by how much tensions differ from planned ones."""
        self._lately: Array = np.zeros(2)
        self._lasting: Array | None = None

    def bounce(
        self, motion: float, free: Array, tension: Array | None, planned: Array, usual: Array
    ) -> float:
        """Return the energy that has lately been in motion as well as in stretch, over the usual.

        What was in each fades within half a second or so: the more it was, the longer it counts.
        Tensions that differ from planned ones in the long run are of the plant, and do not count.

        Args:
            motion: Energy of the platform's motion against the winches [J].
            free: Straight free lengths [m], shape (n,).
            tension: Believed ones [N], shape (n,); without any, or with some that are not finite,
                motion alone counts, now.
            planned: Tensions that were planned for now [N], shape (n,).
            usual: Of the last half second [N], shape (n,).
        """
        softness = (free + self._robot.run_length) / self._robot.axial_stiffness
        held = _stretch_energy(softness, usual)
        if tension is None or not np.isfinite(tension).all():
            return motion / held
        missed = tension - planned
        lasting = missed if self._lasting is None else self._lasting
        sudden = missed - lasting
        self._lasting = lasting + self._share * sudden
        now = np.array([motion, _stretch_energy(softness, sudden)]) / held
        left = (1.0 - self._share) * self._lately
        self._lately = np.maximum(left, now)
        return float(self._lately.min())


def _stretch_energy(softness: Array, tension: Array) -> float:
    """Return what cables hold by their stretch [J].

    Args:
        softness: Stretch per tension [m/N], shape (n,).
        tension: [N], shape (n,).
    """
    return 0.5 * float(softness @ tension**2)
