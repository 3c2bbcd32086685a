from __future__ import annotations

import numpy as np
import pytest

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.trajectories import cubic_spline, minimum_snap
from carosac_toolkit.trajectories.curves import PiecewisePolynomial
from carosac_toolkit.trajectories.snap import hermite_map, septic_of_least_snap
from tests.trajectories.samples import POINTS

BREAKS = np.array([0.0, 1.3, 2.0, 3.9])
LIMITS = {"speed_max": 1.0, "acceleration_max": 1.0}


def snap(curve: PiecewisePolynomial) -> float:
    """Integrate the squared fourth derivative by Gauss quadrature, exact for degree 15."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    total = 0.0
    for start, end in zip(curve.breaks[:-1], curve.breaks[1:], strict=True):
        time = (start + end) / 2 + nodes * (end - start) / 2
        values = curve.evaluate(time, orders=5)[:, 4]
        total += float((values**2).sum(axis=1) @ weights) * (end - start) / 2
    return total


def pinned_values(curve: PiecewisePolynomial) -> Array:
    """Position, velocity, acceleration and jerk at both ends of each piece, (S, 8, 3)."""
    maps = [np.linalg.inv(hermite_map(h)) for h in np.diff(curve.breaks)]
    return np.array([m @ c for m, c in zip(maps, curve.coefficients, strict=True)])


def test_it_passes_the_points_at_rest_at_both_ends():
    curve = septic_of_least_snap(POINTS, BREAKS)
    values = curve.evaluate(BREAKS, orders=4)
    np.testing.assert_allclose(values[:, 0], POINTS, atol=1e-12)
    np.testing.assert_allclose(values[[0, -1], 1:], 0.0, atol=1e-10)


def test_the_minimiser_is_continuous_up_to_the_sixth_derivative():
    curve = septic_of_least_snap(POINTS, BREAKS)
    at = curve.evaluate(BREAKS[1:-1], orders=8)
    before = curve.evaluate(np.nextafter(BREAKS[1:-1], 0.0), orders=8)
    scale = np.abs(at).max(axis=(0, 2))
    assert (np.abs(at - before).max(axis=(0, 2)) / scale)[:7].max() < 1e-9
    assert np.abs(at - before)[:, 7].max() / scale[7] > 0.1  # but no further


def test_every_feasible_perturbation_costs_more():
    best = septic_of_least_snap(POINTS, BREAKS)
    rng = np.random.default_rng(0)
    maps = [hermite_map(h) for h in np.diff(BREAKS)]
    for size in (1e-3, 1e-1, 10.0):
        for _ in range(20):
            values = pinned_values(best)
            change = size * rng.normal(size=(len(POINTS), 3, 3))
            change[[0, -1]] = 0.0  # the rests at the ends stay; so do all positions
            values[:, 1:4] += change[:-1]
            values[:, 5:8] += change[1:]
            coefficients = np.array([m @ v for m, v in zip(maps, values, strict=True)])
            other = PiecewisePolynomial(breaks=BREAKS, coefficients=coefficients)
            assert snap(other) > snap(best)


def test_the_cost_grows_with_the_square_of_a_perturbation():
    best = septic_of_least_snap(POINTS, BREAKS)
    maps = [hermite_map(h) for h in np.diff(BREAKS)]

    def cost(size: float) -> float:
        values = pinned_values(best)
        values[0, 5] += size
        values[1, 1] += size
        coefficients = np.array([m @ v for m, v in zip(maps, values, strict=True)])
        return snap(PiecewisePolynomial(breaks=BREAKS, coefficients=coefficients)) - snap(best)

    assert cost(0.1) == pytest.approx(cost(-0.1), rel=1e-6)  # no first-order term: stationary
    assert cost(0.2) == pytest.approx(4 * cost(0.1), rel=1e-6)


def test_a_septic_spline_with_zero_inner_velocities_costs_more():
    best = septic_of_least_snap(POINTS, BREAKS)
    stop = np.zeros((3, 8, 3))
    stop[:, 0], stop[:, 4] = POINTS[:-1], POINTS[1:]
    maps = [hermite_map(h) for h in np.diff(BREAKS)]
    coefficients = np.array([m @ v for m, v in zip(maps, stop, strict=True)])
    assert snap(PiecewisePolynomial(breaks=BREAKS, coefficients=coefficients)) > 2 * snap(best)


def test_two_points_give_the_septic_rest_to_rest_polynomial():
    trajectory = minimum_snap([[0, 0, 0], [1, 2, 3]], **LIMITS)
    x = np.linspace(0.0, 1.0, 11)
    shape = 35 * x**4 - 84 * x**5 + 70 * x**6 - 20 * x**7
    position = trajectory.sample(x * trajectory.duration).position
    np.testing.assert_allclose(position, shape[:, None] * [1, 2, 3], atol=1e-12)


@pytest.mark.parametrize("factory", [minimum_snap, cubic_spline])
def test_ratios_say_when_the_points_are_passed(factory):
    trajectory = factory(POINTS, segment_ratios=[1.0, 2.0, 1.0], **LIMITS)
    time = trajectory.duration * np.array([0.0, 0.25, 0.75, 1.0])
    np.testing.assert_allclose(trajectory.sample(time).position, POINTS, atol=1e-9)
    with pytest.raises(InvalidField, match=r"segment_ratios\[1\]: got 0.0; allowed: > 0"):
        factory(POINTS, segment_ratios=[1.0, 0.0, 1.0], **LIMITS)
    with pytest.raises(InvalidField, match=r"segment_ratios: got shape \(2,\)"):
        factory(POINTS, segment_ratios=[1.0, 1.0], **LIMITS)


@pytest.mark.parametrize("factory", [minimum_snap, cubic_spline])
def test_turned_and_scaled_points_give_the_turned_and_scaled_trajectory(factory):
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    one = factory(POINTS, segment_ratios=[1, 1, 2], **LIMITS)
    other = factory(3.0 * POINTS @ turn.T + 1.0, segment_ratios=[1, 1, 2], **LIMITS)
    share = np.linspace(0.0, 1.0, 50)
    expected = 3.0 * one.sample(share * one.duration).position @ turn.T + 1.0
    result = other.sample(share * other.duration).position
    np.testing.assert_allclose(result, expected, atol=1e-9)


@pytest.mark.parametrize("factory", [minimum_snap, cubic_spline])
@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([[0, 0, 0]], r"points: got 1 point; allowed: at least 2 points"),
        ([[0, 0], [1, 1]], r"points: got shape \(2, 2\); allowed: shape \(B, 3\)"),
        ([[0, 0, 0], [0, 0, 0]], r"points\[1\]: got the same point as before"),
        ([[0, 0, 0], [0, np.nan, 0]], r"points\[1, 1\]: got nan; allowed: a finite number"),
    ],
)
def test_bad_points_are_refused(factory, points, message):
    with pytest.raises(InvalidField, match=message):
        factory(points, **LIMITS)


@pytest.mark.parametrize("factory", [minimum_snap, cubic_spline])
def test_many_points_are_passed_exactly(factory):
    points = np.random.default_rng(1).normal(size=(150, 3))
    trajectory = factory(points, segment_ratios=np.ones(149), **LIMITS)
    time = np.linspace(0.0, trajectory.duration, 150)
    np.testing.assert_allclose(trajectory.sample(time).position, points, atol=1e-8)
