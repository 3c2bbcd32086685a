"""The least of a quadratic cost is where no direction that its bounds allow leads lower."""

from __future__ import annotations

import numpy as np
import pytest

from calibration.identification.quadratic import Quadratic


def some(seed, count=6):
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((count, count))
    return Quadratic(
        cost=3.0, gradient=rng.standard_normal(count), information=root @ root.T + np.eye(count)
    )


@pytest.mark.parametrize("seed", range(5))
def test_within_bounds_no_direction_leads_lower(seed):
    cost = some(seed)
    lower = np.array([-0.01, -0.1, -np.inf, 0.0, -0.02, -np.inf])
    change = cost.least_within(lower)
    slope = cost.gradient + cost.information @ change
    bound = change <= lower + 1e-12
    assert (change >= lower).all()
    assert slope[~bound] == pytest.approx(0.0, abs=1e-9)
    assert (slope[bound] >= -1e-9).all()


@pytest.mark.parametrize("seed", range(5))
def test_within_bounds_to_both_sides_no_direction_leads_lower(seed):
    cost, reach = some(seed), np.full(6, 0.05)
    change = cost.least_within(-reach, reach)
    slope = cost.gradient + cost.information @ change
    low, high = change <= -reach + 1e-12, change >= reach - 1e-12
    assert (np.abs(change) <= reach).all() and (low | high).any()
    assert slope[~low & ~high] == pytest.approx(0.0, abs=1e-9)
    assert (slope[low] >= -1e-9).all() and (slope[high] <= 1e-9).all()


def test_far_bounds_change_nothing():
    cost = some(0)
    change = cost.least_within(np.full(6, -np.inf))
    assert cost.gradient + cost.information @ change == pytest.approx(np.zeros(6), abs=1e-12)
    assert np.array_equal(cost.least_within(np.full(6, -1e6)), change)


def test_beside_others_the_cost_is_the_least_that_they_allow():
    cost, first = some(1), np.array([0.3, -0.2])
    loose = Quadratic(
        cost=cost.at(np.concatenate([first, np.zeros(4)])),
        gradient=cost.gradient[2:] + cost.information[2:, :2] @ first,
        information=cost.information[2:, 2:],
    )
    least = loose.at(loose.least_within(np.full(4, -np.inf)))
    assert cost.least_beside(2).at(first) == pytest.approx(least)
    assert cost.least_beside(6).at(np.zeros(6)) == cost.cost


def test_a_bound_everywhere_is_found_too():
    """As many steps as coordinates would not do."""
    cost = some(3, 40)
    change = cost.least_within(np.full(40, -1e-3))
    slope = cost.gradient + cost.information @ change
    assert (slope[change <= -1e-3] >= -1e-9).all()
    assert slope[change > -1e-3 + 1e-12] == pytest.approx(0.0, abs=1e-9)
