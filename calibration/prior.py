"""Unknowns of a calibration with what is known of them before."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calibration.observability import Observability, judge
from carosac_toolkit.base.arrays import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Prior:
    """k unknowns and their normal distribution before a calibration.

    Attributes:
        names: Of the unknowns; those of robot parameters as in `carosac_toolkit.robot.parameters`.
        mean: Start of the search, shape (k,).
        covariance: Positive definite, shape (k, k).
    """

    names: tuple[str, ...]
    mean: Array
    covariance: Array

    @cached_property
    def sigma(self) -> Array:
        """One standard deviation of each unknown, shape (k,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @cached_property
    def information(self) -> Array:
        """Inverse of the covariance, shape (k, k); scaled, as units differ by orders."""
        scale = np.outer(self.sigma, self.sigma)
        return np.asarray(np.linalg.inv(self.covariance / scale) / scale)

    def rows(self, prefix: str) -> NDArray[np.int64]:
        """Return the places of the unknowns whose names begin with a prefix."""
        return np.array([k for k, name in enumerate(self.names) if name.startswith(prefix)], int)

    def deviation(self, value: Array) -> Array:
        """Return how far values are from the mean, in standard deviations, shape (k,)."""
        return np.asarray(np.abs(value - self.mean) / self.sigma)

    def judge(self, information: Array) -> Observability:
        """Judge what data alone, of some information (k, k), say beside this prior."""
        return judge(self.names, information, self.sigma)
