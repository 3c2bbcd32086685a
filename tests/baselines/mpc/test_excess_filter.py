"""Sag and stretch of a plan reach the command without a jump of speed."""

from __future__ import annotations

import numpy as np
import pytest

from baselines.mpc.excess_filter import EXCESS_TIME, ExcessFilter
from carosac_toolkit import load_robot
from carosac_toolkit.robot.similar import similar_robot

PERIOD = 0.002  # short, so that steps are the differential equation
DURATION = float(EXCESS_TIME)  # on carosac


def followed(robot, excess, *, period=PERIOD, steps=2000):
    """Values after each period."""
    one = ExcessFilter(robot, period)
    values = []
    for _ in range(steps):
        one.approach(excess)
        values.append(one.value)
    return np.array(values)


def test_a_step_is_followed_as_by_two_equal_poles():
    robot = load_robot("carosac")
    step = np.array([0.01, -0.02, 0.03, 0.0])
    values = followed(robot, step)
    t = PERIOD * np.arange(1, len(values) + 1)[:, None] / DURATION
    assert values == pytest.approx(step * (1.0 - (1.0 + t) * np.exp(-t)), abs=3e-4)
    assert values[-1] == pytest.approx(step, abs=1e-6)


def test_no_step_asks_for_more_acceleration_than_by_its_size():
    robot = load_robot("carosac")
    step = np.full(4, 0.02)
    values = np.vstack([np.zeros((2, 4)), followed(robot, step)])
    acceleration = np.diff(values, n=2, axis=0) / PERIOD**2
    assert np.abs(acceleration).max() <= 0.02 / DURATION**2


def test_a_longer_period_than_the_filter_stays_stable():
    values = followed(load_robot("carosac"), np.full(4, 0.02), period=2.0, steps=20)
    assert (np.diff(values, axis=0) >= 0.0).all()
    assert values[-1] == pytest.approx(0.02, rel=1e-6)


def test_a_cable_that_cannot_hang_comes_to_rest():
    one = ExcessFilter(load_robot("carosac"), PERIOD)
    one.reset(np.array([0.01, np.nan, 0.0, 0.0]))
    for _ in range(3000):
        one.approach(np.array([np.nan, np.nan, 0.02, 0.0]))
    assert one.value == pytest.approx([0.01, 0.0, 0.02, 0.0], abs=1e-6)


def test_a_similar_robot_has_a_similar_filter():
    robot = load_robot("carosac")
    small = followed(robot, np.full(4, 0.02), steps=200)
    large = followed(similar_robot(robot, 4.0), np.full(4, 0.08), period=2.0 * PERIOD, steps=200)
    assert large == pytest.approx(4.0 * small, rel=1e-9)
