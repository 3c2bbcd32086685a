"""What errors of a run have in common is a further covariance, and tells that much less."""

from __future__ import annotations

import numpy as np
import pytest

from calibration.identification.doubts import Doubts, Judge
from calibration.identification.error_noise import PoseErrorNoise

ERRORS, START = 60, 2


def draw(rng, *, columns: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return columns, derivatives by a start, and weights of a run."""
    return (
        0.5 * rng.standard_normal((ERRORS, columns)),
        rng.standard_normal((ERRORS, START)),
        rng.uniform(0.5, 2.0, ERRORS),
    )


def test_nothing_in_common_loses_nothing():
    rng = np.random.default_rng(0)
    columns, start, weights = draw(rng, columns=0)
    doubts = Doubts.beside_starts([columns], [start], [weights])
    left = rng.standard_normal((ERRORS, 4))
    assert not doubts.lost(0, weights, left, left).any()


def test_what_errors_have_in_common_is_a_further_covariance():
    rng = np.random.default_rng(1)
    runs = [draw(rng, columns=k) for k in (3, 0, 70)]  # also more than there are errors
    doubts = Doubts.beside_starts(*zip(*runs, strict=True))
    left, right = rng.standard_normal((2, ERRORS, 4))
    for k, (columns, _, weights) in enumerate(runs):
        common = doubts.columns[k]
        assert common.shape == columns.shape
        covariance = np.diag(1.0 / weights) + common @ common.T
        kept = left.T @ np.linalg.solve(covariance, right)
        plain = left.T @ (weights[:, None] * right)
        assert plain - doubts.lost(k, weights, left, right) == pytest.approx(kept)


def test_costs_and_products_are_those_of_the_whole_covariance():
    rng = np.random.default_rng(5)
    doubts = Doubts.beside_starts(*zip(*[draw(rng, columns=5) for _ in range(2)], strict=True))
    sigma = np.repeat([0.5, 0.7], 3)
    judge = Judge(noise=PoseErrorNoise(sigma=sigma, repeats=np.ones(6)), doubts=doubts)
    errors = 1e-3 * rng.standard_normal((ERRORS // 6, 6))  # so small that none counts for less
    flat, left = errors.ravel(), rng.standard_normal((ERRORS, 3))
    common = doubts.columns[1] @ doubts.columns[1].T
    told = np.linalg.solve(np.diag(np.tile(sigma**2, ERRORS // 6)) + common, flat)
    assert judge.cost(1, errors) == pytest.approx(flat @ told)
    product = judge.product(1, errors, left, flat[:, None])[:, 0]
    assert product == pytest.approx(left.T @ told, rel=1e-5)
    alone = Judge(noise=judge.noise)
    assert alone.cost(1, errors) == pytest.approx(((errors / sigma) ** 2).sum())


def test_a_start_makes_up_for_what_moves_the_platform_alike():
    rng = np.random.default_rng(2)
    _, start, weights = draw(rng, columns=0)
    alike = start @ rng.standard_normal((START, 3))
    doubts = Doubts.beside_starts([alike], [start], [weights])
    assert np.linalg.norm(doubts.columns[0]) < 0.1 * np.linalg.norm(alike)
