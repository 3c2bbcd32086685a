"""Least squares with unknowns that all samples share and unknowns of each sample alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.linear_samples import LinearSamples
from carosac_toolkit.base.arrays import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class SharedSolution:
    """Solution of S samples with k shared unknowns and d of each sample.

    Attributes:
        shared: Change of the shared unknowns, shape (k,).
        own: Change of the unknowns of each sample, shape (S, d).
        covariance: Of the shared unknowns, shape (k, k).
        own_alone: Covariance of a sample's own unknowns if the shared ones were known, (S, d, d).
        own_by_shared: Change of a sample's own unknowns with the shared ones, shape (S, d, k).
    """

    shared: Array
    own: Array
    covariance: Array
    own_alone: Array
    own_by_shared: Array

    def joint_covariance(self, by_own: Array, by_shared: Array) -> Array:
        """Return the covariance of functions of each sample's unknowns and of the shared ones.

        Args:
            by_own: Derivative of m functions by the sample's own unknowns, shape (S, m, d).
            by_shared: By the shared ones, shape (S, m, k).

        Returns:
            shape (S, m, m).
        """
        whole = by_shared + by_own @ self.own_by_shared
        alone = by_own @ self.own_alone @ by_own.swapaxes(1, 2)
        return np.asarray(alone + whole @ self.covariance @ whole.swapaxes(1, 2))


def solve(
    linear: LinearSamples, information: Array, pull: Array, *, damping: float = 0.0
) -> SharedSolution:
    """Minimise the squared residuals and a prior of the shared unknowns.

    Args:
        linear: Residuals in standard deviations, with derivatives.
        information: Of the prior, positive definite, shape (k, k).
        pull: Information times distance from the present values to the prior mean, shape (k,).
        damping: Share of each diagonal entry that is added to it (Levenberg-Marquardt).
    """
    own, shared, residual = linear.by_own, linear.by_shared, linear.residual
    square = own.swapaxes(1, 2) @ own
    square += damping * square * np.eye(own.shape[2])
    cross = own.swapaxes(1, 2) @ shared
    both = (shared.swapaxes(1, 2) @ shared).sum(axis=0) + information
    both += damping * both * np.eye(len(both))
    own_pull = -(own.swapaxes(1, 2) @ residual[..., None])
    shared_pull = pull - np.einsum("smk,sm->k", shared, residual)
    alone = np.asarray(np.linalg.inv(square), dtype=np.float64)
    by_shared = -alone @ cross
    reduced = both + (cross.swapaxes(1, 2) @ by_shared).sum(axis=0)
    scale = 1.0 / np.sqrt(np.diag(reduced))
    covariance = np.linalg.inv(reduced * np.outer(scale, scale)) * np.outer(scale, scale)
    change = covariance @ (shared_pull + (by_shared.swapaxes(1, 2) @ own_pull).sum(axis=0)[:, 0])
    return SharedSolution(
        shared=change,
        own=np.asarray((alone @ own_pull)[..., 0] + by_shared @ change),
        covariance=covariance,
        own_alone=alone,
        own_by_shared=by_shared,
    )
