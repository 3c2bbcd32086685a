"""Noise of open-loop simulation errors: their size, and how many of them count as one.

They are not white: wind, and all that the model leaves out, make the platform swing, and an error
lasts for many samples. Each sample then counts for less than one: of N errors with autocorrelation
rho, as of their derivatives, about N / (1 + 2 sum rho^2) are independent (Bartlett, Journal of the
Royal Statistical Society B 8, 1946). A noise model that predicts one error from those before would
use the data better, but explains a mistuned mode of the robot as noise just as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.robust import NORMAL_MEDIAN, pseudo_huber
from carosac_toolkit.base.arrays import Array

# Least sigma, positions [m] and rotations [rad]: noise of readings, what smoothing takes away, and
# cables without inertia make an error of this size whatever the parameters are.
SIGMA_MIN = np.repeat([2e-3, 3e-3], 3)
LAG_MAX_SHARE = 0.5  # of the samples: the longest lag that is looked at
HEAVY_TAIL_SIGMAS = 3.0  # sigmas beyond which an error counts for less


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseErrorNoise:
    """Size and correlation of the six errors of a pose.

    Attributes:
        sigma: Positions [m], then rotations [rad], shape (6,).
        repeats: Samples for which one error of each counts, shape (6,).
    """

    sigma: Array
    repeats: Array

    def weights(self, errors: Array) -> Array:
        """Return the inverse variance of errors (K, 6), less where they are large; same shape."""
        shares, _ = pseudo_huber(errors, HEAVY_TAIL_SIGMAS * self.sigma)
        return np.asarray(shares / (self.sigma**2 * self.repeats))

    def cost(self, errors: Array) -> float:
        """Return the cost whose derivative, up to a factor 1/2, the weighted errors are."""
        _, loss = pseudo_huber(errors, HEAVY_TAIL_SIGMAS * self.sigma)
        return float((HEAVY_TAIL_SIGMAS**2 * loss / self.repeats).sum())


def estimate_noise(errors: Array) -> PoseErrorNoise:
    """Estimate the noise from errors, shape (K, 6)."""
    typical = np.median(np.abs(errors), axis=0) / NORMAL_MEDIAN
    rms = np.sqrt((errors**2).mean(axis=0))
    return PoseErrorNoise(
        sigma=np.maximum(SIGMA_MIN, np.minimum(rms, 1.5 * typical)),
        repeats=np.array([_repeats(part) for part in errors.T]),
    )


def _repeats(errors: Array) -> float:
    """Return how many of some errors (K,) count as one; rather too many in a short record."""
    count = len(errors)
    longest = max(1, int(LAG_MAX_SHARE * count))
    spectrum = np.fft.rfft(errors, 2 * count)
    power = np.fft.irfft(np.abs(spectrum) ** 2)[:longest]
    correlation = power / power[0]
    chance = 1.0 / count  # square of what white noise shows
    return 1.0 + 2.0 * float(np.maximum(correlation[1:] ** 2 - chance, 0.0).sum())
