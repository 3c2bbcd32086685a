"""Errors that last count for fewer samples than there are."""

from __future__ import annotations

import numpy as np
import pytest

from calibration.identification.error_noise import RUNS_APART_MIN, SIGMA_MIN, estimate_noise


def autoregressive(rho: float, count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    new = rng.standard_normal((count, 6)) * np.sqrt(1.0 - rho**2)
    errors = np.zeros((count, 6))
    for k in range(1, count):
        errors[k] = rho * errors[k - 1] + new[k]
    return errors


def test_white_errors_all_count():
    noise = estimate_noise([0.01 * autoregressive(0.0, 4000, 0)])
    assert noise.repeats == pytest.approx(np.ones(6), abs=0.6)
    assert noise.sigma == pytest.approx(np.full(6, 0.01), rel=0.05)


def test_errors_that_last_count_no_more_often_than_bartlett_says():
    rho = 0.9
    noise = estimate_noise([0.01 * autoregressive(rho, 20000, 1)])
    expected = (1.0 + rho**2) / (1.0 - rho**2)  # 1 + 2 (rho^2 + rho^4 + ...)
    assert (noise.repeats > 0.9 * expected).all()
    assert (noise.repeats < 2.5 * expected).all()  # chance correlations count as well


def test_errors_of_many_recordings_all_count_and_alike_on_all_axes():
    """An axis that is off all the time is what a search has yet to explain, not noise."""
    rng = np.random.default_rng(5)
    runs = [0.01 * rng.standard_normal((100, 6)) for _ in range(RUNS_APART_MIN)]
    for run in runs:
        run[:, 0] += 0.1
    noise = estimate_noise(runs)
    assert noise.repeats == pytest.approx(np.ones(6))
    assert np.ptp(noise.sigma[:3]) == 0.0 and np.ptp(noise.sigma[3:]) == 0.0
    assert noise.sigma[3] == pytest.approx(0.01, rel=0.1)
    few = estimate_noise(runs[:2])
    assert estimate_noise(runs[:2], apart=True).apart and not few.apart  # others were left out
    assert few.repeats[0] > 10.0 and few.sigma[0] > 5.0 * few.sigma[1]


def test_no_simulation_is_better_than_its_floor():
    assert estimate_noise([1e-6 * autoregressive(0.0, 500, 2)]).sigma == pytest.approx(SIGMA_MIN)


def test_weighted_errors_are_half_the_derivative_of_the_cost():
    errors = 0.01 * autoregressive(0.5, 50, 3)
    errors[7, 2] = 0.3  # far out: counts for less
    noise = estimate_noise([errors])
    step = 1e-7
    for row, axis in ((3, 0), (7, 2), (20, 5)):
        moved = errors.copy()
        moved[row, axis] += step
        slope = (noise.cost(moved) - noise.cost(errors)) / step
        assert slope == pytest.approx(2.0 * (noise.weights(errors) * errors)[row, axis], rel=1e-4)


def test_a_gross_error_hardly_pulls():
    errors = 0.01 * autoregressive(0.0, 200, 4)
    noise = estimate_noise([errors])
    errors[5, 0] = 1.0
    assert (noise.weights(errors) * errors)[5, 0] < 4.0 / (noise.sigma[0] * noise.repeats[0])
