"""Curves through rows: every row is passed, no coordinate swings beyond sparse rows."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from carosac_toolkit.trajectories.row_curve import (
    OVERSHOOT_RATIO,
    SPLINE_DEGREE,
    farthest_from_chords,
    path_size,
    through_rows,
)

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 0]], dtype=float)


def random_rows(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(3, 25))
    time = np.concatenate([[0.0], np.cumsum(rng.uniform(0.2, 4.0, count - 1))])
    return time, rng.uniform(-0.8, 0.8, (count, 3))


def overshoot(curve, position):
    """Return how far any coordinate leaves the range of the two rows it is between [m]."""
    most = 0.0
    for k, (start, end) in enumerate(pairwise(position)):
        times = np.linspace(curve.breaks[k], curve.breaks[k + 1], 400)
        values = curve.derivatives(times)[:, 0]
        high, low = np.maximum(start, end), np.minimum(start, end)
        most = max(most, (values - high).max(), (low - values).max())
    return most


@pytest.mark.parametrize("seed", range(12))
def test_random_rows_are_passed_at_rest_at_the_ends_without_overshoot(seed):
    time, position = random_rows(seed)
    curve = through_rows(time, position)
    passed = curve.derivatives(time)
    np.testing.assert_allclose(passed[:, 0], position, atol=1e-12)
    assert np.abs(passed[[0, -1], 1:3]).max() < 1e-9
    assert overshoot(curve, position) <= OVERSHOOT_RATIO * path_size(position)


@pytest.mark.parametrize("seed", range(12))
def test_velocity_and_acceleration_are_continuous_and_finite(seed):
    time, position = random_rows(seed)
    curve = through_rows(time, position)
    step = np.diff(time)[:, None]
    powers = np.arange(SPLINE_DEGREE + 1)
    for order in (1, 2):
        factor = np.prod([powers - k for k in range(order)], axis=0)
        at_end = np.sum(
            (curve.coefficients * (factor * step ** np.maximum(powers - order, 0))[..., None]),
            axis=1,
        )
        at_start = curve.derivatives(time)[1:-1, order]
        assert np.isfinite(at_end).all()
        np.testing.assert_allclose(at_end[:-1], at_start, atol=1e-9)


def test_a_square_of_its_corners_stays_straight():
    curve = through_rows(2.0 * np.arange(5), SQUARE)
    assert farthest_from_chords(curve)[0] < 1e-12
    assert curve.derivatives(np.linspace(0.0, 8.0, 999))[:, 0].max() < 1.0 + 1e-12


def test_a_dense_sine_keeps_its_velocity_and_acceleration():
    time = np.linspace(0.0, 10.0, 501)
    share = time / 10.0
    # three periods that begin and end at rest, by a window with two zero derivatives at its ends
    window = (share * (1.0 - share)) ** 3 * 64.0
    phase = 6.0 * np.pi * share

    def truth(t):
        s = t / 10.0
        return ((s * (1.0 - s)) ** 3 * 64.0) * np.sin(6.0 * np.pi * s)

    position = np.column_stack([window * np.sin(phase), window * np.cos(phase), 0.0 * time])
    values = through_rows(time, position).derivatives(between := time[5:-5] + 0.007)
    h = 1e-4
    speed = (truth(between + h) - truth(between - h)) / (2.0 * h)
    acceleration = (truth(between + h) - 2.0 * truth(between) + truth(between - h)) / h**2
    assert np.abs(values[:, 0, 0] - truth(between)).max() < 1e-9
    assert np.abs(values[:, 1, 0] - speed).max() < 1e-6
    assert np.abs(values[:, 2, 0] - acceleration).max() < 1e-4


def test_a_bulge_between_rows_is_measured_from_their_chord():
    angle = np.linspace(0.0, np.pi / 2, 5)
    rows = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(5)])
    distance, piece = farthest_from_chords(through_rows(np.arange(5.0), rows))
    assert 0.01 < distance < 0.1 and 0 <= piece < 4


def test_rows_that_stay_in_place_stay_there():
    curve = through_rows(np.array([0.0, 1.0, 3.0]), np.ones((3, 3)))
    assert np.abs(curve.derivatives(np.linspace(0.0, 3.0, 50))[:, 0] - 1.0).max() < 1e-12
