"""Least squares with all positions eliminated, robust where asked: fast enough for many starts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.linear_samples import LinearSamples
from calibration.robust import cauchy
from calibration.self_calibration.problem import MotorAngleProblem
from carosac_toolkit.base.arrays import Array

CAUCHY_SIGMAS = 3.0  # standard deviations from which on a robust fit lets go of a sample
COST_CHANGE_MIN = 1e-8  # relative change of the cost that ends a fit
DAMPING_MIN = 1e-12
DAMPING_MAX = 1e8  # damping with which no step is left

Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class Trust:
    """Data that a fit uses, and their noise.

    Attributes:
        line_sigma: One standard deviation of the line paid out [m].
        lengths: Samples whose motor angles count, shape (N,).
        known: Samples whose known coordinates count, shape (N,).
        robust: True if samples far off lose weight (Cauchy).
    """

    line_sigma: float
    lengths: Mask
    known: Mask
    robust: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class SampleFit:
    """End of a fit.

    Attributes:
        shared: Shape (m,).
        position: Own unknowns of the samples: position [m], and rotation vector [rad] where it is
            unknown, shape (N, own).
        cost: Sum of squares, whitened, or of what takes their place where robust.
        converged: True if the cost settled.
    """

    shared: Array
    position: Array
    cost: float
    converged: bool


def whiten(
    problem: MotorAngleProblem, shared: Array, position: Array, line_sigma: float
) -> LinearSamples:
    """Linearise all samples, with residuals in standard deviations of the line."""
    return problem.linearize(shared, position).scaled(
        problem.advantage / problem.line_noise(line_sigma)
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Equations:
    """Normal equations, position by position and reduced to the shared unknowns.

    Attributes:
        information: Of the shared unknowns, positions unknown, prior included, shape (m, m).
        gradient: Shape (m,).
        by_shared: Change of each best position by the shared unknowns, shape (N, own, m).
        step: Of each position with the shared unknowns held, shape (N, own).
        position_covariance: Of each position with the shared unknowns held, shape (N, own, own).
        cost: As in `SampleFit`.
        lengths: Weight of the lengths of each sample, shape (N,).
        known: Weight of each known position, shape (N,).
    """

    information: Array
    gradient: Array
    by_shared: Array
    step: Array
    position_covariance: Array
    cost: float
    lengths: Array
    known: Array


def equations(
    problem: MotorAngleProblem, shared: Array, position: Array, trust: Trust, damping: float = 0.0
) -> Equations:
    """Linearise everything at some values.

    Args:
        problem: The samples.
        shared: Shape (m,).
        position: Own unknowns, shape (N, own).
        trust: Data that count.
        damping: Relative growth of the diagonals (Levenberg-Marquardt).
    """
    white = whiten(problem, shared, position, trust.line_sigma)
    axes = problem.known_axes
    away = np.where(axes, (position - problem.known_position) / problem.known_sigma, 0.0)
    weight, loss = _weights((white.residual**2).sum(axis=1), free_lengths(problem), trust.robust)
    hold, drift = _weights((away**2).sum(axis=1), 3, trust.robust)
    weight, hold = weight * trust.lengths, hold * trust.known
    offset = (position - problem.home) / problem.reach
    weighted = white.by_own * weight[:, None, None]
    own = weighted.swapaxes(1, 2) @ white.by_own
    diagonal = np.arange(problem.own)
    own[:, diagonal, diagonal] += axes * hold[:, None] / problem.known_sigma**2
    own[:, diagonal, diagonal] += problem.reach**-2
    own[:, diagonal, diagonal] *= 1.0 + damping
    pull = np.einsum("kij,ki->kj", weighted, white.residual)
    pull += hold[:, None] * away / problem.known_sigma + offset / problem.reach
    cross = weighted.swapaxes(1, 2) @ white.by_shared
    covariance: Array = np.asarray(np.linalg.inv(own), dtype=np.float64)
    by_shared, step = -covariance @ cross, -np.einsum("kij,kj->ki", covariance, pull)
    before = problem.before(shared)
    flat = white.by_shared.reshape(-1, problem.size)
    heavy = np.repeat(weight, white.residual.shape[1])
    information = (flat * heavy[:, None]).T @ flat + before.information
    information[np.diag_indices(problem.size)] *= 1.0 + damping
    gradient = flat.T @ (heavy * white.residual.ravel()) + before.gradient
    tied = cross.reshape(-1, problem.size)
    return Equations(
        information=information + tied.T @ by_shared.reshape(-1, problem.size),
        gradient=gradient + tied.T @ step.ravel(),
        by_shared=by_shared,
        step=step,
        position_covariance=covariance,
        cost=float(loss @ trust.lengths + drift @ trust.known + before.cost)
        + float((offset**2).sum()),
        lengths=weight,
        known=hold,
    )


def fit(
    problem: MotorAngleProblem, shared: Array, position: Array, trust: Trust, *, steps: int = 100
) -> SampleFit:
    """Find the best values downhill of a start (Levenberg-Marquardt).

    Args:
        problem: The samples.
        shared: Start of the shared unknowns, shape (m,).
        position: Start of the own unknowns, shape (N, own).
        trust: Data that count.
        steps: At most.
    """
    damping, converged = 1e-3, False
    system = equations(problem, shared, position, trust, damping)
    for _ in range(steps):
        while damping < DAMPING_MAX:
            change = -_solve(system.information, system.gradient)
            moved = position + system.step + system.by_shared @ change
            milder = max(damping / 10.0, DAMPING_MIN)
            new = equations(problem, shared + change, moved, trust, milder)
            if new.cost <= system.cost:
                break
            damping *= 5.0
            system = equations(problem, shared, position, trust, damping)
        else:
            break
        gain, damping = system.cost - new.cost, milder
        shared, position, system = shared + change, moved, new
        converged = gain <= COST_CHANGE_MIN * (system.cost + 1.0)
        if converged:
            break
    cost = system.cost
    return SampleFit(shared=shared, position=position, cost=cost, converged=converged)


def free_lengths(problem: MotorAngleProblem) -> int:
    """Return the lengths of a sample beyond those that its position takes."""
    return max(problem.robot.n - problem.own, 1)


def _weights(square: Array, free: int, robust: bool) -> tuple[Array, Array]:
    """Return the weights and losses of squared whitened residuals, shapes (N,)."""
    if not robust:
        return np.ones(len(square)), square
    return cauchy(square, free * CAUCHY_SIGMAS**2)


def inverse(matrix: Array) -> Array:
    """Invert a positive definite matrix whose unknowns have very different scales."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    both = np.outer(scale, scale)
    return np.asarray(np.linalg.inv(matrix * both) * both)


def _solve(matrix: Array, vector: Array) -> Array:
    """Solve a positive definite system whose unknowns have very different scales."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    return np.asarray(scale * np.linalg.solve(matrix * np.outer(scale, scale), vector * scale))
