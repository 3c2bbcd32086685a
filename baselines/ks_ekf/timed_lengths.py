"""Lengths with the time for which they count; those of a time to come wait for it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.values import Measurement

TIME_TOLERANCE_S = 1e-9  # less is rounding


@dataclass(frozen=True, kw_only=True, eq=False)
class TimedLengths:
    """Lengths of one robot of n cables.

    Attributes:
        time: At which the platform had them [s].
        lengths: Unstrained [m], shape (n,).
        rates: Their derivatives [m/s], shape (n,); 0 where none are measured.
    """

    time: float
    lengths: Array
    rates: Array


def reading_of(measurement: Measurement, lead: float) -> TimedLengths:
    """Return the lengths of a measurement of one robot, which lead it by `lead` [s]."""
    rate, lengths = measurement.length_rate, measurement.unstrained_length[0]
    return TimedLengths(
        time=float((measurement.time if rate is None else rate.time)[0]) + lead,
        lengths=lengths,
        rates=np.zeros_like(lengths) if rate is None else rate.value[0],
    )


def due(
    waiting: tuple[TimedLengths, ...], new: TimedLengths, now: float
) -> tuple[tuple[TimedLengths, ...], tuple[TimedLengths, ...]]:
    """Split what waits and what came, in the order of time.

    Args:
        waiting: In the order of time.
        new: What came; it may be one that waits already, sent again.
        now: [s].

    Returns:
        Those whose time has come, and those that wait on.
    """
    if all(abs(new.time - reading.time) > TIME_TOLERANCE_S for reading in waiting):
        waiting = tuple(sorted((*waiting, new), key=lambda reading: reading.time))
    count = sum(reading.time <= now + TIME_TOLERANCE_S for reading in waiting)
    return waiting[:count], waiting[count:]
