"""Bounded least-squares tensions against osqp, linear programming and their own conditions."""

import numpy as np
import pytest
from scipy.optimize import linprog

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.rest import tension_distribution
from carosac_toolkit.physics.rest.structure import structure_matrix
from tests import reference
from tests.robots import eight_cable_robot

LOWER, UPPER = 10.0, 1000.0


def problems(count, seed, spread):
    """Structure matrices of one robot and wrenches that need tensions around the limits."""
    robot = eight_cable_robot()
    rng = np.random.default_rng(seed)
    where = rng.uniform(robot.workspace_min, robot.workspace_max, (count, 3))
    matrix = structure_matrix(robot, where)
    tension = rng.uniform(LOWER - spread, UPPER + spread, (count, 8))
    return matrix, -np.einsum("bij,bj->bi", matrix, tension)


def test_agrees_with_osqp_to_1e_6_newton():
    matrix, wrench = problems(60, 0, 100.0)
    distribution = tension_distribution.solve(matrix, wrench, LOWER, UPPER)
    assert distribution.feasible.any()
    lower, upper = np.full(8, LOWER), np.full(8, UPPER)
    for k in np.flatnonzero(distribution.feasible):
        exact = reference.tension_distribution_nnls(matrix[k], wrench[k], lower, upper)
        assert distribution.tension[k] == pytest.approx(exact, abs=1e-6)
        best = reference.tension_distribution_osqp(matrix[k], wrench[k], lower, upper)
        if best is not None:
            assert distribution.tension[k] == pytest.approx(best, abs=1e-6)


def test_feasible_exactly_where_a_linear_program_is():
    rng = np.random.default_rng(1)
    matrix = np.concatenate([problems(150, 2, 200.0)[0], rng.standard_normal((150, 6, 8))])
    tension = rng.uniform(LOWER - 200.0, UPPER + 200.0, (300, 8))
    wrench = -np.einsum("bij,bj->bi", matrix, tension)
    distribution = tension_distribution.solve(matrix, wrench, LOWER, UPPER)
    assert 0.2 < distribution.feasible.mean() < 0.8
    for k in range(300):
        program = linprog(np.zeros(8), A_eq=matrix[k], b_eq=-wrench[k], bounds=[(LOWER, UPPER)] * 8)
        assert (program.status == 0) == distribution.feasible[k]


def test_conditions_of_optimality_hold():
    """Inside the limits t = A^T y; at a limit the multiplier pushes outwards."""
    matrix, wrench = problems(200, 3, 50.0)
    distribution = tension_distribution.solve(matrix, wrench, LOWER, UPPER)
    assert (distribution.residual[distribution.feasible] < 1e-7).all()
    for k in np.flatnonzero(distribution.feasible)[:50]:
        t = distribution.tension[k]
        inside = (t > LOWER + 1e-6) & (t < UPPER - 1e-6)
        if inside.sum() < 6:
            continue
        y = np.linalg.lstsq(matrix[k][:, inside].T, t[inside], rcond=None)[0]
        wish = matrix[k].T @ y
        assert wish[inside] == pytest.approx(t[inside], abs=1e-5)
        assert (wish[t <= LOWER + 1e-6] <= LOWER + 1e-5).all()
        assert (wish[t >= UPPER - 1e-6] >= UPPER - 1e-5).all()


def test_no_load_and_a_mean_reference_give_the_mean():
    """The published check of the reference algorithms: zero wrench, limits 1 to 10: all 5.5 N."""
    robot = eight_cable_robot()
    symmetric = structure_matrix(robot, np.array([[0.0, 0.0, 1.0]]))
    balanced = np.einsum("bij,j->bi", symmetric, np.full(8, 5.5))
    distribution = tension_distribution.solve(symmetric, -balanced, 1.0, 10.0, reference=5.5)
    assert distribution.tension[0] == pytest.approx(np.full(8, 5.5), abs=1e-9)


def test_single_robot_agrees_with_the_batch():
    matrix, wrench = problems(40, 4, 20.0)
    together = tension_distribution.solve(matrix, wrench, LOWER, UPPER, reference=200.0)
    solver = tension_distribution.TensionDistributor(8, LOWER, UPPER)
    agreed = 0
    for k in range(40):
        alone = solver.solve(matrix[k : k + 1], wrench[k : k + 1], reference=200.0)
        if alone.feasible[0] and together.feasible[k]:
            assert alone.tension[0] == pytest.approx(together.tension[k], abs=1e-4)
            agreed += 1
        assert not alone.feasible[0] or together.feasible[k]
    assert agreed > 20


def test_bad_arguments_are_named():
    matrix, wrench = problems(2, 5, 0.0)
    with pytest.raises(InvalidField, match=r"structure_matrix: got shape \(6, 8\)"):
        tension_distribution.solve(matrix[0], wrench, LOWER, UPPER)
    with pytest.raises(InvalidField, match=r"wrench: got shape \(1, 6\); allowed: shape \(2, 6\)"):
        tension_distribution.solve(matrix, wrench[:1], LOWER, UPPER)
    with pytest.raises(InvalidField, match=r"tension_min\[0\]: got 5.0 N; allowed: <= 4.0 N"):
        tension_distribution.solve(matrix, wrench, 5.0, 4.0)
    with pytest.raises(InvalidField, match=r"tension_max: got shape \(3,\)"):
        tension_distribution.solve(matrix, wrench, 5.0, [10.0, 10.0, 10.0])
    with pytest.raises(InvalidField, match=r"arm: got 0.0 m; allowed: arm > 0"):
        tension_distribution.solve(matrix, wrench, LOWER, UPPER, arm=0.0)
    with pytest.raises(InvalidField, match=r"got several problems; allowed: a batch of one"):
        tension_distribution.TensionDistributor(8, LOWER, UPPER).solve(matrix, wrench)
