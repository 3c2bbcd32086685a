"""Track of one sensor's samples: a sample counts if its number and its clock go on plausibly.

One wrong datagram must not shut the sensor out: had its number been taken as the newest, all true
samples would be older. So a sample may not be further ahead of the last one than the time that has
passed here allows. Samples that fit each other but not the track, as after a restart of the
sensor, become the track once it has been silent.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

LEAD_MAX_S = 0.2  # by which a datagram may have been quicker than the one before
RATE_MAX_HZ = 5000.0  # of any sensor
RIVALS_MIN = 20  # samples in a row that fit each other: 0.1 s at 200 Hz
SILENCE_MIN_S = 0.1  # of the track, before others replace it


class Verdict(Enum):
    """Verdict on a sample."""

    NEXT = "next"
    REFUSED = "refused"
    RESTARTED = "restarted"  # the first of a new track


@dataclass(frozen=True)
class _Mark:
    """Number, time by the sensor's clock [s] and time of arrival [s] of a sample."""

    number: int
    stamp: float
    received: float

    def leads_to(self, other: _Mark) -> bool:
        """Return whether another sample can follow this one."""
        passed = other.received - self.received + LEAD_MAX_S
        count, time = other.number - self.number, other.stamp - self.stamp
        return 0 < count <= 1 + RATE_MAX_HZ * passed and 0.0 < time <= passed


class SampleTrack:
    """Newest sample that counted, and the newest of those that did not fit it."""

    def __init__(self) -> None:
        """Begin with whatever sample comes first."""
        self._last: _Mark | None = None
        self._rival: _Mark | None = None
        self._rivals = 0

    @property
    def number(self) -> int | None:
        """Number of the newest sample that counted, or None."""
        return None if self._last is None else self._last.number

    def judge(self, number: int, stamp: float, received: float) -> Verdict:
        """Return whether a sample counts.

        Args:
            number: Its number.
            stamp: Its time by the clock of the sensor [s].
            received: Time of arrival by `time.monotonic` [s].
        """
        mark, last = _Mark(number, stamp, received), self._last
        if last is None or last.leads_to(mark):
            self._last, self._rivals = mark, 0
            return Verdict.NEXT
        fits = self._rival is not None and self._rival.leads_to(mark)
        self._rivals = self._rivals + 1 if fits and self._rivals else 1
        self._rival = mark
        if self._rivals < RIVALS_MIN or received - last.received < SILENCE_MIN_S:
            return Verdict.REFUSED
        self._last, self._rivals = mark, 0
        return Verdict.RESTARTED
