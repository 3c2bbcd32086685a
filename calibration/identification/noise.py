"""What the errors of an open-loop simulation look like, and how they are made independent.

They are not white: wind, and all that the model leaves out, make the platform swing, so that an
error lasts for many samples and shows in several axes at once. The six errors of a pose are
therefore taken for a vector autoregressive process, estimated from the errors themselves, and are
fitted in terms of what is new in each sample: generalised least squares (Ljung, System
Identification, 2nd ed. 1999, chapter 7).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carosac_toolkit.arrays import Array

ORDER = 6  # of the process
SAMPLES = 100  # for each order: fewer hardly determine its 36 numbers
FLOOR = np.repeat([2e-4, 2e-4], 3)  # least sigma of what is new: positions [m], rotations [rad]
UNEXPLAINED = 1e-4  # share of the variance that is taken for white whatever the errors look like
HEAVY = 3.0  # sigmas beyond which what is new counts for less


@dataclass(frozen=True, kw_only=True, eq=False)
class Noise:
    """A vector autoregressive process of order p of the six errors of a pose.

    Attributes:
        weights: Of the errors before, newest first, shape (p, 6, 6).
        whitener: From what is new to unit variance, lower triangular, shape (6, 6).
        start: The same for the errors themselves, for the first p samples, shape (6, 6).
    """

    weights: Array
    whitener: Array
    start: Array

    def innovations(self, errors: Array) -> Array:
        """What is new in each sample, of unit variance.

        Args:
            errors: shape (K, 6) or (K, 6, k).

        Returns:
            The same shape.
        """
        columns = errors.reshape(len(errors), 6, -1)
        new = np.array(columns)
        for lag, weights in enumerate(self.weights, start=1):
            new[lag:] -= np.einsum("ij,njk->nik", weights, columns[:-lag])
        scaled = np.einsum("ij,njk->nik", self.whitener, new)
        order = len(self.weights)
        scaled[:order] = np.einsum("ij,njk->nik", self.start, columns[:order])
        return scaled.reshape(errors.shape)

    def shares(self, innovations: Array) -> Array:
        """Weights of innovations (K, 6): less where they are large."""
        found: Array = 1.0 / np.sqrt(1.0 + (innovations / HEAVY) ** 2)
        return found

    def cost(self, errors: Array) -> float:
        """Whose derivative the weighted innovations are, up to a factor 1/2."""
        new = self.innovations(errors)
        return float((2.0 * HEAVY**2 * (np.sqrt(1.0 + (new / HEAVY) ** 2) - 1.0)).sum())


def white(errors: Array) -> Noise:
    """Independent noise of the size of errors, shape (K, 6)."""
    sigma = np.maximum(np.sqrt((errors**2).mean(axis=0)), FLOOR)
    scale = np.diag(1.0 / sigma)
    return Noise(weights=np.empty((0, 6, 6)), whitener=scale, start=scale)


def coloured(errors: Array) -> Noise:
    """Estimate the process from errors, shape (K, 6), by regression on the errors before."""
    sigma = np.maximum(np.sqrt((errors**2).mean(axis=0)), FLOOR)
    unit = errors / sigma
    count = len(unit)
    order = min(ORDER, count // SAMPLES)
    if order == 0:
        return white(errors)
    past = np.hstack([unit[order - lag : count - lag] for lag in range(1, order + 1)])
    now = unit[order:]
    normal = past.T @ past + UNEXPLAINED * len(now) * np.eye(past.shape[1])
    found = np.linalg.solve(normal, past.T @ now)  # (6 p, 6)
    left = now - past @ found
    spread = left.T @ left / (len(now) - len(past.T)) + np.diag((FLOOR / sigma) ** 2)
    all_of_it = unit.T @ unit / count + np.diag((FLOOR / sigma) ** 2)
    weights = found.T.reshape(6, order, 6).swapaxes(0, 1)  # (p, 6, 6), of unit errors
    scale = np.diag(1.0 / sigma)
    return Noise(
        weights=weights * sigma[None, :, None] / sigma[None, None, :],
        whitener=np.linalg.inv(np.linalg.cholesky(spread)) @ scale,
        start=np.linalg.inv(np.linalg.cholesky(all_of_it)) @ scale,
    )
