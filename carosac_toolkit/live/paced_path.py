"""A path in real time: one period further a cycle, and slow while its first way is watched."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.loop import ReferenceSource
from carosac_toolkit.loop.values import Reference

RISE_SHARE = 0.25  # of the time to full speed, in which acceleration rises after a slow start
FREE_RATIO = 20.0  # of a speed limit to the path's speed, at which it limits by 2 in a million
SHARPNESS = 4  # of the smooth minimum of both speeds


class PacedPath:
    """Path whose time passes by cycles, not by the clock, and slower at first if it has to.

    Commands are played back one a period. A reference by the clock would have the jitter of each
    cycle in it, and a leap where a cycle was missed; both are accelerations that nobody asked for.
    Here each cycle goes on where the last one was, so that a missed one delays the rest.

    Attributes:
        duration: Duration of the path [s], at most: it ends where `past_end` says so.
    """

    def __init__(
        self, path: ReferenceSource, *, slow: Callable[[], bool] | None = None,
        slow_speed: float = np.inf, speed: float = 1.0, acceleration: float = 1.0,
    ) -> None:  # fmt: skip
        """Follow a path.

        Args:
            path: The path.
            slow: Whether the platform is to move slowly now, asked each cycle until it says no, at
                the first cycle for never; None: never.
            slow_speed: Largest speed of the platform meanwhile [m/s].
            speed: Largest speed on the path [m/s].
            acceleration: Largest acceleration of the change to it [m/s^2].
        """
        self._path, self._slow = path, slow
        self._slow_speed, self._acceleration = slow_speed, acceleration
        self._rise_time = RISE_SHARE * speed / acceleration
        self.duration = path.duration
        if slow is not None:  # it may stay within the slow way to its end
            self.duration *= 1.0 + speed / slow_speed
        self._time: float | None = None
        self._done = 0.0  # of the path's time
        self._rate: float | None = None  # of it
        self._free_time = 0.0  # since the slow way was over
        self._pace = 0.0  # of the path by its own time [m/s]

    @property
    def past_end(self) -> float:
        """Time since the end of the path, by the path's own time [s]; below 0 on it."""
        return self._done - self._path.duration

    def window(self, time: float, horizon: float, period: float) -> Reference:
        """Return the reference of the next cycle; see `Trajectory.window`.

        The same time once more gives the same reference once more.
        """
        new = self._time is None or time > self._time
        rate = self._next_rate(period) if new else self._rate
        assert rate is not None
        if self._time is not None and new:
            self._done += rate * period
        change = 0.0 if self._rate is None else (rate - self._rate) / period
        self._time, self._rate = time, rate
        ahead = self._path.window(self._done, rate * horizon, rate * period)
        self._pace = float(np.linalg.norm(ahead.velocity[0, 0]))
        times: Array = time + (ahead.time - ahead.time[:, :1]) / rate
        return Reference(
            time=times, position=ahead.position, velocity=rate * ahead.velocity,
            acceleration=rate**2 * ahead.acceleration + change * ahead.velocity,
            rotation=ahead.rotation,
        )  # fmt: skip

    def _next_rate(self, period: float) -> float:
        """Return how fast the path's time passes in this cycle."""
        if self._slow is None or (self._rate is None and not self._slow()):
            self._slow = None
            return 1.0
        if self._free_time > 0.0 or not self._slow():
            self._free_time += period
        free, rise = self._free_time, self._rise_time
        gained = self._acceleration * (free - rise * -np.expm1(-free / rise))
        allowed = self._slow_speed + gained
        if allowed > FREE_RATIO * self._pace and free > FREE_RATIO * rise:
            self._slow = None
            return 1.0
        ratio = self._pace / allowed
        return float((1.0 + ratio**SHARPNESS) ** (-1.0 / SHARPNESS))
