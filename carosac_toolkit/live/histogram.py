"""Histogram of times in constant memory, for runs of any length."""

from __future__ import annotations

import math

import numpy as np

LOW_S, HIGH_S = 1e-6, 1e3  # what is outside counts in the first or the last bin
WIDTH = 1.01  # of a bin: its upper end over its lower one
_BINS = math.ceil(math.log(HIGH_S / LOW_S) / math.log(WIDTH)) + 1


class Histogram:
    """Counts of times; quantiles are within 0.5 % between 1 us and 1000 s.

    Attributes:
        largest: Largest time [s], exact; 0 without any.
    """

    def __init__(self) -> None:
        """Start empty."""
        self._counts = np.zeros(_BINS, dtype=np.int64)
        self.largest = 0.0

    def add(self, seconds: float) -> None:
        """Count a time [s]."""
        self.largest = max(self.largest, seconds)
        place = math.ceil(math.log(seconds / LOW_S) / math.log(WIDTH)) if seconds > LOW_S else 0
        self._counts[min(place, _BINS - 1)] += 1

    def quantile(self, share: float) -> float | None:
        """Return the time [s] that this share of the times does not exceed, or None."""
        counts = np.cumsum(self._counts)
        if counts[-1] == 0:
            return None
        place = int(np.searchsorted(counts, share * counts[-1]))
        return float(min(LOW_S * WIDTH ** (place - 0.5), self.largest))
