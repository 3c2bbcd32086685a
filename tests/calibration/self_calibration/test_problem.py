from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from calibration.self_calibration.problem import MotorAngleProblem
from calibration.self_calibration.settings import SelfCalibrationSettings
from calibration.self_calibration.synthetic import MeasurementNoise, measure_motor_angles
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.rotations import from_rotation_vector
from carosac_toolkit.physics.cable.drum import drums_of
from tests.calibration.self_calibration.scenes import scene
from tests.robots import eight_cable_robot, with_pulleys

SILENT = MeasurementNoise(line=0.0, known=0.0)


def rotated_robot():
    """Eight cables over pulleys, the platform held at a rotation, drums of two makes."""
    turn = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, 0.96, -0.28], [0.0, 0.28, 0.96]])
    return replace(
        with_pulleys(eight_cable_robot(), 0.05),
        home_rotation=turn @ tilt,
        drum_radius=np.repeat([0.08, 0.1], 4),
        drum_buildup=np.repeat([1e-5, 2e-5], 4),
        drum_gear=np.full(8, 10.0),
        drum_advantage=np.repeat([1.0, 2.0], 4),
    )


def rotated_problem(soft=False):
    robot = replace(rotated_robot(), axial_stiffness=np.repeat([2e4, 5e4], 4))
    rng = np.random.default_rng(3)
    place = rng.uniform(robot.workspace_min, robot.workspace_max, (5, 3))
    place[0] = robot.home_position
    tension = rng.uniform(5.0, 50.0, (5, 8)) if soft else None
    angles = measure_motor_angles(robot, place, np.arange(2), SILENT, rng, tension=tension)
    return MotorAngleProblem(robot, angles, SelfCalibrationSettings(keeps_rotation=True)), place


@pytest.mark.parametrize("soft", [False, True])
def test_residuals_of_the_truth_vanish_over_pulleys_and_at_a_rotation(soft):
    problem, place = rotated_problem(soft)
    assert problem.linearize(problem.prior.mean, place).residual == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("soft", [False, True])
def test_derivatives_agree_with_finite_differences(soft):
    problem, place = rotated_problem(soft)
    rng = np.random.default_rng(4)
    shared = problem.prior.mean * (1.0 + 0.02 * rng.normal(size=problem.size))
    shared[problem.radii] += 1e-3
    place = place + rng.normal(0.0, 0.05, place.shape)
    linear = problem.linearize(shared, place)
    step = 1e-6
    for j in range(problem.size):
        size = step * max(1e-3, abs(shared[j]))
        ends = []
        for sign in (1.0, -1.0):
            moved = shared.copy()
            moved[j] += sign * size
            ends.append(problem.linearize(moved, place).residual)
        slope = (ends[0] - ends[1]) / (2.0 * size)
        assert linear.by_shared[:, :, j] == pytest.approx(slope, rel=1e-5, abs=1e-6)
    for axis in range(3):
        away = step * np.eye(3)[axis]
        slope = (
            problem.linearize(shared, place + away).residual
            - problem.linearize(shared, place - away).residual
        ) / (2.0 * step)
        assert linear.by_own[:, :, axis] == pytest.approx(slope, abs=1e-7)


def test_one_row_is_the_row_of_all():
    problem, place = rotated_problem()
    whole = problem.linearize(problem.prior.mean, place)
    one = problem.linearize(problem.prior.mean, place[2:3], slice(2, 3))
    assert one.residual[0] == pytest.approx(whole.residual[2], abs=1e-14)
    assert one.by_shared[0] == pytest.approx(whole.by_shared[2], abs=1e-12)


def test_the_radius_with_all_line_wound_in_has_the_derivative_it_says():
    problem, _ = rotated_problem()
    radius, slope = problem.drum_radius(problem.prior.mean)
    assert radius == pytest.approx(drums_of(problem.robot).radius, rel=1e-12)
    for j in np.flatnonzero(slope.any(axis=0)):
        size = 1e-6 * max(1e-3, abs(problem.prior.mean[j]))
        moved = problem.prior.mean.copy()
        moved[j] += size
        found = (problem.drum_radius(moved)[0] - radius) / size
        assert slope[:, j] == pytest.approx(found, rel=1e-4, abs=1e-7)


def test_alike_drums_share_their_radius_error():
    before, _, _, angles = scene()
    problem = MotorAngleProblem(before, angles, SelfCalibrationSettings())
    assert [name for name in problem.prior.names if name.startswith("drum_radius")] == [
        "drum_radius[a, b, c]", "drum_radius[d]",
    ]  # fmt: skip
    assert [name for name in problem.prior.names if name.startswith("drum_buildup")] == [
        "drum_buildup[a, b, c, d]"
    ]
    other = replace(before, drum_radius=before.drum_radius + np.array([0.0, 1e-3, 0.0, 0.0]))
    names = MotorAngleProblem(other, angles, SelfCalibrationSettings()).prior.names
    assert "drum_radius[a, c]" in names and "drum_radius[b]" in names


def test_a_robot_without_drums_is_refused():
    _, _, _, angles = scene()
    before = replace(ct.load_robot("carosac"), cable_names=("a", "b", "c", "d"))
    with pytest.raises(InvalidField, match="drum_radius: got unknown for robot 'carosac'"):
        MotorAngleProblem(before, angles, SelfCalibrationSettings())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"line_sigma": 0.0}, "line_sigma: got 0.0; allowed: > 0"),
        ({"known_sigma": (1e-3, -1e-3, 1e-3)}, "known_sigma: got"),
        ({"blunder": 0.5}, "blunder: got 0.5; allowed: 0 < blunder < 0.1"),
    ],
)
def test_settings_that_mean_nothing_are_refused(change, message):
    with pytest.raises(InvalidField, match=message):
        SelfCalibrationSettings(**change)


def test_lengths_measured_by_hand_are_where_the_search_starts():
    before, _, _, angles = scene()
    by_hand = SelfCalibrationSettings(length_at_zero=np.array([1.6, 1.8, 1.5, 2.4]))
    problem = MotorAngleProblem(before, angles, by_hand)
    assert problem.prior.mean[problem.zeros] == pytest.approx([1.6, 1.8, 1.5, 2.4])
    assert problem.prior.sigma[problem.zeros] == pytest.approx(0.02)
    assert problem.longest == 2.4


def test_derivatives_by_a_free_rotation_agree_with_finite_differences():
    robot = rotated_robot()
    rng = np.random.default_rng(7)
    place = rng.uniform(robot.workspace_min, robot.workspace_max, (5, 3))
    place[0] = robot.home_position
    turns = rng.normal(0.0, 0.3, (5, 3))
    turns[0] = 0.0
    rotation = from_rotation_vector(turns) @ robot.home_rotation
    angles = measure_motor_angles(robot, place, np.arange(0), SILENT, rng, rotation=rotation)
    problem = MotorAngleProblem(robot, angles, SelfCalibrationSettings())
    assert problem.own == 6
    own = np.hstack([place, turns])
    linear = problem.linearize(problem.prior.mean, own)
    assert linear.residual == pytest.approx(0.0, abs=1e-12)
    assert problem.rotations(own) == pytest.approx(rotation, abs=1e-15)
    for k in range(6):
        away = 1e-6 * np.eye(6)[k]
        ends = [problem.linearize(problem.prior.mean, own + s * away).residual for s in (1, -1)]
        slope = (ends[0] - ends[1]) / 2e-6
        assert linear.by_own[:, :, k] == pytest.approx(slope, abs=1e-7)
