"""Conversion from the clock of a device to that of this host, despite variable delays."""

from __future__ import annotations

from collections import deque


class ClockOffset:
    """Difference of two clocks, estimated from the answers that arrived with the least delay.

    The smallest difference of the last seconds counts, so that a slow drift of the clocks is
    followed. It includes the shortest delay of the network, which cannot be told apart.
    """

    def __init__(self, span: float = 10.0) -> None:
        """Start without a difference; each one added counts for `span` [s]."""
        self._span = span
        self._difference = 0.0
        self._least: deque[tuple[float, float]] = deque()  # received, difference; both grow

    def add(self, received: float, stamp: float) -> None:
        """Add one answer: time of arrival by this host and its time by the device [s]."""
        difference = received - stamp
        while self._least and self._least[-1][1] >= difference:
            self._least.pop()
        self._least.append((received, difference))
        while self._least[0][0] < received - self._span:
            self._least.popleft()
        self._difference = self._least[0][1]

    def clear(self) -> None:
        """Forget everything, as after a restart of the device."""
        self._least.clear()
        self._difference = 0.0

    def here(self, stamp: float) -> float:
        """Return a time of the device by the clock of this host [s]."""
        return stamp + self._difference
