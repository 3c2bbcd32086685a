"""Soft start: targets begin where the platform is, and end at the reference."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from baselines.dynamic_estimator import DynamicEstimator
from baselines.mpc import Mpc, MpcSettings
from baselines.mpc.planner import PlanTarget
from baselines.mpc.soft_start import FADE_TIME, SoftStart
from baselines.mpc.target_reader import CHASE_DISTANCE_MAX
from carosac_toolkit import load_robot, trajectories
from carosac_toolkit.base.scaled import Ratios
from carosac_toolkit.loop.loop import run
from sim_warp.driver import SimDriver, SimDriverSettings

CAROSAC = Ratios(1.0, 1.0, 1.0)
GRID = np.linspace(0.0, 2.0, 201)
APART = np.array([0.004, -0.003, 0.002])
TURN = Rotation.from_rotvec([0.01, 0.02, -0.03]).as_matrix()


def target():
    """On a straight line at 1 m/s."""
    speed = np.tile([1.0, 0.0, 0.0], (len(GRID), 1))
    upright = np.tile(np.eye(3), (len(GRID), 1, 1))
    tension = np.ones((len(GRID) - 1, 4))
    return PlanTarget(
        position=GRID[:, None] * speed, velocity=speed, rotation=upright, tension=tension
    )


def test_a_target_begins_where_the_platform_is_and_ends_at_the_reference():
    start = SoftStart(GRID, CAROSAC)
    faded = start.faded(target(), APART, TURN, time=5.0)
    assert faded.position[0] == pytest.approx(APART, abs=1e-15)
    assert faded.rotation[0] == pytest.approx(TURN, abs=1e-12)
    late = GRID >= FADE_TIME.of(CAROSAC)
    assert (faded.position[late] == target().position[late]).all()
    assert faded.rotation[-1] == pytest.approx(np.eye(3), abs=1e-15)
    slope = np.gradient(faded.position, GRID, axis=0)
    assert faded.velocity[1:-1] == pytest.approx(slope[1:-1], abs=1e-5)


def test_the_distance_is_that_of_the_start_whatever_comes_later():
    start = SoftStart(GRID, CAROSAC)
    first = start.faded(target(), APART, TURN, time=5.0)
    later = start.faded(target(), np.full(3, 7.0), np.eye(3), time=5.4)
    apart = later.position[0] - target().position[0]
    assert apart == pytest.approx(first.position[40] - target().position[40], abs=1e-12)
    after = start.faded(target(), np.full(3, 7.0), np.eye(3), time=5.0 + FADE_TIME.of(CAROSAC))
    assert (after.position == target().position).all()


def test_a_reference_far_away_is_approached_and_not_faded_in():
    far = np.array([1.01 * CHASE_DISTANCE_MAX.of(CAROSAC), 0.0, 0.0])
    start = SoftStart(GRID, CAROSAC)
    assert (start.faded(target(), far, TURN, time=0.0).position == target().position).all()


def test_biased_encoders_do_not_slacken_cables_at_the_start():
    robot = load_robot("warehouse")
    start = robot.home_position
    end = start + np.array([1.0, 0.5, 0.2])
    path = trajectories.line(start, end, speed_max=0.9, acceleration_max=1.0)
    controller = Mpc.build(robot, MpcSettings(compiled="never"))
    driver = SimDriver.build(robot, SimDriverSettings(period=controller.period), seed=0)
    log = run(driver, DynamicEstimator.build(robot), controller, path, duration=0.7)
    assert not log.limited  # the bias, taken up in the first period, exceeded three limits
    assert log.tension.min() > 50.0  # 143 N at rest, and 35 N then
