"""Errors of derivatives, as two ways of taking them differ, counted as noise of what they predict.

Where cables vibrate as a platform sways, derivatives by what hardly shows, such as the axial
damping, depend on the steps over which they are taken, in time and along the coordinates. Taken for
exact, a few such recordings would seem to tell a parameter better than all others together. With
derivatives that may be wrong by D, errors are predicted with a further covariance of D C D^T, where
C says how far off the parameters may be:

.. math:: (W^{-1} + D C D^T)^{-1} = W - W D (C^{-1} + D^T W D)^{-1} D^T W.

C follows from the information that is left, and that from C: repeated until both agree. What may
change errors beside derivatives adds columns to D, with a C of 1.

References:
    Fuller, *Measurement Error Models*, 1987.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.identification.error_noise import PoseErrorNoise
from carosac_toolkit.base.arrays import Array

# Of derivatives that are means of two kinds, how wrong they may be, over how much both differ. If
# the right ones are anywhere between, squared errors of parameters are 1.4 times what sigmas say in
# simulated regressions (see the tests); with a ratio of 1 up to twice that, with 4 hardly less.
DOUBT_RATIO = 2.0
ROUNDS_MAX = 200  # of the repetition
ROUND_CHANGE_MAX = 1e-4  # of the logarithm of the information's determinant, in the last one


@dataclass(frozen=True, kw_only=True, eq=False)
class RunDerivatives:
    """Derivatives of the N errors of a run, and their weights.

    Attributes:
        robot: By the k coordinates of the robot, shape (N, k).
        start: By those of the run's start, shape (N, s).
        doubt: By how much those by the robot may be wrong, shape (N, k).
        hidden: What beside the robot and the start may change errors, each column by one sigma,
            shape (N, d).
        weights: Of errors, shape (N,).
    """

    robot: Array
    start: Array
    doubt: Array
    hidden: Array
    weights: Array

    def beside_start(self) -> tuple[Array, Array]:
        """Return derivatives (N, k) and what may be wrong (N, k + d) that no start makes up for.

        The start's prior sigmas are 1.
        """
        weighted = self.weights[:, None] * self.start
        known = np.eye(self.start.shape[1]) + self.start.T @ weighted
        both = np.hstack([self.robot, self.doubt, self.hidden])
        left = both - self.start @ np.linalg.solve(known, weighted.T @ both)
        return left[:, : self.robot.shape[1]], left[:, self.robot.shape[1] :]


@dataclass(frozen=True, kw_only=True, eq=False)
class Doubts:
    """By how much derivatives may be wrong, and how far off the robot may be.

    Attributes:
        slopes: By how much, of each run, and what else may change its errors, (N, k + d); what its
            start makes up for is left out.
        precision: Inverse of the robot's covariance, shape (k, k).
    """

    slopes: Sequence[Array]
    precision: Array

    @classmethod
    def of(cls, runs: Sequence[RunDerivatives], prior: Array) -> Doubts:
        """Find how far off the robot may be with derivatives that may be wrong.

        Args:
            runs: All of them; those that are left out have weights of 0.
            prior: Information on the robot beside the runs, shape (k, k).
        """
        sides = [run.beside_start() for run in runs]
        slopes = [wrong for _, wrong in sides]
        told = [
            (run.robot.T @ (w * side), wrong.T @ (w * side), wrong.T @ (w * wrong))
            for run, (side, wrong) in zip(runs, sides, strict=True)
            for w in [run.weights[:, None]]
        ]
        precision = prior + sum(plain for plain, _, _ in told)
        for _ in range(ROUNDS_MAX):
            left = prior + sum(
                plain - both.T @ np.linalg.solve(_with_unit(precision, len(own)) + own, both)
                for plain, both, own in told
            )
            change = np.linalg.slogdet(precision)[1] - np.linalg.slogdet(left)[1]
            precision = 0.5 * (left + left.T)
            if abs(change) <= ROUND_CHANGE_MAX:
                break
        return cls(slopes=slopes, precision=precision)

    def lost(self, k: int, weights: Array, left: Array, right: Array) -> Array:
        """Return what of left^T W right the doubt takes.

        Args:
            k: Run.
            weights: Of its errors, the diagonal of W, shape (N,).
            left: Shape (N, a).
            right: Shape (N, b).
        """
        slope = self.slopes[k]
        weighted = weights[:, None] * slope
        known = _with_unit(self.precision, slope.shape[1]) + slope.T @ weighted
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


def _with_unit(precision: Array, size: int) -> Array:
    """Return a precision (k, k) with 1 for all further ones, shape (size, size)."""
    whole = np.eye(size)
    whole[: len(precision), : len(precision)] = precision
    return whole
