"""Measured lengths that take effect with a delay."""

from __future__ import annotations

from collections import deque

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.motion.length_curve import curved_length, is_curved, segment_ends

PIECE_DURATION_MIN_S = 1e-9  # less is rounding


class DelayedLengths:
    """Lengths, interpolated between measurements, `delay` after these.

    Between two measurements that are close together they go straight, else on the parabola through
    the one before as well, in straight segments.
    """

    def __init__(self, lengths: Array, delay: float, segment: float) -> None:
        """Start at rest at the first lengths.

        Args:
            lengths: [m], shape (B, n).
            delay: [s].
            segment: Longest straight one [s].
        """
        self._delay = delay
        self._segment = segment
        self._measured = 0.0  # time of the newest measurement, since the first [s]
        self._reached = lengths
        self._past: deque[tuple[float, Array]] = deque(maxlen=2)  # last two that took effect
        self._pending: deque[tuple[float, Array]] = deque([(delay, lengths)])

    def advance(self, step: float, lengths: Array) -> list[tuple[float, Array]]:
        """Add lengths that were measured `step` after the last ones.

        Args:
            step: [s].
            lengths: [m], shape (B, n).

        Returns:
            Linear pieces from the last measurement to this one: their durations [s], which sum to
            `step`, and the lengths at the end of each [m], shape (B, n).
        """
        now, end = self._measured, self._measured + step
        self._measured = end
        self._pending.append((end + self._delay, lengths))
        pieces: list[tuple[float, Array]] = []
        while self._pending and self._pending[0][0] <= end + PIECE_DURATION_MIN_S:
            when, target = self._pending[0]
            if when - now > PIECE_DURATION_MIN_S:
                pieces += self._pieces(now, when)
                now = when
            self._reached = target
            self._past.append(self._pending.popleft())
        if end - now > PIECE_DURATION_MIN_S:
            pieces += self._pieces(now, end)
        return pieces or [(step, self._reached)]

    def _pieces(self, now: float, end: float) -> list[tuple[float, Array]]:
        """Return the pieces towards the next lengths, from a time to another [s]."""
        when, target = self._pending[0]
        time, length = (
            np.array(column) for column in zip(*self._past, (when, target), strict=True)
        )
        if len(time) == 3 and is_curved(time, self._segment):
            ends = segment_ends(now, end, self._segment)
            reached = [curved_length(time, length, stop) for stop in ends]
        else:
            share = (end - now) / (when - now)
            ends = [end]
            reached = [target if end == when else self._reached + share * (target - self._reached)]
        self._reached = reached[-1]
        return list(zip(np.diff([now, *ends]).tolist(), reached, strict=True))
