"""Length readings of a recording as a smooth function of time."""

from __future__ import annotations

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.recordings.recording import Recording

READINGS_MIN = 5  # readings from which on noise can be told from motion
STILL_READINGS_MIN = 50  # readings from which on a cable can be told to stand still
STILL_SIGMAS = 3.0  # sigmas: by how much changes from reading to reading may be too small for that


class LengthPath:
    """Readings as a smooth function of time, held before the first and after the last.

    Attributes:
        first: Time of the first reading [s].
    """

    def __init__(self, recording: Recording) -> None:
        """Fit a smoothing spline to each cable; cross-validation finds how smooth it is.

        A cable whose readings are white noise about their mean stands still at that mean.

        Args:
            recording: With two samples or more.
        """
        from scipy.interpolate import make_interp_spline, make_smoothing_spline

        self.first, self._last = float(recording.time[0]), float(recording.time[-1])
        columns = recording.unstrained_length.T
        smooth = len(recording.time) >= READINGS_MIN
        make = make_smoothing_spline if smooth else lambda t, y: make_interp_spline(t, y, k=1)
        ends = np.array([self.first, self._last])
        self._splines = [
            make_interp_spline(ends, np.full(2, column.mean()), k=1)
            if _is_still(column)
            else make(recording.time, column)
            for column in columns
        ]

    def at(self, time: Array) -> Array:
        """Return readings [m], shape (..., n), at times [s] of shape (...)."""
        inside = np.clip(time, self.first, self._last)
        return np.stack([spline(inside) for spline in self._splines], axis=-1)


def _is_still(reading: Array) -> bool:
    """Return True if readings (N,) change as white noise does, or not at all (von Neumann 1941).

    The mean square of their changes is then twice their variance.
    """
    if len(reading) < STILL_READINGS_MIN:
        return False
    variance = float(reading.var())
    change = float((np.diff(reading) ** 2).mean())
    return bool(change >= 2.0 * variance * (1.0 - STILL_SIGMAS / np.sqrt(len(reading))))
