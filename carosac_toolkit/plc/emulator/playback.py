"""From commands that come every now and then to a smooth motion by the clock of the PLC."""

from __future__ import annotations

from collections import deque

import numpy as np

from carosac_toolkit.base.arrays import Array

_BEHIND = 1.75  # commands by which the motion is behind the newest one as that arrives
_KEPT = 8  # commands
_SMOOTH = 0.1  # share of a new distance from `_BEHIND` in the mean of the last ones
_STEER, _WARP = 0.05, 0.02  # how much the clock hurries for such a distance, and at most
_LOST = 3.0  # distance above which it is taken away at once
_EXTRA = 1.5  # commands for which the motion goes on straight where none comes


class Playback:
    r"""A quadratic B-spline through the commands, 1.25 to 1.75 periods behind.

    Within a period its acceleration is constant, the second difference of the commands over the
    period squared, so that limits that hold for differences of commands hold for the motion:

    .. math:: s(u) = \tfrac12 (\tfrac12 - u)^2 L_{k-1} + (\tfrac34 - u^2) L_k
              + \tfrac12 (\tfrac12 + u)^2 L_{k+1}, \qquad |u| \le \tfrac12 .

    Commands may come a little early or late; the motion goes by the clock of the PLC, which hurries
    or waits by 2 % at most. Lost commands are taken to lie on a straight line.
    """

    def __init__(self, position: Array) -> None:
        """Stand at positions [unit], shape (n,)."""
        self._points: deque[Array] = deque([np.array(position)] * 3, maxlen=_KEPT)
        self._newest = 0  # number of the last point, from 0 at the start
        self._at = -_BEHIND
        self._period = 1.0
        self._error: float | None = None

    def add(self, length: Array, gap: int, period: float) -> None:
        """Take a command [unit], shape (n,), that is `gap` after the last one; `period` in s."""
        last = self._points[-1]
        first = max(1, gap - _KEPT + 1)
        for k in range(first, gap + 1):
            self._points.append(last + (length - last) * (k / gap))
        self._newest += gap
        self._period = period
        error = self._newest - _BEHIND - self._at
        if self._error is None or abs(error) > _LOST:
            self._at += error
            self._error = error = 0.0
        self._error += _SMOOTH * (error - self._error)

    def advance(self, duration: float) -> tuple[Array, Array]:
        """Let time pass [s].

        Returns:
            Where to be then [unit], and how fast [unit/s], each of shape (n,).
        """
        last = self._newest + _EXTRA
        hurry = 1.0 + float(np.clip(_STEER * (self._error or 0.0), -_WARP, _WARP))
        self._at = min(self._at + hurry * duration / self._period, last)
        k = int(np.floor(self._at + 0.5))
        u = self._at - k
        before, here, after = (self._point(k + i) for i in (-1, 0, 1))
        goal = 0.5 * (0.5 - u) ** 2 * before + (0.75 - u * u) * here + 0.5 * (0.5 + u) ** 2 * after
        rate = ((0.5 + u) * after - 2.0 * u * here - (0.5 - u) * before) / self._period
        return goal, (rate if self._at < last else np.zeros_like(rate))

    def _point(self, number: int) -> Array:
        """A command by its number; the ones to come go on straight."""
        ahead = number - self._newest
        if ahead > 0:
            return self._points[-1] + ahead * (self._points[-1] - self._points[-2])
        return self._points[max(ahead - 1, -len(self._points))]
