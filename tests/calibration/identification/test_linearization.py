"""Linear functions over what is uncertain: exact of linear ones, and deaf to ruggedness."""

from __future__ import annotations

import numpy as np
import pytest

from calibration.identification.linearization import (
    Linearization,
    axes_of_robot,
    scattered_moves,
)

ROBOT, START, RUNS, POSES = 5, 2, 3, 20


def draw_hessian(rng) -> np.ndarray:
    """Return one of a robot and the starts of some runs, each of which knows nothing of others."""
    size = ROBOT + START * RUNS
    hessian = 4.0 * np.eye(size)
    for k in range(RUNS):
        rows = np.r_[:ROBOT, rows_of_start(k)]
        slopes = rng.standard_normal((30, len(rows)))
        hessian[np.ix_(rows, rows)] += slopes.T @ slopes
    return hessian


def rows_of_start(k: int) -> np.ndarray:
    return ROBOT + START * k + np.arange(START)


def moves_of(hessian, k, lower=-np.inf) -> tuple[np.ndarray, np.ndarray]:
    """Return rows of the coordinates of a run, and its moves."""
    searched = np.ones(len(hessian), dtype=bool)
    rows = np.r_[:ROBOT, rows_of_start(k)]
    axes = axes_of_robot(hessian, searched, ROBOT)
    bounds = np.where(np.arange(len(hessian)) == 1, lower, -np.inf)
    return rows, scattered_moves(axes, hessian, np.linalg.inv(hessian), ROBOT, rows, bounds)


def test_moves_scatter_as_the_covariance_says():
    hessian = draw_hessian(np.random.default_rng(0))
    for k in range(RUNS):
        rows, moves = moves_of(hessian, k)
        assert moves.sum(axis=0) == pytest.approx(0.0, abs=1e-12)
        covariance = np.linalg.inv(hessian)[np.ix_(rows, rows)]
        assert moves.T @ moves / len(moves) == pytest.approx(covariance)


def test_moves_end_at_bounds():
    _, moves = moves_of(draw_hessian(np.random.default_rng(1)), 1, lower=-0.01)
    assert moves[:, 1].min() == -0.01
    assert np.linalg.matrix_rank(moves) == moves.shape[1]


def test_a_linear_function_is_found_and_nothing_is_beyond():
    rng = np.random.default_rng(2)
    _, moves = moves_of(draw_hessian(rng), 0, lower=-0.01)
    here, slopes = rng.standard_normal((POSES, 6)), rng.standard_normal((moves.shape[1], POSES, 6))
    found = Linearization.of(moves, here + np.einsum("dq,qnc->dnc", moves, slopes))
    assert found.mean == pytest.approx(here) and found.slopes == pytest.approx(slopes)
    assert np.abs(found.beyond).max() < 1e-9


def test_a_curve_counts_by_its_mean_and_what_is_beyond():
    rng = np.random.default_rng(3)
    hessian = draw_hessian(rng)
    rows, moves = moves_of(hessian, 0)
    bend = rng.standard_normal((len(rows), len(rows)))
    errors = np.einsum("di,ij,dj->d", moves, bend, moves)[:, None, None] * np.ones((POSES, 6))
    found = Linearization.of(moves, errors)
    covariance = np.linalg.inv(hessian)[np.ix_(rows, rows)]
    assert found.mean == pytest.approx(np.trace(bend @ covariance) * np.ones((POSES, 6)))
    assert np.abs(found.slopes).max() < 1e-9 * np.abs(errors).max()
    pairs = errors[: len(errors) // 2, 0, 0]  # both ends of a pair are alike
    variance = np.einsum("nd,nd->n", found.beyond, found.beyond)
    assert variance == pytest.approx(np.var(pairs, ddof=1))
    assert np.abs(found.chance).max() < 1e-9 * np.abs(errors).max()


def test_ruggedness_is_noise_and_tells_little():
    """Errors that wiggle as coordinates change, and else stay: short steps would tell of it."""
    rng = np.random.default_rng(4)
    _, moves = moves_of(draw_hessian(rng), 0)
    waves = 300.0 * rng.standard_normal((ROBOT + START, POSES, 6))
    phase = rng.uniform(0.0, 2.0 * np.pi, (POSES, 6))
    errors = np.sin(np.einsum("dq,qnc->dnc", moves, waves) + phase)
    found = Linearization.of(moves, errors)
    variance = np.einsum("nd,nd->n", found.beyond, found.beyond).mean()
    assert variance == pytest.approx(0.5, rel=0.2)  # all of it counts as noise
    root = np.linalg.cholesky(moves.T @ moves / len(moves))
    one, short = (
        root.T @ each.reshape(len(root), -1) for each in (found.slopes, np.cos(phase) * waves)
    )  # by one sigma along axes of the covariance
    told = np.einsum("qn,qn->q", one, one)
    assert told.mean() == pytest.approx((found.chance**2).sum(), rel=0.3)
    assert told.sum() < 0.1 * np.einsum("qn,qn->", short, short)


def test_along_a_cubic_slopes_are_those_of_a_line_through_all_points():
    """And what is beyond shows in differences alone."""
    _, moves = moves_of(draw_hessian(np.random.default_rng(5)), 0)
    errors = (moves[:, 0] ** 3)[:, None, None] * np.ones((POSES, 6))
    found = Linearization.of(moves, errors)
    slopes = np.linalg.lstsq(moves, errors[:, 0, 0], rcond=None)[0]
    assert found.slopes[:, 0, 0] == pytest.approx(slopes)
    assert np.abs(found.mean).max() < 1e-9 * np.abs(errors).max()
    left = errors[:, 0, 0] - moves @ slopes
    freedoms = len(moves) // 2 - moves.shape[1]
    variance = np.einsum("nd,nd->n", found.beyond, found.beyond)
    assert variance == pytest.approx(0.5 * left @ left / freedoms)


def test_moves_are_as_short_as_what_is_known_best():
    """Also where it is known a million times as well as what is known worst."""
    told = 10.0 ** np.linspace(0.0, 12.0, ROBOT)
    axes = np.linalg.qr(np.random.default_rng(5).standard_normal((ROBOT, ROBOT)))[0]
    hessian = np.eye(ROBOT + START)
    hessian[:ROBOT, :ROBOT] = (axes * told) @ axes.T
    moves = axes_of_robot(hessian, np.ones(len(hessian), dtype=bool), ROBOT)
    assert np.sort(np.linalg.norm(moves, axis=1))[:2] == pytest.approx([1e-6, 10**-4.5], rel=0.01)
