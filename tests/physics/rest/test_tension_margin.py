"""Largest margins against an independent linear program, their own proofs, and by hand."""

import numpy as np
import pytest
from scipy.optimize import linprog

import carosac_toolkit as ct
from benchmarks.workspace import linear_program, random_poses
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.rest import tension_margin
from carosac_toolkit.physics.rest.structure import structure_matrix


def by_highs(matrix, wrench, lower, upper):
    n = matrix.shape[1]
    eye, ones = np.eye(n), np.ones((n, 1))
    answer = linprog(
        np.append(np.zeros(n), -1.0),
        A_ub=np.block([[-eye, ones], [eye, ones]]),
        b_ub=np.concatenate([-lower, upper]),
        A_eq=np.hstack([matrix, np.zeros((6, 1))]),
        b_eq=-wrench,
        bounds=[(None, None)] * (n + 1),
    )
    assert answer.status == 0
    return answer.x[-1]


def weight_of(robot, rotation):
    force = np.array([0.0, 0.0, -robot.weight])
    return np.hstack(
        [np.tile(force, (len(rotation), 1)), np.cross(rotation @ robot.center_of_mass, force)]
    )


@pytest.mark.parametrize("name", ["ipanema1", "cogiro"])
def test_margins_of_bundled_robots_are_those_of_a_linear_program(name):
    robot = ct.load_robot(name)
    position, rotation = random_poses(robot, 150, 1)
    matrix = structure_matrix(robot, position, rotation)
    margins = tension_margin.solve(
        matrix, weight_of(robot, rotation), robot.tension_min, robot.tension_max
    )
    exact = [linear_program(robot, p, r) for p, r in zip(position, rotation, strict=True)]
    assert margins.solved.all()
    assert margins.margin == pytest.approx(np.array(exact), rel=1e-9, abs=1e-8)
    assert (margins.margin > 0.0).any() and (margins.margin < 0.0).any()


@pytest.mark.parametrize("n", [6, 7, 9, 12])
def test_margins_hold_for_any_redundancy_and_prove_themselves(n):
    rng = np.random.default_rng(n)
    matrix = rng.standard_normal((40, 6, n))
    wrench = 300.0 * rng.standard_normal((40, 6))
    lower, upper = rng.uniform(5.0, 20.0, n), rng.uniform(200.0, 400.0, n)
    margins = tension_margin.solve(matrix, wrench, lower, upper)
    assert margins.solved.all()
    for k in range(40):
        exact = by_highs(matrix[k], wrench[k], lower, upper)
        assert margins.margin[k] == pytest.approx(exact, rel=1e-9, abs=1e-8)
    # Weak duality, from nothing but the multipliers and the problem.
    assert np.einsum("bij,bj->bi", matrix, margins.tension) == pytest.approx(-wrench, abs=1e-8)
    assert (margins.low >= 0.0).all() and (margins.high >= 0.0).all()
    assert (margins.low + margins.high).sum(axis=1) == pytest.approx(1.0)
    for k in range(40):
        dual = np.linalg.lstsq(matrix[k].T, margins.low[k] - margins.high[k], rcond=None)[0]
        assert matrix[k].T @ dual == pytest.approx(margins.low[k] - margins.high[k], abs=1e-9)
        bound = margins.high[k] @ upper - margins.low[k] @ lower - dual @ wrench[k]
        assert margins.margin[k] == pytest.approx(bound, abs=1e-8)


def test_margin_in_the_middle_of_a_symmetric_robot_by_hand():
    robot = ct.load_robot("ipanema1")
    rotation = np.eye(3)[None]
    matrix = structure_matrix(robot, [[0.0, 0.0, 1.0]], rotation)
    margins = tension_margin.solve(
        matrix, weight_of(robot, rotation), robot.tension_min, robot.tension_max
    )
    # Four cables at T up, four at B down: T - B = W / (4 sine), T = 720 - s, B = 10 + s.
    sine = 1.0 / np.sqrt(1.94**2 + 1.44**2 + 1.0)
    assert margins.margin[0] == pytest.approx((710.0 - robot.weight / (4.0 * sine)) / 2.0)


def test_multipliers_say_what_a_newton_of_limit_is_worth():
    robot = ct.load_robot("cogiro")
    position, rotation = random_poses(robot, 20, 3)
    matrix, load = structure_matrix(robot, position, rotation), weight_of(robot, rotation)
    lower, upper = robot.tension_min, robot.tension_max
    base = tension_margin.solve(matrix, load, lower, upper)
    for i in range(robot.n):
        step = np.zeros(robot.n)
        step[i] = 1e-4
        looser = tension_margin.solve(matrix, load, lower - step, upper)
        gain = (looser.margin - base.margin) / 1e-4
        assert gain == pytest.approx(base.low[:, i], abs=1e-5)


def test_no_tensions_balance_what_no_cable_can_pull():
    matrix = np.random.default_rng(0).standard_normal((2, 6, 8))
    matrix[:, 5] = 0.0
    wrench = np.zeros((2, 6))
    wrench[:, 0] = 10.0
    wrench[1, 5] = 1.0
    margins = tension_margin.solve(matrix, wrench, 0.0, 100.0)
    assert margins.solved.all()
    assert np.isfinite(margins.margin[0]) and margins.margin[1] == -np.inf


def test_equal_cables_are_no_trouble_and_a_batch_is_its_rows():
    rng = np.random.default_rng(5)
    half = rng.standard_normal((30, 6, 6))
    matrix = np.concatenate([half, half, half], axis=2)
    wrench = 50.0 * rng.standard_normal((30, 6))
    margins = tension_margin.solve(matrix, wrench, 1.0, 100.0)
    assert margins.solved.all()
    for k in range(30):
        alone = tension_margin.solve(matrix[k : k + 1], wrench[k : k + 1], 1.0, 100.0)
        assert alone.margin[0] == margins.margin[k]
        exact = by_highs(matrix[k], wrench[k], np.full(18, 1.0), np.full(18, 100.0))
        assert margins.margin[k] == pytest.approx(exact, abs=1e-8)


def test_bad_input_is_named():
    matrix = np.zeros((1, 6, 8))
    with pytest.raises(InvalidField, match=r"structure_matrix: got shape \(1, 5, 8\)"):
        tension_margin.solve(np.zeros((1, 5, 8)), np.zeros((1, 6)), 0.0, 1.0)
    with pytest.raises(InvalidField, match="wrench"):
        tension_margin.solve(matrix, np.zeros((2, 6)), 0.0, 1.0)
    with pytest.raises(InvalidField, match=r"tension_min\[0\]: got 2.0 N"):
        tension_margin.solve(matrix, np.zeros((1, 6)), 2.0, 1.0)
    with pytest.raises(InvalidField, match="arm"):
        tension_margin.solve(matrix, np.zeros((1, 6)), 0.0, 1.0, arm=0.0)
