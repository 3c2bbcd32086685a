"""Measured lengths that take effect with a delay."""

from __future__ import annotations

from collections import deque

from carosac_toolkit.base.arrays import Array

PIECE_DURATION_MIN_S = 1e-9  # less is rounding


class DelayedLengths:
    """Lengths, interpolated linearly between measurements, `delay` after these."""

    def __init__(self, lengths: Array, delay: float) -> None:
        """Start at rest at the first lengths.

        Args:
            lengths: [m], shape (B, n).
            delay: [s].
        """
        self._delay = delay
        self._measured = 0.0  # time of the newest measurement, since the first [s]
        self._reached = lengths
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
            when, target = self._pending.popleft()
            if when - now > PIECE_DURATION_MIN_S:
                pieces.append((when - now, target))
                now = when
            self._reached = target
        if end - now > PIECE_DURATION_MIN_S:
            when, target = self._pending[0]
            share = (end - now) / (when - now)
            self._reached = self._reached + share * (target - self._reached)
            pieces.append((end - now, self._reached))
        return pieces or [(step, self._reached)]
