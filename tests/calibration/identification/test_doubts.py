"""Derivatives that may be wrong tell less; what they tell is as far off as they say."""

from __future__ import annotations

import numpy as np
import pytest

from calibration.identification.doubts import DOUBT_RATIO, Doubts, Judge, RunDerivatives
from calibration.identification.error_noise import PoseErrorNoise

ERRORS, ROBOT, START = 60, 5, 2
PRIOR = np.eye(ROBOT)


def draw_run(rng, *, wrong: float) -> RunDerivatives:
    return RunDerivatives(
        robot=rng.standard_normal((ERRORS, ROBOT)),
        start=rng.standard_normal((ERRORS, START)),
        doubt=wrong * rng.standard_normal((ERRORS, ROBOT)),
        hidden=np.zeros((ERRORS, 0)),
        weights=rng.uniform(0.5, 2.0, ERRORS),
    )


def test_exact_derivatives_lose_nothing():
    rng = np.random.default_rng(0)
    runs = [draw_run(rng, wrong=0.0) for _ in range(3)]
    doubts = Doubts.of(runs, PRIOR)
    left = PRIOR.copy()
    for k, run in enumerate(runs):
        both = np.hstack([run.robot, run.start])
        assert not doubts.lost(k, run.weights, both, both).any()
        information = both.T @ (run.weights[:, None] * both)
        information[ROBOT:, ROBOT:] += np.eye(START)
        left += np.linalg.inv(np.linalg.inv(information)[:ROBOT, :ROBOT])  # the start is unknown
    assert doubts.precision == pytest.approx(left)


def test_doubt_is_a_further_covariance_of_what_is_predicted():
    rng = np.random.default_rng(1)
    runs = [draw_run(rng, wrong=0.3) for _ in range(3)]
    doubts = Doubts.of(runs, PRIOR)
    left, right = rng.standard_normal((2, ERRORS, 4))
    precision = PRIOR.copy()
    for k, run in enumerate(runs):
        noise = np.diag(1.0 / run.weights)
        covariance = noise + doubts.slopes[k] @ np.linalg.solve(
            doubts.precision, doubts.slopes[k].T
        )
        kept = left.T @ np.linalg.solve(covariance, right)
        plain = left.T @ (run.weights[:, None] * right)
        assert plain - doubts.lost(k, run.weights, left, right) == pytest.approx(kept)
        side, _ = run.beside_start()
        precision += side.T @ np.linalg.solve(covariance, side)
    assert np.linalg.norm(doubts.precision - precision) < 0.01 * np.linalg.norm(precision)


def test_costs_and_products_are_those_of_the_whole_covariance():
    rng = np.random.default_rng(5)
    doubts = Doubts.of([draw_run(rng, wrong=0.3) for _ in range(2)], PRIOR)
    sigma = np.repeat([0.5, 0.7], 3)
    judge = Judge(noise=PoseErrorNoise(sigma=sigma, repeats=np.ones(6)), doubts=doubts)
    errors = 1e-3 * rng.standard_normal((ERRORS // 6, 6))  # so small that none counts for less
    flat, left = errors.ravel(), rng.standard_normal((ERRORS, 3))
    wrong = doubts.slopes[1] @ np.linalg.solve(doubts.precision, doubts.slopes[1].T)
    covariance = np.diag(np.tile(sigma**2, ERRORS // 6)) + wrong
    told = np.linalg.solve(covariance, flat)
    assert judge.cost(1, errors) == pytest.approx(flat @ told)
    assert judge.product(1, errors, left, flat[:, None])[:, 0] == pytest.approx(left.T @ told)
    alone = Judge(noise=judge.noise)
    assert alone.cost(1, errors) == pytest.approx(((errors / sigma) ** 2).sum())


def test_what_is_hidden_is_a_further_covariance_too():
    rng = np.random.default_rng(4)
    runs = [draw_run(rng, wrong=0.3) for _ in range(3)]
    columns = [0.5 * rng.standard_normal((ERRORS, k)) for k in (2, 0, 3)]
    hidden = [
        RunDerivatives(**(vars(run) | {"hidden": each}))
        for run, each in zip(runs, columns, strict=True)
    ]
    doubts, plain = Doubts.of(hidden, PRIOR), Doubts.of(runs, PRIOR)
    assert np.linalg.eigvalsh(plain.precision - doubts.precision)[0] > -1e-9  # it tells less
    left = rng.standard_normal((ERRORS, 4))
    for k, run in enumerate(hidden):
        wrong, beyond = np.split(doubts.slopes[k], [ROBOT], axis=1)
        assert beyond.shape == columns[k].shape
        covariance = np.diag(1.0 / run.weights) + beyond @ beyond.T
        covariance += wrong @ np.linalg.solve(doubts.precision, wrong.T)
        kept = left.T @ np.linalg.solve(covariance, left)
        weighted = left.T @ (run.weights[:, None] * left)
        assert weighted - doubts.lost(k, run.weights, left, left) == pytest.approx(kept)


def test_a_start_makes_up_for_what_moves_the_platform_alike():
    rng = np.random.default_rng(2)
    run = draw_run(rng, wrong=0.0)
    doubt = run.start @ rng.standard_normal((START, ROBOT))
    doubts = Doubts.of([RunDerivatives(**(vars(run) | {"doubt": doubt}))], PRIOR)
    assert np.linalg.norm(doubts.slopes[0]) < 0.1 * np.linalg.norm(doubt)


def test_parameters_are_as_far_off_as_derivatives_that_differ_say():
    """The right derivatives of some runs are anywhere between two kinds that differ."""
    rng = np.random.default_rng(3)
    squares = {"believed": [], "doubted": []}
    for _ in range(50):
        true, runs, right, rest = rng.standard_normal(ROBOT), [], [], []
        for k in range(6):
            run = draw_run(rng, wrong=0.0)
            differs = np.zeros((ERRORS, ROBOT))
            if k < 4:
                differs[:, 0] = 6.0 * rng.standard_normal(ERRORS)
            right.append(run.robot)
            seen = run.robot + rng.uniform(-0.5, 0.5) * differs  # the mean of both
            noise = rng.standard_normal(ERRORS) / np.sqrt(run.weights)
            rest.append(run.start @ rng.standard_normal(START) + noise)
            runs.append(RunDerivatives(**(vars(run) | {"robot": seen, "doubt": differs})))
        for name, size in (("believed", 0.0), ("doubted", DOUBT_RATIO)):
            taken = [RunDerivatives(**(vars(r) | {"doubt": size * r.doubt})) for r in runs]
            squares[name].append(squared_error(taken, right, rest, true))
    assert np.mean(squares["believed"]) > 10.0  # sigmas are far too small
    assert 0.7 < np.mean(squares["doubted"]) < 1.7


def squared_error(runs, right, rest, true) -> float:
    """Search, and return the squared error of the first parameter over its variance."""
    doubts = Doubts.of(runs, PRIOR)
    found = np.zeros(ROBOT)
    for _ in range(30):
        gradient = -PRIOR @ found
        for k, (run, slope) in enumerate(zip(runs, right, strict=True)):
            error = slope @ (true - found) + rest[k]
            side, _ = run.beside_start()
            lost = doubts.lost(k, run.weights, side, error[:, None])[:, 0]
            gradient += side.T @ (run.weights * error) - lost
        found += 0.5 * np.linalg.solve(doubts.precision, gradient)
    return float((found - true)[0] ** 2 / np.linalg.inv(doubts.precision)[0, 0])
