"""The vertical by measured tensions."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from calibration.self_calibration.calibrate import calibrate_motor_angles
from calibration.self_calibration.frame import TILTED_BY
from calibration.self_calibration.problem import MotorAngleProblem
from calibration.self_calibration.rigid_motions import moves
from calibration.self_calibration.settings import SelfCalibrationSettings
from calibration.self_calibration.synthetic import MeasurementNoise, measure_motor_angles
from calibration.self_calibration.vertical import find_vertical
from tests.calibration.self_calibration.scenes import scene
from tests.calibration.self_calibration.test_calibrate import exits

SHARE = 0.05  # by which tensions are wrong at most, always and from sample to sample


def balanced(truth, place, rng):
    """Positions at which cables can carry a point, and tensions that do, with some pretension."""
    where, found = [], []
    weight = np.array([0.0, 0.0, truth.weight])
    for position in place:
        ray = truth.exit_points - truth.anchor_points - position
        direction = (ray / np.linalg.norm(ray, axis=1)[:, None]).T
        low = rng.uniform(0.2, 1.0, truth.n) * truth.weight
        tension = lsq_linear(direction, weight, (low, 50.0 * truth.weight)).x
        if np.abs(direction @ tension - weight).max() < 1e-3 * truth.weight:
            where.append(position)
            found.append(tension)
    return np.array(where), np.array(found)


def tilted(seed, *, lean=0.08, share=SHARE, **settings):
    """A calibration of a robot whose file leans, and the truth."""
    before, truth, place, _ = scene(seed, 60, known=())
    rng = np.random.default_rng([seed, 5])
    place, true = balanced(truth, place, rng)
    gain = 1.0 + rng.uniform(-share, share, truth.n)
    measured = true / (gain * (1.0 + rng.uniform(-share, share, true.shape)))
    noise = MeasurementNoise(friction=share)
    angles = measure_motor_angles(truth, place, np.array([], int), noise, rng, tension=measured)
    lean = Rotation.from_rotvec([*rng.normal(0.0, lean, 2), 0.0]).as_matrix()
    points = (before.exit_points - before.anchor_points) @ lean.T
    robot = replace(before, exit_points=points + before.anchor_points)
    chosen = SelfCalibrationSettings(friction_share=share, **settings)
    return calibrate_motor_angles(angles, robot, chosen), truth, angles, robot


def weight_error(result, truth):
    """Squared error of the exit points in the true W but for the heading, and its freedoms."""
    frame, arms = result.frame, truth.anchor_points
    found, real = exits(result) - arms, truth.exit_points - arms
    sine = (real[:, 0] * found[:, 1] - real[:, 1] * found[:, 0]).sum()
    turn = Rotation.from_rotvec([0.0, 0.0, np.arctan2(sine, (real * found)[:, :2].sum())])
    away = (found - turn.apply(real)).ravel()
    motion = moves(found - frame.home, 1.0).reshape(-1, 6)
    lean = motion[:, 3:5] @ np.linalg.inv(TILTED_BY)
    size = len(away)
    covariance = result.estimate.covariance[:size, :size]
    covariance = covariance + lean @ frame.vertical.covariance @ lean.T
    covariance += 1e2 * np.outer(motion[:, 5], motion[:, 5]) + 1e-9 * np.eye(size)
    return float(away @ np.linalg.solve(covariance, away)), size - 1


@pytest.mark.slow
def test_exit_points_are_as_wrong_in_the_true_vertical_as_they_claim():
    squares = []
    for seed in (0, 1, 2, 3, 8, 9, 13, 15):
        result, truth, _, _ = tilted(seed)
        assert result.frame.level and result.frame.free.shape[1] == 3
        squares.append(weight_error(result, truth))
    square, free = np.sum(squares, axis=0)
    low, high = chi2.ppf([0.025, 0.975], free)
    assert low < square < high


def test_sharp_tensions_make_a_leaning_robot_file_upright():
    result, truth, angles, robot = tilted(2, lean=0.2, share=1e-3)
    blind = calibrate_motor_angles(replace(angles, tension=None), robot)
    assert 0.05 < lean(blind, truth) and lean(result, truth) < 0.01
    assert "z is upright by the measured tensions" in " ".join(result.sentences())
    assert result.data()["frame"]["upright_by_tensions"]


def lean(result, truth):
    """Angle between z and the true vertical, by the best fit of the exit points."""
    arms = truth.anchor_points
    found, real = exits(result) - arms, truth.exit_points - arms
    turn, _ = Rotation.align_vectors(found - found.mean(axis=0), real - real.mean(axis=0))
    return float(np.arccos(turn.as_matrix()[2, 2]))


def test_a_platform_that_is_held_tells_no_vertical():
    _, _, angles, robot = tilted(0)
    held = replace(angles, tension=np.full_like(angles.tension, 20.0))
    result = calibrate_motor_angles(held, robot)
    assert not result.frame.level
    said = " ".join(result.sentences())
    assert "do not tell the vertical: they do not balance one weight" in said


def test_another_weight_than_that_of_the_robot_file_tells_no_vertical():
    _, _, angles, robot = tilted(0)
    result = calibrate_motor_angles(angles, replace(robot, mass=3.0 * robot.mass))
    assert not result.frame.level and "weigh" in result.frame.vertical.reason


def test_known_heights_tell_the_vertical_themselves():
    before, truth, place, _ = scene(0, 40)
    rng = np.random.default_rng(3)
    place, tension = balanced(truth, place, rng)
    angles = measure_motor_angles(
        truth, place, np.arange(6), MeasurementNoise(), rng, tension=tension
    )
    result = calibrate_motor_angles(angles, before)
    assert not result.frame.level and result.frame.vertical is None


def test_the_load_follows_a_turn_of_the_whole_set_up():
    result, _, angles, robot = tilted(1)
    position = result.position
    problem = MotorAngleProblem(robot, angles, SelfCalibrationSettings(friction_share=SHARE))
    shared = np.concatenate([exits(result).ravel(), problem.prior.mean[robot.exit_points.size :]])
    still = np.zeros((*position.shape, problem.size))
    used = np.ones(len(position), dtype=np.bool_)
    load = find_vertical(problem, shared, position, still, used).load
    turn = Rotation.from_rotvec([0.2, -0.1, 0.3])
    turned = problem.turned_values(turn.as_matrix(), shared)
    home = robot.home_position
    where = turn.apply(position - home) + home
    other = find_vertical(problem, turned, where, still, used).load
    assert other == pytest.approx(turn.apply(load), rel=1e-9)


def test_the_new_file_knows_the_tilt_as_well_as_the_tensions():
    result, _, _, _ = tilted(2)
    arms = result.before.anchor_points
    motion = moves(exits(result) - arms - result.frame.home, 1.0).reshape(-1, 6)
    back = np.linalg.pinv(motion)
    turns = (back @ result.frame.convention @ back.T)[3:5, 3:5]
    told = TILTED_BY @ turns @ TILTED_BY.T
    assert told == pytest.approx(result.frame.vertical.covariance, rel=1e-6)


def test_a_file_that_knows_one_tilt_better_keeps_its_own():
    _, _, angles, robot = tilted(2)
    sharp = np.tile(np.diag([1.0, 1.0, 1e-6]), (robot.n, 1, 1))  # heights: 0.5 mm
    wide = replace(robot, exit_covariance=0.25 * sharp)
    result = calibrate_motor_angles(angles, wide)
    assert not result.frame.level
    assert "know it better" in " ".join(result.sentences())


@pytest.mark.parametrize("kept", [1, 30])
def test_one_sample_or_no_tension_tells_nothing(kept):
    _, _, angles, robot = tilted(1)
    problem = MotorAngleProblem(robot, angles, SelfCalibrationSettings())
    used = np.arange(len(angles.samples)) < kept
    if kept > 1:
        problem.angles = replace(angles, tension=np.zeros_like(angles.tension))
    position = np.tile(robot.home_position, (len(used), 1))
    still = np.zeros((*position.shape, problem.size))
    assert find_vertical(problem, problem.prior.mean, position, still, used) is None


def test_x_goes_through_an_exit_point_of_the_upright_set_up():
    result, truth, _, _ = tilted(2, share=1e-3, lean=0.2, x_through="b")
    assert result.frame.level and result.frame.heading == "b"
    assert exits(result)[1, 1] == pytest.approx(0.0, abs=1e-3)
    assert lean(result, truth) < 0.01
