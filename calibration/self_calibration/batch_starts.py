"""Starts for few or no known positions: many fits at once, from points drawn from the prior.

Exit points are drawn from what is known before, half of them mirrored, and positions follow from
them. All are fitted side by side, robustly, first to within a few percent of the cable lengths and
then ever more closely, so that far-off starts find their way (graduated non-convexity). Cables end
at the exit points here: what pulleys add is small beside the noise that is assumed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.robust import cauchy
from calibration.self_calibration.problem import MotorAngleProblem
from calibration.self_calibration.solver import (
    CAUCHY_SIGMAS,
    free_lengths,
)
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import from_rotation_vector, left_jacobian

STARTS = 96
SAMPLES_MAX = 60  # that the starts are fitted to
MIRRORED_EVERY = 3  # one start in so many is mirrored
PLACING_STEPS = 15  # Gauss-Newton steps of the positions alone
FIRM_STEPS = 4  # of these that are damped heavily
STAGES = ((0.03, 12), (0.006, 10), (0.002, 20))  # noise of the line over the longest cable, steps
DAMPING_START = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class Starts:
    """K starts and where they ended.

    Attributes:
        shared: Shape (K, m).
        position: Own unknowns of the samples that were used, shape (K, S, own).
        rows: Their numbers, shape (S,).
        cost: Robust, with the last stage's noise, shape (K,).
    """

    shared: Array
    position: Array
    rows: NDArray[np.intp]
    cost: Array


def batch_starts(
    problem: MotorAngleProblem,
    rng: np.random.Generator,
    count: int = STARTS,
    stages: tuple[tuple[float, int], ...] = STAGES,
) -> Starts:
    """Fit from many starts at once.

    Args:
        problem: The samples.
        rng: Generator of the starts.
        count: How many.
        stages: Noise of the line over the longest cable, and steps, of one stage after the other.
    """
    batch = _Batch(problem, _chosen(problem))
    shared = _drawn(problem, rng, count)
    position = batch.placed(shared)
    cost = np.zeros(len(shared))
    for share, steps in stages:
        shared, position, cost = batch.fitted(shared, position, share * problem.longest, steps)
    return Starts(shared=shared, position=position, rows=batch.rows, cost=cost)


def _chosen(problem: MotorAngleProblem) -> NDArray[np.intp]:
    """Return the samples to start with: those with known coordinates, and others evenly."""
    count = len(problem.angles.samples)
    known = np.flatnonzero(problem.is_known)
    others = np.flatnonzero(~problem.is_known)
    room = min(max(SAMPLES_MAX - len(known), 0), len(others))
    even = others[np.linspace(0, len(others) - 1, room).round().astype(int)] if room else others[:0]
    rows = np.unique(np.concatenate([known, even]))
    return np.asarray(rows if count > SAMPLES_MAX else np.arange(count), dtype=np.intp)


def _drawn(problem: MotorAngleProblem, rng: np.random.Generator, count: int) -> Array:
    """Draw shared unknowns from the prior, the first at its mean, some mirrored, (K, m).

    Distance from home and length at the reference are the same: where both were drawn, the mean
    by their variances counts.
    """
    prior, home = problem.prior, problem.robot.home_position
    root = np.linalg.cholesky(prior.covariance / np.outer(prior.sigma, prior.sigma))
    draw = rng.normal(size=(count, problem.size)) @ root.T * prior.sigma
    draw[0] = 0.0
    draw[:, [*problem.radii, *problem.buildups]] = 0.0
    shared = prior.mean + draw
    offset = problem.offsets + home
    ray = shared[:, problem.exits] - offset
    normal = rng.normal(size=(count, 1, 3))
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    mirrored = ray - 2.0 * (ray * normal).sum(axis=2, keepdims=True) * normal
    flip = np.arange(count) % MIRRORED_EVERY == MIRRORED_EVERY - 1
    ray = np.where(flip[:, None, None], mirrored, ray)
    distance = np.maximum(np.linalg.norm(ray, axis=2), 1e-9)
    by_exit = prior.sigma[problem.exits].mean(axis=1) ** 2
    by_zero = prior.sigma[problem.zeros] ** 2
    length = (by_exit * shared[:, problem.zeros] + by_zero * distance) / (by_exit + by_zero)
    length = np.maximum(length, 1e-3 * problem.longest)
    ray *= (length / distance)[:, :, None]
    shared[:, problem.zeros] = length
    shared[:, problem.exits.ravel()] = (ray + offset).reshape(count, -1)
    return shared


class _Batch:
    """The equations of `solver` for K values of all unknowns at once, with points for pulleys."""

    def __init__(self, problem: MotorAngleProblem, rows: NDArray[np.intp]) -> None:
        """Set up with some of the samples."""
        self.rows, self._problem = rows, problem
        mean = problem.prior.mean
        self._by_shared = problem.wound_slope(mean, rows)
        self._wound = problem.wound(mean, rows) - self._by_shared @ mean
        self._axes = problem.known_axes[rows]
        self._hold = self._axes / problem.known_sigma[rows] ** 2
        self._place = np.where(self._axes, problem.known_position[rows], problem.home)
        self._loose = problem.reach**-2

    def placed(self, shared: Array) -> Array:
        """Return the positions that fit the lengths, found from within the workspace."""
        robot = self._problem.robot
        middle = self._problem.home.copy()
        middle[:3] = 0.5 * (robot.workspace_min + robot.workspace_max)
        position = np.where(self._axes, self._place, middle)
        position = np.broadcast_to(position, (len(shared), *position.shape)).copy()
        for step in range(PLACING_STEPS):
            residual, direction = self._residual(shared, position)
            direction = direction[..., :3]
            square = np.einsum("ksia,ksib->ksab", direction, direction)
            square += (0.3 if step < FIRM_STEPS else 1e-3) * np.eye(3)
            pull = np.einsum("ksia,ksi->ksa", direction, residual)
            move = np.linalg.solve(square, pull[..., None])[..., 0]
            moved = np.where(self._axes[:, :3], position[..., :3], position[..., :3] + move)
            position[..., :3] = moved
        return position

    def fitted(
        self, shared: Array, position: Array, line_sigma: float, steps: int
    ) -> tuple[Array, Array, Array]:
        """Fit all starts robustly (Levenberg-Marquardt); returns also their costs, shape (K,)."""
        damping = np.full(len(shared), DAMPING_START)
        cost, weight = self._cost(shared, position, line_sigma)
        for _ in range(steps):
            trial, place = self._step(shared, position, weight, line_sigma, damping)
            new, lighter = self._cost(trial, place, line_sigma)
            better = new < cost
            shared = np.where(better[:, None], trial, shared)
            position = np.where(better[:, None, None], place, position)
            cost = np.where(better, new, cost)
            weight = np.where(better[:, None], lighter, weight)
            damping = np.where(better, np.maximum(damping / 10.0, 1e-12), damping * 5.0)
        return shared, position, cost

    def _residual(self, shared: Array, position: Array) -> tuple[Array, Array]:
        """Return wound less straight lengths, (K, S, n).

        Second are the derivatives of the straight lengths by the own unknowns, (K, S, n, own).
        """
        arm = self._problem.offsets
        if self._problem.own == 6:
            turn = from_rotation_vector(position[..., 3:])
            arm = arm @ turn.swapaxes(2, 3)
        ray = position[:, :, None, :3] + arm - shared[:, self._problem.exits][:, None]
        length = np.maximum(np.linalg.norm(ray, axis=3), 1e-9)
        wound = self._wound + np.einsum("sim,km->ksi", self._by_shared, shared)
        slope = ray / length[..., None]
        if self._problem.own == 6:
            moment = np.cross(arm, slope) @ left_jacobian(position[..., 3:])
            slope = np.concatenate([slope, moment], axis=3)
        return wound - length, slope

    def _cost(self, shared: Array, position: Array, line_sigma: float) -> tuple[Array, Array]:
        """Return the costs, shape (K,), and the weights of the samples, shape (K, S)."""
        residual, _ = self._residual(shared, position)
        white = residual * self._problem.advantage / line_sigma
        free = free_lengths(self._problem)
        weight, loss = cauchy((white**2).sum(axis=2), free * CAUCHY_SIGMAS**2)
        moved = shared - self._problem.prior.mean
        information = self._problem.prior.information
        cost = loss.sum(axis=1) + np.einsum("ki,ij,kj->k", moved, information, moved)
        cost += (self._loose * (position - self._problem.home) ** 2).sum(axis=(1, 2))
        cost += (self._hold * (position - self._place) ** 2).sum(axis=(1, 2))
        for distance, miss, _ in self._distances(shared):
            cost += (miss / distance) ** 2
        return cost, weight

    def _distances(self, shared: Array) -> list[tuple[float, Array, Array]]:
        """Return for each measured distance its sigma, the errors (K,) and their slopes (K, m)."""
        both = [self._problem.distances(one) for one in shared]
        return [
            (
                distance.sigma,
                np.array([miss[k] for miss, _ in both]),
                np.array([slope[k] for _, slope in both]),
            )
            for k, distance in enumerate(self._problem.settings.distances)
        ]

    def _step(
        self, shared: Array, position: Array, weight: Array, line_sigma: float, damping: Array
    ) -> tuple[Array, Array]:
        """Return shared unknowns and positions after one damped step."""
        problem, count = self._problem, len(shared)
        residual, direction = self._residual(shared, position)
        scale = problem.advantage / line_sigma
        by_shared = np.repeat(self._by_shared[None], count, axis=0)
        for i, place in enumerate(problem.exits):
            by_shared[:, :, i, place] = direction[:, :, i, :3]
        white = residual * scale
        by_shared *= scale[:, None]
        own = -direction * scale[:, None]
        heavy = own * weight[:, :, None, None]
        square = np.einsum("ksia,ksib->ksab", heavy, own)
        diagonal = np.arange(problem.own)
        square[:, :, diagonal, diagonal] += self._loose + self._hold
        square[:, :, diagonal, diagonal] *= 1.0 + damping[:, None, None]
        pull = np.einsum("ksia,ksi->ksa", heavy, white) + self._hold * (position - self._place)
        pull += self._loose * (position - problem.home)
        cross = np.einsum("ksia,ksim->ksam", heavy, by_shared)
        inverse = np.linalg.inv(square)
        follow = -inverse @ cross
        step = -np.einsum("ksab,ksb->ksa", inverse, pull)
        flat = by_shared.reshape(count, -1, problem.size)
        each = np.repeat(weight, residual.shape[2], axis=1)
        moved = shared - problem.prior.mean
        matrix = (flat * each[..., None]).swapaxes(1, 2) @ flat + problem.prior.information
        vector = np.einsum("kqm,kq->km", flat, each * white.reshape(count, -1))
        vector += moved @ problem.prior.information
        for sigma, miss, slope in self._distances(shared):
            matrix += slope[:, :, None] * slope[:, None] / sigma**2
            vector += slope * (miss / sigma**2)[:, None]
        entries = np.arange(problem.size)
        matrix[:, entries, entries] *= 1.0 + damping[:, None]
        tied = cross.reshape(count, -1, problem.size)
        matrix += tied.swapaxes(1, 2) @ follow.reshape(count, -1, problem.size)
        vector += np.einsum("kqm,kq->km", tied, step.reshape(count, -1))
        size = 1.0 / np.sqrt(np.maximum(matrix[:, entries, entries], np.finfo(float).tiny))
        scaled = matrix * size[:, :, None] * size[:, None]
        change = -size * np.linalg.solve(scaled, (vector * size)[..., None])[..., 0]
        return shared + change, position + step + np.einsum("ksam,km->ksa", follow, change)
