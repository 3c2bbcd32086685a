"""Interpolation of periodic commands to a smooth motion by the clock of the PLC."""

from __future__ import annotations

from collections import deque

import numpy as np

from carosac_toolkit.base.arrays import Array

DELAY_COMMANDS = 1.75  # from the motion to the newest command as that arrives
COMMANDS_KEPT = 8  # the spline needs three; the rest bridges jitter
DELAY_SMOOTHING = 0.1  # weight of the newest delay error in its running mean
CLOCK_GAIN, CLOCK_CHANGE_MAX = 0.05, 0.02  # change of clock rate per command of delay error
DELAY_ERROR_MAX_COMMANDS = 3.0  # beyond it the clock is set at once
EXTRAPOLATION_COMMANDS = 1.5  # for which the motion goes on straight if no command comes


class Playback:
    r"""A quadratic B-spline through the commands, 1.25 to 1.75 periods behind.

    Within a period its acceleration is constant, the second difference of the commands over the
    period squared, so that limits that hold for differences of commands hold for the motion:

    .. math:: s(u) = \tfrac12 (\tfrac12 - u)^2 L_{k-1} + (\tfrac34 - u^2) L_k
              + \tfrac12 (\tfrac12 + u)^2 L_{k+1}, \qquad |u| \le \tfrac12 .

    Commands may come a little early or late; the motion goes by the clock of the PLC, sped up or
    slowed down by 2 % at most. Lost commands are interpolated linearly. Without new commands the
    motion goes on straight until `ended`; commands that come later set the clock at once.
    """

    def __init__(self, position: Array) -> None:
        """Start at rest at positions [unit], shape (n,)."""
        self._points: deque[Array] = deque([np.array(position)] * 3, maxlen=COMMANDS_KEPT)
        self._newest = 0  # number of the last point, from 0 at the start
        self._at = -DELAY_COMMANDS
        self._period = 1.0
        self._error: float | None = None

    def add(self, length: Array, gap: int, period: float) -> None:
        """Take a command [unit], shape (n,), that is `gap` after the last one; `period` in s."""
        late = self.ended
        last = self._points[-1]
        first = max(1, gap - COMMANDS_KEPT + 1)
        for k in range(first, gap + 1):
            self._points.append(last + (length - last) * (k / gap))
        self._newest += gap
        self._period = period
        error = self._newest - DELAY_COMMANDS - self._at
        if late or self._error is None or abs(error) > DELAY_ERROR_MAX_COMMANDS:
            self._at += error
            self._error = error = 0.0
        self._error += DELAY_SMOOTHING * (error - self._error)

    @property
    def ended(self) -> bool:
        """True if the commands have run out: the motion is `EXTRAPOLATION_COMMANDS` beyond them."""
        return self._at >= self._newest + EXTRAPOLATION_COMMANDS

    def advance(self, duration: float) -> tuple[Array, Array]:
        """Advance by a duration [s].

        Returns:
            Positions then [unit] and velocities [unit/s], each of shape (n,).
        """
        clock_rate = 1.0 + float(
            np.clip(CLOCK_GAIN * (self._error or 0.0), -CLOCK_CHANGE_MAX, CLOCK_CHANGE_MAX)
        )
        self._at += clock_rate * duration / self._period
        k = int(np.floor(self._at + 0.5))
        u = self._at - k
        before, here, after = (self._point(k + i) for i in (-1, 0, 1))
        goal = 0.5 * (0.5 - u) ** 2 * before + (0.75 - u * u) * here + 0.5 * (0.5 + u) ** 2 * after
        rate = ((0.5 + u) * after - 2.0 * u * here - (0.5 - u) * before) / self._period
        return goal, rate

    def _point(self, number: int) -> Array:
        """Return a command by its number, extrapolated beyond the newest one."""
        ahead = number - self._newest
        if ahead > 0:
            return self._points[-1] + ahead * (self._points[-1] - self._points[-2])
        return self._points[max(ahead - 1, -len(self._points))]
