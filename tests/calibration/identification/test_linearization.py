"""Linear functions over what is uncertain: exact of linear ones, and deaf to ruggedness."""

from __future__ import annotations

import numpy as np
import pytest

from calibration.identification.linearization import (
    Linearization,
    axes_of_robot,
    bent_coordinate,
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
    return rows, scattered_moves(axes, hessian, np.linalg.inv(hessian), ROBOT, rows, bounds, k)


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


def test_runs_are_turned_otherwise_and_each_the_same_again():
    hessian = draw_hessian(np.random.default_rng(9))
    one, other, again = (moves_of(hessian, k)[1][:, :ROBOT] for k in (0, 1, 0))
    assert (one == again).all() and np.abs(one - other).max() > 0.1 * one.std()


@pytest.fixture
def damped():
    """Moves of runs, slopes of a line, the line, and that plus a power of ten of one coordinate.

    As damping of cables does along its logarithm. Of that one and another little is known, so that
    points scatter far along both.
    """
    rng = np.random.default_rng(7)
    hessian = 100.0 * draw_hessian(rng)
    wide = np.where(np.arange(len(hessian)) < 2, 0.01, 1.0)
    hessian *= wide[:, None] * wide
    hessian[:2, :2] += [[2.0, 0.5], [0.5, 2.0]]
    moves = [moves_of(hessian, k)[1] for k in range(RUNS)]
    scatter = moves[0][:, :ROBOT].std(axis=0)
    assert (scatter[:2] > 0.5).all() and (scatter[2:] < 0.1).all()
    slopes = [0.1 * rng.standard_normal((each.shape[1], POSES, 6)) for each in moves]
    straight = [np.einsum("dq,qnc->dnc", *both) for both in zip(moves, slopes, strict=True)]
    bend = rng.standard_normal((RUNS, POSES, 6))
    bent = [
        line + 10.0 ** each[:, 0, None, None] * size
        for line, each, size in zip(straight, moves, bend, strict=True)
    ]
    return moves, slopes, straight, bent, bend


def test_a_hardly_known_coordinate_that_bends_motion_leaves_the_slopes_of_others(damped):
    moves, slopes, _, bent, bend = damped
    sigma = np.log(10.0) * moves[0][:, 0].std()
    average = np.log(10.0) * np.exp(0.5 * sigma**2)  # derivative of normal draws
    for each, true, errors, size in zip(moves, slopes, bent, bend, strict=True):
        plain, found = (Linearization.of(each, errors, j) for j in (None, 0))
        off, less = (np.abs(one.slopes - true)[1:].max() for one in (plain, found))
        assert less < 0.3 * off
        assert (found.chance**2).sum() < 0.1 * (plain.chance**2).sum()
        assert found.slopes[0] - true[0] == pytest.approx(average * size, rel=0.25)


def test_a_third_power_is_doubted_as_before():
    _, moves = moves_of(draw_hessian(np.random.default_rng(5)), 0)
    errors = (moves[:, 0] ** 3)[:, None, None] * np.ones((POSES, 6))
    found = Linearization.of(moves, errors, 0)
    assert np.abs(found.chance).max() < 1e-9 * np.abs(errors).max()
    variance = np.einsum("nd,nd->n", found.beyond, found.beyond)
    assert variance == pytest.approx(6.0 * moves[:, 0].std() ** 6)  # of normal draws


def test_beside_a_third_power_slopes_take_up_as_much_noise_as_is_said(damped):
    rng, (moves, *_) = np.random.default_rng(10), damped
    found = Linearization.of(moves[0], rng.standard_normal((len(moves[0]), 400, 6)), 0)
    slopes = found.slopes.reshape(len(found.slopes), -1)
    chance = (found.chance**2).sum() / slopes.shape[1]
    root = np.linalg.cholesky(found.scatter)
    shares = np.linalg.eigvalsh(root.T @ np.cov(slopes) @ root) / chance
    assert (shares > 0.8).all() and (shares < 1.25).all()
    variance = np.einsum("nd,nd->n", found.beyond, found.beyond)
    even_odd_and_bend = 0.5 + 0.5 + 6.0 / (2.0 * _left_of_third_power(moves[0]))
    assert variance.mean() == pytest.approx(even_odd_and_bend, rel=0.1)


def _left_of_third_power(moves) -> float:
    """Return the square of what slopes leave of the third power of the first coordinate, ahead."""
    ahead = moves[: len(moves) // 2]
    share = ahead[:, 0] / np.sqrt((ahead[:, 0] ** 2).mean())
    power = share**3 - 3.0 * share
    left = power - ahead @ np.linalg.lstsq(ahead, power, rcond=None)[0]
    return float(left @ left)


def test_a_third_power_counts_where_it_explains_most_of_what_is_beyond(damped):
    moves, _, straight, bent, _ = damped
    rng, sigma = np.random.default_rng(8), np.full(6, 0.5)
    assert bent_coordinate(moves, bent, ROBOT, sigma) == 0
    rugged = [10.0 * rng.standard_normal(each.shape) for each in straight]
    one_rugged = [bent[0], bent[1] + rugged[1], bent[2]]
    assert bent_coordinate(moves, one_rugged, ROBOT, sigma) == 0
    noise = [each + more for each, more in zip(straight, rugged, strict=True)]
    assert bent_coordinate(moves, noise, ROBOT, sigma) is None
    assert bent_coordinate(moves, [np.zeros_like(each) for each in straight], ROBOT, sigma) is None


def test_moves_are_as_short_as_what_is_known_best():
    """Also where it is known a million times as well as what is known worst."""
    told = 10.0 ** np.linspace(0.0, 12.0, ROBOT)
    axes = np.linalg.qr(np.random.default_rng(5).standard_normal((ROBOT, ROBOT)))[0]
    hessian = np.eye(ROBOT + START)
    hessian[:ROBOT, :ROBOT] = (axes * told) @ axes.T
    moves = axes_of_robot(hessian, np.ones(len(hessian), dtype=bool), ROBOT)
    assert np.sort(np.linalg.norm(moves, axis=1))[:2] == pytest.approx([1e-6, 10**-4.5], rel=0.01)
