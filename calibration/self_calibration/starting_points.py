"""A start in the right basin, from what is known roughly.

The distances from an exit point to three known positions or more leave a few places for it: two
where they lie in a plane, mirrored. The cables' places are combined, every position is looked up on
a grid in the workspace, and a robust fit of everything says which combination is right. With fewer
known positions, or a platform that turns, everything is fitted from many drawn starts
(`batch_starts`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.robust import cauchy
from calibration.self_calibration.batch_starts import STAGES, STARTS, batch_starts
from calibration.self_calibration.problem import MotorAngleProblem
from calibration.self_calibration.solver import CAUCHY_SIGMAS, SampleFit, Trust, fit
from carosac_toolkit.base.arrays import Array

GUESS_DIRECTIONS = 24  # from which the places of one exit point are looked for
ROUGH_LENGTH_SHARE = 4e-3  # of the longest cable: noise of lengths with drums as known before
START_NOISE_SHARE = 2e-3  # of the longest cable: noise of the line before residuals are known
PLACES_KEPT = 3  # of one exit point that are kept
PLACE_COST_MAX = 200.0  # squared standard deviations worse than the best place: not kept
COMBINATIONS_KEPT = 32  # combinations that are tried
STARTS_KEPT = 4
QUICK_STARTS = 8
ROUGH_STARTS = 3  # at the prior's mean, drawn, and drawn and mirrored
BATCH_STEPS_MAX = 30  # steps of a fit of all samples after the batch of starts
SAME_PLACE_SHARE = 0.02  # of the length of a cable: exit points that close are the same
GRID_POINTS_PER_SIDE = 6  # points along each side of the workspace


@dataclass(frozen=True, kw_only=True, eq=False)
class Place:
    """A place that an exit point may have.

    Attributes:
        exit_point: In W [m], shape (3,).
        zero: Length at the reference [m].
        cost: Sum of squares, in standard deviations.
    """

    exit_point: Array
    zero: float
    cost: float


def starts(problem: MotorAngleProblem) -> list[SampleFit]:
    """Fit from every plausible start; the best first.

    Args:
        problem: The samples.

    Returns:
        Robust fits that ended at different places, `STARTS_KEPT` at most.
    """
    if problem.own == 6 or not problem.angles.spans_plane:
        return _from_batch(problem)
    choices = [_places(problem, i) for i in range(problem.robot.n)]
    combined: list[tuple[Place, ...]] = [()]
    for places in choices:  # the cheapest of all combinations, cable by cable
        longer = [(*chosen, place) for chosen in combined for place in places]
        combined = sorted(longer, key=lambda chosen: sum(p.cost for p in chosen))[
            :COMBINATIONS_KEPT
        ]
    trust = all_data(problem)
    first = []
    for chosen in combined:
        shared = problem.prior.mean.copy()
        for i, place in enumerate(chosen):
            shared[problem.exits[i]] = place.exit_point
            shared[problem.zeros[i]] = place.zero
        first.append(fit(problem, shared, _positions(problem, shared), trust, steps=12))
    last = [fit(problem, f.shared, f.position, trust) for f in _different(problem, first)]
    return _different(problem, last)


def quick_start(problem: MotorAngleProblem) -> SampleFit:
    """Return the best fit from a few starts, good enough to compare hypotheses."""
    return _from_batch(problem, QUICK_STARTS)[0]


def rough_cost(problem: MotorAngleProblem) -> float:
    """Return the cost of a short fit of points for pulleys, to rank many hypotheses by."""
    batch = batch_starts(problem, np.random.default_rng(0), ROUGH_STARTS, STAGES[:1])
    return float(batch.cost.min())


def _from_batch(problem: MotorAngleProblem, count: int = STARTS) -> list[SampleFit]:
    """Fit everything from where the best starts of a batch ended."""
    batch = batch_starts(problem, np.random.default_rng(0), count)
    trust = all_data(problem)
    ends = []
    for k in range(len(batch.shared)):
        position = _positions(problem, batch.shared[k])
        position[batch.rows] = batch.position[k]
        ends.append(
            SampleFit(
                shared=batch.shared[k],
                position=position,
                cost=float(batch.cost[k]),
                converged=False,
            )
        )
    fits = [
        fit(problem, end.shared, end.position, trust, steps=BATCH_STEPS_MAX)
        for end in _different_shapes(problem, ends)
    ]
    return _different_shapes(problem, fits)


def all_data(problem: MotorAngleProblem) -> Trust:
    """Return a robust trust in all data, with the noise that is assumed at the start."""
    return Trust(
        line_sigma=START_NOISE_SHARE * problem.longest,
        lengths=np.ones(len(problem.angles.samples), dtype=np.bool_),
        known=problem.is_known,
        robust=True,
    )


def _different_shapes(problem: MotorAngleProblem, fits: list[SampleFit]) -> list[SampleFit]:
    """Keep the best of the fits of one shape, however turned or mirrored, the best first."""
    kept: list[tuple[Array, SampleFit]] = []
    near = SAME_PLACE_SHARE * problem.longest
    for solution in sorted(fits, key=lambda one: one.cost):
        points = np.vstack([problem.points(solution.shared), problem.robot.home_position])
        sides = np.linalg.norm(points[:, None] - points, axis=2)
        if all(np.abs(sides - other).max() > near for other, _ in kept):
            kept.append((sides, solution))
    return [solution for _, solution in kept[:STARTS_KEPT]]


def _different(problem: MotorAngleProblem, fits: list[SampleFit]) -> list[SampleFit]:
    """Keep the best of the fits at one place, the best first."""
    kept: list[SampleFit] = []
    near = SAME_PLACE_SHARE * problem.longest
    for solution in sorted(fits, key=lambda one: one.cost):
        here = solution.shared[problem.exits]
        if all(np.abs(here - other.shared[problem.exits]).max() > near for other in kept):
            kept.append(solution)
    return kept[:STARTS_KEPT]


def _places(problem: MotorAngleProblem, cable: int) -> list[Place]:
    """Find places of one exit point by its lengths to the known positions."""
    angles, robot = problem.angles, problem.robot
    known = angles.coordinates_known.all(axis=1)
    anchor = robot.home_rotation @ robot.anchor_points[cable]
    points = angles.known_position[known] + anchor
    zero = float(problem.prior.mean[problem.zeros[cable]])
    change = problem.wound(problem.prior.mean)[known, cable] - zero  # since the reference [m]
    before = robot.exit_points[cable]
    guesses = robot.home_position + anchor + zero * _sphere(GUESS_DIRECTIONS)
    unknown = np.column_stack([np.vstack([before, guesses]), np.full(GUESS_DIRECTIONS + 1, zero)])
    rows = [*problem.exits[cable], problem.zeros[cable]]
    prior: Array = np.asarray(np.linalg.inv(problem.prior.covariance[np.ix_(rows, rows)]), float)
    start, sigma = np.array([*before, zero]), ROUGH_LENGTH_SHARE * problem.longest
    places = [_trilaterated(u, points, change, start, prior, sigma) for u in unknown]
    places.sort(key=lambda place: place.cost)
    kept: list[Place] = []
    for place in places:
        near = SAME_PLACE_SHARE * zero
        new = all(np.linalg.norm(place.exit_point - k.exit_point) > near for k in kept)
        if new and place.cost < places[0].cost + PLACE_COST_MAX:
            kept.append(place)
    return kept[:PLACES_KEPT]


def _trilaterated(
    unknown: Array, points: Array, change: Array, before: Array, prior: Array, length_sigma: float
) -> Place:
    """Fit exit point and length at the reference downhill of a guess, robustly."""
    cost = np.inf
    damping = 1e-3
    trial = unknown
    for _ in range(60):
        ray = trial[:3] - points
        distance = np.maximum(np.linalg.norm(ray, axis=1), 1e-9)
        miss = (distance - trial[3] - change) / length_sigma
        away = trial - before
        weight, loss = cauchy(miss**2, CAUCHY_SIGMAS**2)
        new = float(loss.sum() + away @ prior @ away)
        if new < cost:
            settled = cost - new < 1e-6
            unknown, cost, damping = trial, new, max(damping / 5.0, 1e-9)
            if settled:
                break
            slope = np.column_stack([ray / distance[:, None], -np.ones(len(points))]) / length_sigma
            matrix = (slope.T * weight) @ slope + prior
            vector = (slope.T * weight) @ miss + prior @ away
        else:
            damping *= 5.0
            if damping > 1e9:
                break
        trial = unknown - np.linalg.solve(matrix + damping * np.diag(np.diag(matrix)), vector)
    return Place(exit_point=unknown[:3], zero=float(unknown[3]), cost=cost)


def _positions(problem: MotorAngleProblem, shared: Array) -> Array:
    """Return known positions as they are, the others from a workspace grid, shape (N, 3)."""
    robot = problem.robot
    corners = np.stack([robot.workspace_min, robot.workspace_max])
    sides = [np.linspace(low, high, GRID_POINTS_PER_SIDE) for low, high in corners.T]
    grid = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    grid = np.hstack([grid, np.zeros((len(grid), problem.own - 3))])
    straight, _ = problem.straight(shared, grid)
    best = ((problem.wound(shared)[:, None] - straight) ** 2).sum(axis=2).argmin(axis=1)
    return np.where(problem.known_axes, problem.known_position, grid[best])


def _sphere(count: int) -> Array:
    """Return the directions spread evenly (Fibonacci), shape (count, 3)."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    turn = np.pi * (1.0 + np.sqrt(5.0)) * k
    side = np.sqrt(1.0 - z**2)
    return np.stack([side * np.cos(turn), side * np.sin(turn), z], axis=1)
