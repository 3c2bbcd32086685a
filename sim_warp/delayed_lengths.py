"""Measured lengths that count some time after they were measured."""

from __future__ import annotations

from collections import deque

from carosac_toolkit.base.arrays import Array

SHORTEST = 1e-9  # [s]: less is rounding


class DelayedLengths:
    """Lengths that go straight from one measurement to the next, seen `delay` later."""

    def __init__(self, lengths: Array, delay: float) -> None:
        """Start at rest at the first lengths.

        Args:
            lengths: [m], shape (B, n).
            delay: [s].
        """
        self._delay = delay
        self._measured = 0.0  # when the newest lengths were measured, since the first [s]
        self._reached = lengths
        self._ahead: deque[tuple[float, Array]] = deque([(delay, lengths)])

    def advance(self, step: float, lengths: Array) -> list[tuple[float, Array]]:
        """Take lengths that were measured `step` after the last ones.

        Args:
            step: [s].
            lengths: [m], shape (B, n).

        Returns:
            The path from the measurement before to this one: durations [s], together `step`, and
            the lengths at the end of each [m], shape (B, n), between which they go straight.
        """
        now, end = self._measured, self._measured + step
        self._measured = end
        self._ahead.append((end + self._delay, lengths))
        pieces: list[tuple[float, Array]] = []
        while self._ahead and self._ahead[0][0] <= end + SHORTEST:
            when, target = self._ahead.popleft()
            if when - now > SHORTEST:
                pieces.append((when - now, target))
                now = when
            self._reached = target
        if end - now > SHORTEST:
            when, target = self._ahead[0]
            share = (end - now) / (when - now)
            self._reached = self._reached + share * (target - self._reached)
            pieces.append((end - now, self._reached))
        return pieces or [(step, self._reached)]
