from __future__ import annotations

import numpy as np
import pytest

from calibration.linear_samples import LinearSamples
from calibration.normal_equations import solve


@pytest.fixture
def problem():
    rng = np.random.default_rng(0)
    linear = LinearSamples(
        residual=rng.normal(size=(5, 7)),
        by_shared=rng.normal(size=(5, 7, 4)),
        by_own=rng.normal(size=(5, 7, 3)),
    )
    return linear, np.diag([1.0, 2.0, 3.0, 4.0]), np.array([0.1, 0.2, 0.3, 0.4])


def dense(linear, information, pull):
    """The same problem without its structure: all unknowns at once, the shared ones first."""
    rows = []
    for k in range(5):
        own = np.zeros((7, 15))
        own[:, 3 * k : 3 * k + 3] = linear.by_own[k]
        rows.append(np.hstack([linear.by_shared[k], own]))
    jacobian = np.concatenate(rows)
    square = jacobian.T @ jacobian
    square[:4, :4] += information
    right = -jacobian.T @ linear.residual.ravel()
    right[:4] += pull
    return jacobian, square, right


def test_the_solution_is_that_of_all_unknowns_at_once(problem):
    _, square, right = dense(*problem)
    step = np.linalg.solve(square, right)
    solution = solve(*problem)
    np.testing.assert_allclose(solution.shared, step[:4], atol=1e-12)
    np.testing.assert_allclose(solution.own.ravel(), step[4:], atol=1e-12)


def test_covariances_are_blocks_of_the_whole_inverse(problem):
    jacobian, square, _ = dense(*problem)
    inverse = np.linalg.inv(square)
    solution = solve(*problem)
    np.testing.assert_allclose(solution.covariance, inverse[:4, :4], atol=1e-12)
    linear = problem[0]
    known = solution.joint_covariance(linear.by_own, linear.by_shared)
    whole = jacobian @ inverse @ jacobian.T
    for k in range(5):
        part = slice(7 * k, 7 * k + 7)
        np.testing.assert_allclose(known[k], whole[part, part], atol=1e-12)


def test_damping_shortens_the_step(problem):
    full, damped = solve(*problem), solve(*problem, damping=10.0)
    assert np.linalg.norm(damped.shared) < 0.5 * np.linalg.norm(full.shared)
