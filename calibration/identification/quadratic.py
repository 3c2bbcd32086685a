"""A quadratic cost of coordinates: where it is least, within bounds or beside other coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError

BVLS_STEPS = 10  # at most, for each coordinate


@dataclass(frozen=True, kw_only=True, eq=False)
class Quadratic:
    """A cost c + 2 g^T d + d^T A d, where p coordinates change by d.

    Attributes:
        cost: c.
        gradient: g, shape (p,).
        information: A, shape (p, p).
    """

    cost: float
    gradient: Array
    information: Array

    def at(self, change: Array) -> float:
        """Return the cost after a change (p,)."""
        return float(self.cost + (2.0 * self.gradient + self.information @ change) @ change)

    def least_beside(self, count: int) -> Quadratic:
        """Return the cost of the first coordinates alone, where the others are at their best."""
        own, other = slice(count), slice(count, None)
        cross, pull = self.information[own, other], self.gradient[other]
        follow = np.linalg.solve(self.information[other, other], np.column_stack([pull, cross.T]))
        return Quadratic(
            cost=float(self.cost - pull @ follow[:, 0]),
            gradient=self.gradient[own] - cross @ follow[:, 0],
            information=self.information[own, own] - cross @ follow[:, 1:],
        )

    def least_within(self, lower: Array, upper: Array | float = np.inf) -> Array:
        """Return the change (p,) to where it is least within bounds.

        A must be positive definite.

        Args:
            lower: Of the change, at most 0, shape (p,).
            upper: The same, above 0; one for all: of each.

        Raises:
            CarosacError: No such change is found.
        """
        from scipy.optimize import lsq_linear

        change = np.asarray(-np.linalg.solve(self.information, self.gradient), float)
        if ((change >= lower) & (change <= upper)).all():
            return change
        root = np.linalg.cholesky(self.information)  # d^T A d = |root^T d|^2
        pull = np.linalg.solve(root, -self.gradient)
        found = lsq_linear(
            root.T, pull, bounds=(lower, upper), method="bvls", max_iter=BVLS_STEPS * len(lower)
        )
        if not found.success:
            raise CarosacError(f"identification: bounded least squares: {found.message}")
        return np.asarray(found.x, float)
