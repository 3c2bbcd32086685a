"""What a PLC said, and what happened on the way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True, eq=False)
class Reading:
    """What the PLC said.

    Attributes:
        values: By name, as in `blocks.to_host`.
        received: When, by `time.monotonic` [s].
        measured: When its lengths were measured, by the same clock [s]; stays the same where the
            heartbeat or the clock of the PLC does.
        advanced: When that was last seen to advance, by the same clock [s].
        truth: What an emulated PLC knows of its robot, or None.
    """

    values: dict[str, Any]
    received: float
    measured: float
    advanced: float
    truth: dict[str, Any] | None = None


@dataclass
class LinkCounters:
    """What happened on a link.

    Attributes:
        cycles: Reads, and writes if any, that went well.
        errors: Calls that failed.
        torn: Data that were not of one PLC cycle.
        reconnects: How often the connection was opened anew.
        restarts: How often the PLC started anew: another ``boot``, or its clock went back.
        missed: Cycles of the thread that came a whole period late.
        round_trip: Wall time of the newest cycle, read and write [s].
        round_trip_max: The longest one [s].
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
