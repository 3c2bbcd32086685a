"""What errors of a run have in common beside noise, and how that counts.

Vibrations that noise hides change the errors of a run, and so does what a linear function of the
coordinates leaves out. Both are known by columns S of one sigma each, so that errors are predicted
with a further covariance of S S^T:

.. math:: (W^{-1} + S S^T)^{-1} = W - W S (1 + S^T W S)^{-1} S^T W.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.identification.error_noise import PoseErrorNoise
from carosac_toolkit.base.arrays import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Doubts:
    """What errors of runs have in common.

    Attributes:
        columns: Of each run, by one sigma each, shape (N, d); what its start makes up for is left
            out.
    """

    columns: Sequence[Array]

    @classmethod
    def beside_starts(
        cls, columns: Sequence[Array], starts: Sequence[Array], weights: Sequence[Array]
    ) -> Doubts:
        """Leave out what starts make up for, whose prior sigmas are 1.

        Args:
            columns: Of each run, shape (N, d).
            starts: Derivatives by its start, shape (N, s).
            weights: Of its errors, shape (N,).
        """
        left = []
        for each, start, weight in zip(columns, starts, weights, strict=True):
            weighted = weight[:, None] * start
            known = np.eye(start.shape[1]) + start.T @ weighted
            left.append(each - start @ np.linalg.solve(known, weighted.T @ each))
        return cls(columns=left)

    def lost(self, k: int, weights: Array, left: Array, right: Array) -> Array:
        """Return what of left^T W right they take.

        Args:
            k: Run.
            weights: Of its errors, the diagonal of W, shape (N,).
            left: Shape (N, a).
            right: Shape (N, b).
        """
        columns = self.columns[k]
        weighted = weights[:, None] * columns
        known = np.eye(columns.shape[1]) + columns.T @ weighted
        return np.asarray((weighted.T @ left).T @ np.linalg.solve(known, weighted.T @ right))


@dataclass(frozen=True, kw_only=True, eq=False)
class Judge:
    """By which errors of runs count.

    Attributes:
        noise: Of each error.
        doubts: What errors of a run have in common beside; None: nothing.
    """

    noise: PoseErrorNoise
    doubts: Doubts | None = None

    def cost(self, k: int, errors: Array) -> float:
        """Return the cost of errors (K, 6) of run k."""
        cost = self.noise.cost(errors)
        if self.doubts is None:
            return cost
        flat, weights = errors.reshape(-1, 1), self.noise.weights(errors).ravel()
        return cost - float(self.doubts.lost(k, weights, flat, flat)[0, 0])

    def product(self, k: int, errors: Array, left: Array, right: Array) -> Array:
        """Return left^T W right, by the weights W of errors (K, 6) of run k.

        Args:
            k: Run.
            errors: Of it.
            left: Shape (6 K, a).
            right: Shape (6 K, b).
        """
        weights = self.noise.weights(errors).ravel()
        plain = left.T @ (weights[:, None] * right)
        if self.doubts is None:
            return np.asarray(plain)
        return np.asarray(plain - self.doubts.lost(k, weights, left, right))
