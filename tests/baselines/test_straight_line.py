from __future__ import annotations

import numpy as np
import pytest

from baselines.straight_line import StraightLine, StraightLineSettings
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.values import Command, Measurement
from carosac_toolkit.physics.cable.straight_line import inverse_kinematics
from tests.robots import simple_robot


def measured(lengths, time=0.0):
    lengths = np.atleast_2d(lengths)
    return Measurement(time=np.full(len(lengths), time), unstrained_length=lengths)


def held(measurement):
    return Command(time=measurement.time, unstrained_length=measurement.unstrained_length)


def test_straight_cables_are_followed_exactly_from_a_cold_start():
    robot = simple_robot()
    path = np.linspace([-1.0, -3.0, 1.5], [2.0, 0.0, 4.5], 20)
    lengths = inverse_kinematics(robot, path)
    estimator = StraightLine.build(robot, None, seed=0)
    belief = estimator.reset(measured(lengths[0]))
    for k in range(1, 20):
        m = measured(lengths[k], 0.1 * k)
        belief = estimator.update(belief, held(m), m)
        assert belief.position[0] == pytest.approx(path[k], abs=1e-9)
    assert belief.time[0] == pytest.approx(1.9)
    assert (belief.rotation[0] == robot.home_rotation).all()
    assert belief.twist is None
    assert belief.tension is None
    assert belief.memory.updates == 20
    assert belief.memory.failures.tolist() == [0]


def test_a_warm_start_stays_on_its_side_of_the_exit_points():
    robot = simple_robot()
    lengths = inverse_kinematics(robot, [[0.4, -1.8, 14.0]])  # where no suspended robot can be
    estimator = StraightLine.build(robot)
    belief = estimator.reset(measured(lengths))
    assert belief.converged.all()
    assert belief.position[0, 2] < 8.0
    assert belief.memory.residual[0] > 1e-3


def test_a_failed_fit_keeps_the_last_good_position_and_says_so():
    robot = simple_robot()
    good = inverse_kinematics(robot, [[0.4, -1.8, 2.2], [0.1, -1.0, 3.0]])
    bad = good + np.array([[0.5, -0.5, 0.5, -0.5], [0.0, 0.0, 0.0, 0.0]])
    estimator = StraightLine.build(robot, StraightLineSettings(residual_max=0.01))
    start = estimator.reset(measured(good))
    m = measured(bad, 0.1)
    belief = estimator.update(start, held(m), m)
    assert belief.converged.tolist() == [False, True]
    assert belief.memory.failures.tolist() == [1, 0]
    assert belief.memory.residual[0] > 0.01
    assert belief.position == pytest.approx(start.position, abs=1e-12)
    belief = estimator.update(belief, held(m), measured(good, 0.2))
    assert belief.converged.all()
    assert belief.memory.failures.tolist() == [1, 0]
    assert start.memory.failures.tolist() == [0, 0]  # beliefs are values: the old one is untouched


def test_a_first_failure_leaves_home_and_says_so():
    robot = simple_robot()
    estimator = StraightLine.build(robot, StraightLineSettings(residual_max=0.01))
    belief = estimator.reset(measured([9.0, 6.0, 9.0, 6.0]))
    assert not belief.converged.any()
    assert (belief.position[0] == robot.home_position).all()


def test_batch_equals_loop():
    robot = simple_robot()
    lengths = np.random.default_rng(0).uniform(8.0, 10.0, (5, 4))
    estimator = StraightLine.build(robot)
    together = estimator.reset(measured(lengths)).position
    alone = [estimator.reset(measured(row)).position[0] for row in lengths]
    assert (together == np.array(alone)).all()


def test_it_is_found_by_name():
    assert plugins.load("estimators", "straight_line") is StraightLine


def test_settings_refuse_a_bound_that_nothing_meets():
    with pytest.raises(InvalidField, match=r"residual_max: got -1\.0 m"):
        StraightLineSettings(residual_max=-1.0)
