"""Lengths between samples, as far as they can be told when the last sample has just come.

Where samples are far apart, winches accelerate between them: a straight line between lengths that
are sampled at 4 Hz misses those of a winch at 1 m/s^2 by 8 mm halfway, and its corners swing the
platform. The parabola through the last three samples is exact at constant acceleration.
"""

from __future__ import annotations

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Scaled

# Over which lengths may go straight: a twentieth of a quick sway.
LENGTH_SEGMENT_MAX = Scaled(0.05, "s")
EVEN_RATIO_MIN = 0.3  # of an interval to the next: a shorter one does not tell the slope


def is_curved(time: Array, segment: float) -> bool:
    """Return True if lengths between the last two of three samples need a parabola.

    After an interval that is short against the last one, as where readings drop out, its slope is
    noise, and so is a parabola.

    Args:
        time: Of the samples, increasing [s], shape (3,).
        segment: Interval up to which lengths go straight [s].
    """
    before, last = np.diff(time)
    return bool(last > segment and before > EVEN_RATIO_MIN * last)


def curved_length(time: Array, length: Array, when: float) -> Array:
    """Return lengths between the last two of three samples, on the parabola through them.

    Args:
        time: Of the samples, increasing [s], shape (3,).
        length: [m], shape (3, ...).
        when: [s].

    Returns:
        [m], shape (...).
    """
    before = (length[1] - length[0]) / (time[1] - time[0])
    rate = (length[2] - length[1]) / (time[2] - time[1])
    bend = (rate - before) / (time[2] - time[0])
    since = when - time[1]
    return np.asarray(length[1] + since * rate + since * (when - time[2]) * bend)


def segment_ends(start: float, end: float, longest: float) -> list[float]:
    """Return the ends [s] of equal segments of a time, none longer than `longest` [s]."""
    count = max(1, int(np.ceil((end - start) / longest - 1e-6)))
    return [*np.linspace(start, end, count + 1)[1:-1].tolist(), end]
