"""Length readings of a recording as a smooth function of time."""

from __future__ import annotations

from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.recordings.recording import Recording

READINGS_MIN = 5  # readings from which on noise can be told from motion
STILL_READINGS_MIN = 50  # readings from which on a cable can be told to stand still
READING_NOISE_MAX_M = 2e-3  # [m]: encoders are no noisier
STILL_SIGMAS = 3.0  # sigmas: by how much changes from reading to reading may be too small for that
THIRD_DIFFERENCE_GAIN = 20.0  # variance of third differences of white noise over its own
LEFT_NOISE_MAX = 1.5  # times the bound of the noise: a spline that leaves more left out motion
SMOOTHNESS_DECADES, SMOOTHNESS_STEPS = 6.0, 24  # of the search, about a sample's own time scale


class LengthPath:
    """Readings as a smooth function of time, held before the first and after the last.

    Attributes:
        first: Time of the first reading [s].
    """

    def __init__(self, recording: Recording) -> None:
        """Fit a smoothing spline to each cable; cross-validation finds how smooth it is.

        Where it would smooth away more than noise, it is as smooth as noise allows. A cable whose
        readings are white noise about their mean stands still at that mean.

        Args:
            recording: With two samples or more.
        """
        from scipy.interpolate import make_interp_spline

        self.first, self._last = float(recording.time[0]), float(recording.time[-1])
        columns = recording.unstrained_length.T
        smooth = len(recording.time) >= READINGS_MIN
        make = _smoothing_spline if smooth else lambda t, y: make_interp_spline(t, y, k=1)
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


def _smoothing_spline(time: Array, reading: Array) -> Any:
    """Fit a smoothing spline to readings (N,) of one cable.

    The search of scipy for the smoothness that cross-validation wants can end where motion is
    smoothed away. What the spline leaves is therefore held against the noise of the readings, of
    which third differences are a bound from above: they see noise whole and slow motion hardly.
    """
    from scipy.interpolate import make_smoothing_spline

    spline = make_smoothing_spline(time, reading)
    noise = float(np.sqrt((np.diff(reading, 3) ** 2).mean() / THIRD_DIFFERENCE_GAIN))
    noise = min(noise, READING_NOISE_MAX_M)
    low, high = -SMOOTHNESS_DECADES, SMOOTHNESS_DECADES
    scale = float(np.median(np.diff(time))) ** 3
    if _left(spline, time, reading) <= LEFT_NOISE_MAX * noise:
        return spline
    for _ in range(SMOOTHNESS_STEPS):
        middle = 0.5 * (low + high)
        spline = make_smoothing_spline(time, reading, lam=scale * 10.0**middle)
        if _left(spline, time, reading) > noise:
            high = middle
        else:
            low = middle
    return make_smoothing_spline(time, reading, lam=scale * 10.0**low)


def _left(spline: Any, time: Array, reading: Array) -> float:
    """Return the root mean square of what a spline leaves of readings [m]."""
    return float(np.sqrt(((spline(time) - reading) ** 2).mean()))


def _is_still(reading: Array) -> bool:
    """Return True if readings (N,) change as white noise does, or not at all (von Neumann 1941).

    The mean square of their changes is then twice their variance. Noise is small: what swings by
    more than it moves, however it was sampled.
    """
    if len(reading) < STILL_READINGS_MIN:
        return False
    variance = float(reading.var())
    if variance > READING_NOISE_MAX_M**2:
        return False
    change = float((np.diff(reading) ** 2).mean())
    return bool(change >= 2.0 * variance * (1.0 - STILL_SIGMAS / np.sqrt(len(reading))))
