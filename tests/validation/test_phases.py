import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from carosac_toolkit.validation.phases import (
    REST_DURATION_MIN_S,
    anchor_speed,
    find_phases,
    slope,
)
from tests.robots import simple_robot


def test_the_slope_of_a_line_is_exact_at_uneven_times():
    time = np.cumsum(np.random.default_rng(0).uniform(0.001, 0.4, 200)) + 1e3
    rate = np.array([0.3, -2.0])
    assert slope(time, 5.0 + time[:, None] * rate) == pytest.approx(np.tile(rate, (200, 1)))


def test_noise_of_an_encoder_does_not_look_like_motion():
    time = np.arange(0.0, 20.0, 0.01)
    noise = np.random.default_rng(0).normal(scale=2e-4, size=(len(time), 8))
    assert find_phases(time, 8.0 + noise).resting.all()


def test_slow_and_short_pauses_are_told_apart():
    time = np.arange(0.0, 10.0, 0.02)
    speed = np.where((time > 2.0) & (time < 4.0), 0.5, 0.0)
    speed = np.where((time > 4.3) & (time < 6.0), -0.5, speed)
    length = 8.0 + np.cumsum(speed)[:, None] * 0.02 * np.array([1.0, 0.0])
    phases = find_phases(time, length)
    assert len(phases.rests) == 2  # the pause of 0.3 s is none
    (first, end), (again, last) = phases.rests
    assert (first, last) == (0, len(time))
    assert time[end - 1] == pytest.approx(2.0, abs=0.2)
    assert time[again] == pytest.approx(6.0, abs=0.2)
    assert phases.resting.sum() == end - first + last - again
    assert time[end - 1] - time[first] >= REST_DURATION_MIN_S


def test_one_sample_rests_nowhere():
    assert slope(np.zeros(1), np.ones((1, 4))).tolist() == [[0.0] * 4]
    assert find_phases(np.zeros(1), np.ones((1, 4))).rests == ()


def test_a_platform_that_turns_about_its_origin_moves():
    robot = simple_robot()
    time = np.arange(0.0, 2.0, 0.02)
    turn = Rotation.from_rotvec(np.outer(0.5 * time, [0.0, 0.0, 1.0])).as_matrix()
    arm = np.linalg.norm(robot.anchor_points[:, :2], axis=1).max()
    speed = anchor_speed(robot, time, np.zeros((len(time), 3)), turn)
    assert speed == pytest.approx(0.5 * arm, rel=0.01)
