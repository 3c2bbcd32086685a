"""Robust losses: weights are their derivatives, and limits are least squares or truncation."""

from __future__ import annotations

import numpy as np
import pytest

from calibration.robust import MAD_FACTOR, NORMAL_MEDIAN, cauchy, pseudo_huber, truncated

RESIDUAL = np.linspace(-8.0, 8.0, 33)


def test_cauchys_weight_is_the_derivative_of_its_loss_by_the_square():
    square, step = RESIDUAL**2, 1e-5
    slope = (cauchy(square + step, 9.0)[1] - cauchy(square, 9.0)[1]) / step
    assert cauchy(square, 9.0)[0] == pytest.approx(slope, rel=1e-5)
    assert cauchy(np.array([9.0]), 9.0)[0] == pytest.approx(0.5)


def test_pseudo_hubers_weight_is_the_derivative_of_its_loss():
    knee, step = 3.0, 1e-6
    slope = (pseudo_huber(RESIDUAL + step, knee)[1] - pseudo_huber(RESIDUAL - step, knee)[1]) / 2
    weight = pseudo_huber(RESIDUAL, knee)[0]
    assert knee**2 * slope / step == pytest.approx(2.0 * weight * RESIDUAL, abs=1e-8)


def test_small_residuals_count_as_in_least_squares():
    tiny = np.array([1e-4])
    assert cauchy(tiny**2, 9.0)[1] == pytest.approx(tiny**2, rel=1e-6)
    assert 9.0 * pseudo_huber(tiny, 3.0)[1] == pytest.approx(tiny**2, rel=1e-6)


def test_truncation_goes_from_equal_weights_to_in_or_out():
    sharp = truncated(RESIDUAL, 4.0, 1e9)
    assert sharp == pytest.approx((np.abs(RESIDUAL) < 4.0) + 0.5 * (np.abs(RESIDUAL) == 4.0))
    size = np.abs(RESIDUAL[RESIDUAL != 0.0])
    soft = truncated(size, 4.0, 1e-9) * size
    assert soft == pytest.approx(np.full(len(size), soft[0]), rel=1e-3)


def test_the_median_of_normal_values_gives_their_standard_deviation():
    values = np.random.default_rng(0).normal(0.0, 2.0, 200_000)
    assert MAD_FACTOR * np.median(np.abs(values)) == pytest.approx(2.0, rel=0.01)
    assert pytest.approx(1.0, abs=1e-4) == MAD_FACTOR * NORMAL_MEDIAN
