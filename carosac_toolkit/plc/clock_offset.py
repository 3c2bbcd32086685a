"""From the clock of a device to that of this host, where answers are late by more or less."""

from __future__ import annotations

from collections import deque


class ClockOffset:
    """Difference of two clocks, from the answers that came soonest.

    What arrives last is at least as old as the quickest way through the network. The smallest
    difference of the last seconds counts, so that a slow drift of the clocks is followed.
    """

    def __init__(self, span: float = 10.0) -> None:
        """Nothing known yet; `span` is how long a difference counts [s]."""
        self._span = span
        self._difference = 0.0
        self._least: deque[tuple[float, float]] = deque()  # received, difference; both grow

    def add(self, received: float, stamp: float) -> None:
        """Take one answer: when it was received here and its time by the device [s]."""
        difference = received - stamp
        while self._least and self._least[-1][1] >= difference:
            self._least.pop()
        self._least.append((received, difference))
        while self._least[0][0] < received - self._span:
            self._least.popleft()
        self._difference = self._least[0][1]

    def clear(self) -> None:
        """Forget everything: the device started again."""
        self._least.clear()
        self._difference = 0.0

    def here(self, stamp: float) -> float:
        """When it was by the clock of this host [s]."""
        return stamp + self._difference
