"""A path that is followed slowly until its first centimetres have been watched."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.loop import ReferenceSource
from carosac_toolkit.loop.values import Reference


class SlowStart:
    """Path whose time passes slower while a condition holds: the same places, later.

    Attributes:
        duration: Duration of the path and of the time that a slow start takes at most [s].
    """

    def __init__(
        self, path: ReferenceSource, slow: Callable[[], bool], *, speed: float,
        acceleration: float, duration: float,
    ) -> None:  # fmt: skip
        """Follow a path; `slow` decides each cycle.

        Args:
            path: The path.
            slow: Whether the platform is to move slowly now.
            speed: Largest speed of the platform meanwhile [m/s].
            acceleration: Acceleration to the speed of the path afterwards [m/s^2].
            duration: Duration of all, by the clock of the run [s].
        """
        self._path, self._slow = path, slow
        self._speed, self._acceleration = speed, acceleration
        self.duration = duration
        self._time = self._done = 0.0
        self._rate = 1.0  # of the path's time
        self._pace = 0.0  # of the path by its own time [m/s]

    def window(self, time: float, horizon: float, period: float) -> Reference:
        """Return the reference from `time` on, which must not go back; see `Trajectory.window`."""
        passed = max(0.0, time - self._time)
        pace = max(self._pace, self._speed)
        faster = self._rate + passed * self._acceleration / pace
        self._rate = self._speed / pace if self._slow() else min(1.0, faster)
        self._done += self._rate * passed
        self._time = max(time, self._time)
        rate = self._rate
        ahead = self._path.window(self._done, rate * horizon, rate * period)
        self._pace = float(np.linalg.norm(ahead.velocity[0, 0]))
        times: Array = time + (ahead.time - ahead.time[:, :1]) / rate
        return Reference(
            time=times, position=ahead.position, velocity=rate * ahead.velocity,
            acceleration=rate**2 * ahead.acceleration, rotation=ahead.rotation,
        )  # fmt: skip
