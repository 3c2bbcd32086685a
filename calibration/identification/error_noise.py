"""Noise of open-loop simulation errors: their size, and how many of them count as one.

They are not white: wind, and all that the model leaves out, make the platform swing, and an error
lasts for many samples. Each sample then counts for less than one: of N errors with autocorrelation
rho, as of their derivatives, about N / (1 + 2 sum rho^2) are independent (Bartlett, Journal of the
Royal Statistical Society B 8, 1946). A noise model that predicts one error from those before would
use the data better, but explains a mistuned mode of the robot as noise just as well.

Of many recordings every error counts, and alike on all axes: how their sums scatter from recording
to recording tells afterwards what they are worth. To take an error that lasts, or one axis, for
noise while the search goes on would hide just what the parameters have yet to explain. One
recording may be worse than the others, as a cable vibrated or hung loose in it: beyond a limit it
tells its own noise, and counts for as much less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.robust import NORMAL_MEDIAN, pseudo_huber
from carosac_toolkit.base.arrays import Array

# Least sigma, positions [m] and rotations [rad]: noise of readings, what smoothing takes away, and
# cables without inertia make an error of this size whatever the parameters are.
SIGMA_MIN = np.repeat([2e-3, 3e-3], 3)
RUNS_APART_MIN = 10  # recordings from which on their own scatter tells how large errors are
MANY_SIGMA_SHARE = 0.02  # of the least sigma, where many recordings tell it
LAG_MAX_SHARE = 0.5  # of the samples: the longest lag that is looked at
RUN_COST_MAX = 1.5  # of an error, beyond which a recording has noise of its own
HEAVY_TAIL_SIGMAS = 3.0  # sigmas beyond which an error counts for less


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseErrorNoise:
    """Size and correlation of the six errors of a pose.

    Attributes:
        sigma: Positions [m], then rotations [rad], shape (6,).
        repeats: Samples for which one error of each counts, shape (6,).
        apart: True if runs are many, so that one may have noise of its own.
    """

    sigma: Array
    repeats: Array
    apart: bool = False

    def weights(self, errors: Array) -> Array:
        """Return the inverse variance of errors (K, 6), less where they are large; same shape."""
        shares, loss = pseudo_huber(errors, HEAVY_TAIL_SIGMAS * self.sigma)
        weights = shares / (self.sigma**2 * self.repeats)
        if self.apart:
            weights *= min(1.0, RUN_COST_MAX * errors.size / max(self._sum(loss), 1e-12))
        return np.asarray(weights)

    def cost(self, errors: Array) -> float:
        """Return the cost whose derivative, up to a factor 1/2, the weighted errors are."""
        _, loss = pseudo_huber(errors, HEAVY_TAIL_SIGMAS * self.sigma)
        cost, limit = self._sum(loss), RUN_COST_MAX * errors.size
        if self.apart and cost > limit:
            return limit * (1.0 + float(np.log(cost / limit)))
        return cost

    def _sum(self, loss: Array) -> float:
        return float((HEAVY_TAIL_SIGMAS**2 * loss / self.repeats).sum())


def estimate_noise(errors: Sequence[Array], *, apart: bool | None = None) -> PoseErrorNoise:
    """Estimate the noise from errors of each run, shape (K, 6).

    Args:
        errors: Of each run.
        apart: Whether runs are many, also where some were left out since; None: by their number.
    """
    together = np.concatenate(errors)
    typical = np.median(np.abs(together), axis=0) / NORMAL_MEDIAN
    rms = np.sqrt((together**2).mean(axis=0))
    sigma = np.minimum(rms, 1.5 * typical)
    if apart is None:
        apart = len(errors) >= RUNS_APART_MIN
    if apart:
        pooled = np.repeat(np.sqrt((sigma.reshape(2, 3) ** 2).mean(axis=1)), 3)
        return PoseErrorNoise(
            sigma=np.maximum(MANY_SIGMA_SHARE * SIGMA_MIN, pooled), repeats=np.ones(6), apart=True
        )
    return PoseErrorNoise(
        sigma=np.maximum(SIGMA_MIN, sigma),
        repeats=repeats_of(errors),
    )


def repeats_of(errors: Sequence[Array]) -> Array:
    """Return how many errors (K, 6) of each run count as one, shape (6,)."""
    return np.array([_repeats([run[:, k] for run in errors]) for k in range(6)])


def _repeats(errors: Sequence[Array]) -> float:
    """Return how many of some errors (K,) of each run count as one; rather too many in few."""
    total = sum(map(len, errors))
    longest = max(1, int(LAG_MAX_SHARE * max(map(len, errors))))
    power = np.zeros(longest)
    for each in errors:
        own = np.fft.irfft(np.abs(np.fft.rfft(each, 2 * len(each))) ** 2)[: len(each)]
        power[: len(own)] += own[:longest]
    correlation = power / power[0]
    chance = 1.0 / total  # square of what white noise shows
    return 1.0 + 2.0 * float(np.maximum(correlation[1:] ** 2 - chance, 0.0).sum())
