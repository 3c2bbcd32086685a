"""filterpy's extended Kalman filter as the carrier of error and covariance, with a gate."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.values import Innovations


@dataclass(frozen=True, kw_only=True, eq=False)
class FilterCorrection:
    """Result of one measurement.

    Attributes:
        error: Estimated error of the state, shape (k,); zero where the measurement was rejected.
        covariance: Of what is left of it, shape (k, k).
        square: Normalised innovation squared, not divided by its degrees of freedom.
        dof: Degrees of freedom of the measurement.
        accepted: Whether it passed its gate.
    """

    error: Array
    covariance: Array
    square: float
    dof: int
    accepted: bool


class ErrorFilter:
    """A Kalman filter of the error of a state that is kept elsewhere: its own x is always 0."""

    def __init__(self, size: int, gate: float) -> None:
        """Make a filter of `size` errors, whose gate good measurements pass with this chance."""
        from filterpy.kalman import ExtendedKalmanFilter

        self._kalman: Any = ExtendedKalmanFilter(dim_x=size, dim_z=1)
        self._kalman.x = np.zeros(size)
        self._gate = gate

    @property
    def covariance(self) -> Array:
        """Covariance of the error, shape (k, k)."""
        return np.asarray(self._kalman.P)

    def begin(self, covariance: Array) -> None:
        """Go on from a covariance."""
        self._kalman.P = covariance

    def predict(self, transition: Array, noise: Array) -> None:
        """Carry the covariance over a step."""
        self._kalman.F, self._kalman.Q = transition, noise
        self._kalman.predict()

    def correct(
        self, covariance: Array, residual: Array, jacobian: Array, noise: Array,
        *, bounded: bool = False,
    ) -> FilterCorrection:  # fmt: skip
        """Weigh a residual (m,), measured minus expected, with its Jacobian (m, k) and noise.

        One beyond the gate is rejected. Where it is `bounded` it corrects the state by as much as
        one in its direction that would just have passed (Huber's influence function, on the
        residual as a whole).
        """
        kalman = self._kalman
        predicted = jacobian @ covariance @ jacobian.T
        spread = predicted + noise
        square, dof = float(residual @ np.linalg.solve(spread, residual)), len(residual)
        beyond = square / limit(dof, self._gate)
        accepted = beyond <= 1.0
        if not accepted and bounded and np.isfinite(beyond):
            noise = np.sqrt(beyond) * spread - predicted
        elif not accepted:
            error = np.zeros(len(covariance))
            return FilterCorrection(
                error=error, covariance=covariance, square=square, dof=dof, accepted=False
            )
        kalman.P = covariance
        kalman.update(residual, lambda _: jacobian, lambda x: jacobian @ x, noise)
        error = kalman.x
        kalman.x = np.zeros(len(error))
        return FilterCorrection(
            error=error, covariance=kalman.P, square=square, dof=dof, accepted=accepted
        )


@lru_cache(maxsize=64)
def limit(dof: int, probability: float) -> float:
    """Return the quantile of a chi-squared variable at a probability."""
    from scipy.stats import chi2

    return float(chi2.ppf(probability, dof))


def no_innovations() -> Innovations:
    """Return the sums of no measurements."""
    return Innovations(squares=np.zeros(1), dof=np.zeros(1), rejected=np.zeros(1))


def added(before: Innovations, correction: FilterCorrection) -> Innovations:
    """Return the sums with one more measurement; a rejected one is only counted."""
    return Innovations(
        squares=before.squares + (correction.square if correction.accepted else 0.0),
        dof=before.dof + (correction.dof if correction.accepted else 0),
        rejected=before.rejected + (not correction.accepted),
    )
