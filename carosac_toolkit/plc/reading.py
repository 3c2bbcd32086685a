"""Data read from a PLC, and counts of what happened on the way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True, eq=False)
class Reading:
    """Data of one PLC cycle.

    Attributes:
        values: Members of `blocks.to_host` by name.
        received: Time of arrival, by `time.monotonic` [s].
        measured: Time when the lengths were measured, by the same clock [s]; unchanged while the
            heartbeat or the clock of the PLC stands still.
        advanced: Time when both were last seen to advance, by the same clock [s].
        truth: Members of `blocks.truth` by name, from an emulated PLC; else None.
    """

    values: dict[str, Any]
    received: float
    measured: float
    advanced: float
    truth: dict[str, Any] | None = None


@dataclass
class LinkCounters:
    """Counts of one exchange.

    Attributes:
        cycles: Cycles that succeeded: a read, and a write if there was one.
        errors: Calls that failed.
        torn: Blocks that were not of one PLC cycle.
        reconnects: Connections opened anew.
        restarts: Starts of the PLC program: another ``boot``, or a clock that went back.
        missed: Cycles of the thread that came a whole period late.
        round_trip: Wall time of the newest cycle, read and write [s].
        round_trip_max: Longest of them [s].
        gap_max: Longest time from the end of one cycle to that of the next [s].
    """

    cycles: int = 0
    errors: int = 0
    torn: int = 0
    reconnects: int = 0
    restarts: int = 0
    missed: int = 0
    round_trip: float = 0.0
    round_trip_max: float = 0.0
    gap_max: float = 0.0
