from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from carosac_toolkit.trajectories.splines import cubic_from_rest_to_rest
from tests.trajectories.samples import POINTS

PASSING = np.array([0.0, 1.3, 2.0, 3.9])


def test_it_passes_the_points_with_zero_velocity_and_acceleration_at_the_ends():
    curve = cubic_from_rest_to_rest(POINTS, PASSING)
    values = curve.derivatives(PASSING)
    np.testing.assert_allclose(values[:, 0], POINTS, atol=1e-12)
    np.testing.assert_allclose(values[[0, -1], 1:3], 0.0, atol=1e-12)


def test_it_is_the_clamped_spline_through_its_own_knots():
    """Among the splines through the same knots only one has zero velocity at both ends."""
    curve = cubic_from_rest_to_rest(POINTS, PASSING)
    knots = curve.derivatives(curve.breaks)[:, 0]
    oracle = CubicSpline(curve.breaks, knots, bc_type="clamped")
    time = np.linspace(0.0, PASSING[-1], 200)
    np.testing.assert_allclose(curve.derivatives(time)[:, 0], oracle(time), atol=1e-12)


def test_it_does_not_swing_far_beyond_its_points():
    curve = cubic_from_rest_to_rest(POINTS, PASSING)
    position = curve.derivatives(np.linspace(0.0, PASSING[-1], 500))[:, 0]
    span = POINTS.max(axis=0) - POINTS.min(axis=0)
    assert (position < POINTS.max(axis=0) + 0.5 * span).all()
    assert (position > POINTS.min(axis=0) - 0.5 * span).all()
