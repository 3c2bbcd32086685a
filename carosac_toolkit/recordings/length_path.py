"""Length readings of a recording as a smooth function of time."""

from __future__ import annotations

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.recordings.recording import Recording

READINGS_MIN = 5  # readings from which on noise can be told from motion


class LengthPath:
    """Readings as a smooth function of time, held before the first and after the last.

    Attributes:
        first: Time of the first reading [s].
    """

    def __init__(self, recording: Recording) -> None:
        """Fit a smoothing spline to each cable; cross-validation finds how smooth it is.

        Args:
            recording: With two samples or more.
        """
        from scipy.interpolate import make_interp_spline, make_smoothing_spline

        self.first, self._last = float(recording.time[0]), float(recording.time[-1])
        columns = recording.unstrained_length.T
        smooth = len(recording.time) >= READINGS_MIN
        make = make_smoothing_spline if smooth else lambda t, y: make_interp_spline(t, y, k=1)
        self._splines = [make(recording.time, column) for column in columns]

    def at(self, time: Array) -> Array:
        """Return readings [m], shape (..., n), at times [s] of shape (...)."""
        inside = np.clip(time, self.first, self._last)
        return np.stack([spline(inside) for spline in self._splines], axis=-1)
