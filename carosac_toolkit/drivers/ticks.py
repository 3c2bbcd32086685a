"""Absolute schedule of wall-clock ticks, one per period, without drift."""

from __future__ import annotations

import math
import time


class TickSchedule:
    """Absolute schedule of ticks; missed ones are counted and not made up.

    Attributes:
        origin: Start time, by `time.monotonic` [s].
        missed: Ticks that passed outside `wait`.
    """

    def __init__(self, period: float, *, forgiving: bool = False) -> None:
        """Begin now.

        Args:
            period: Between two ticks [s].
            forgiving: True if no tick counts as missed before the first wait.
        """
        self._period, self._forgiving = period, forgiving
        self.origin = time.monotonic()
        self._ticks = 0
        self.missed = 0

    @property
    def elapsed(self) -> float:
        """Since the start [s]."""
        return time.monotonic() - self.origin

    def since(self, moment: float) -> float:
        """Return the time from the start to `moment` [s], which is by `time.monotonic` [s]."""
        return moment - self.origin

    def wait(self) -> None:
        """Sleep until the next tick."""
        elapsed = self.elapsed
        first = self._ticks == 0
        self._ticks += 1
        passed = max(0, math.ceil(elapsed / self._period) - self._ticks)
        self._ticks += passed
        if not (first and self._forgiving):
            self.missed += passed
        time.sleep(max(0.0, self._ticks * self._period - elapsed))
