"""Parameters with what is known of them, the result of every calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array, set_frozen
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.robot.parameter_names import unit_of


@dataclass(frozen=True, kw_only=True, eq=False)
class ParameterEstimate:
    """k parameters; units are those of `carosac_toolkit.robot.parameter_names.unit_of`.

    Attributes:
        names: As in `carosac_toolkit.robot.parameters`.
        value: Estimated, shape (k,).
        covariance: Of the estimate, prior knowledge included, shape (k, k).
        start: Before the calibration, shape (k,).
        prior_sigma: One standard deviation of what was known before, infinite for nothing, (k,).
        factors: Names of positive parameters that were known up to a factor: what was known of
            their logarithm is normal, with `prior_sigma` over `start` its standard deviation.
    """

    names: tuple[str, ...]
    value: Array
    covariance: Array
    start: Array
    prior_sigma: Array
    factors: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        k = len(self.names)
        set_frozen(self, {"value": (k,), "covariance": (k, k), "start": (k,)})
        variance = np.diag(self.covariance)
        if (variance < 0.0).any():
            name = self.names[int(np.argmin(variance))]
            raise InvalidField(f"covariance of {name}", f"{variance.min():.3g}", ">= 0")
        prior = np.array(self.prior_sigma, dtype=np.float64)
        if prior.shape != (k,) or not (prior > 0.0).all():
            raise InvalidField("prior_sigma", f"{prior}", f"shape ({k},), > 0, inf for none")
        prior.setflags(write=False)
        object.__setattr__(self, "prior_sigma", prior)

    @property
    def units(self) -> tuple[str, ...]:
        """SI unit of each parameter."""
        return tuple(unit_of(name) for name in self.names)

    @property
    def sigma(self) -> Array:
        """One standard deviation of each parameter, shape (k,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def moved(self) -> Array:
        """Change from the start in prior sigmas, shape (k,); 0 without a prior."""
        rows = self._factor_rows
        change = self.value - self.start
        change[rows] = self.start[rows] * np.log(self.value[rows] / self.start[rows])
        return np.asarray(change / self.prior_sigma)

    @property
    def kept(self) -> Array:
        """Share of the prior sigma that is left, shape (k,); 0 without a prior."""
        rows = self._factor_rows
        left = self.sigma
        left[rows] *= self.start[rows] / self.value[rows]
        return np.asarray(left / self.prior_sigma)

    @property
    def _factor_rows(self) -> list[int]:
        return [self.names.index(name) for name in self.factors]

    @property
    def correlation(self) -> Array:
        """Correlation matrix, shape (k, k); 0 beside a parameter that is known exactly."""
        sigma = np.where(self.sigma > 0.0, self.sigma, 1.0)
        return np.asarray(self.covariance / np.outer(sigma, sigma))

    def index(self, name: str) -> int:
        """Return the place of a parameter.

        Raises:
            InvalidField: It was not estimated.
        """
        if name not in self.names:
            raise InvalidField("parameter", repr(name), f"one of {list(self.names)}")
        return self.names.index(name)

    def select(self, names: Sequence[str]) -> ParameterEstimate:
        """Return some of the parameters, in the order of `names`."""
        rows = [self.index(name) for name in names]
        return ParameterEstimate(
            names=tuple(names),
            value=self.value[rows],
            covariance=self.covariance[np.ix_(rows, rows)],
            start=self.start[rows],
            prior_sigma=self.prior_sigma[rows],
            factors=tuple(name for name in self.factors if name in names),
        )

    def data(self) -> dict[str, dict[str, Any]]:
        """Return every parameter by name, ready for JSON; an infinite prior becomes null."""
        columns = zip(
            self.names, self.value, self.sigma, self.start, self.prior_sigma, self.units,
            strict=True,
        )  # fmt: skip
        return {
            name: {
                "value": float(value),
                "sigma": float(sigma),
                "start": float(start),
                "prior_sigma": float(prior) if np.isfinite(prior) else None,
                "unit": unit,
            }
            for name, value, sigma, start, prior, unit in columns
        }
