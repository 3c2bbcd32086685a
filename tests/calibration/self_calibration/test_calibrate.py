from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from calibration.observability import Unobservable
from calibration.self_calibration.blunder_tests import settle
from calibration.self_calibration.calibrate import calibrate_motor_angles
from calibration.self_calibration.problem import MotorAngleProblem
from calibration.self_calibration.settings import SelfCalibrationSettings
from calibration.self_calibration.solver import equations, inverse
from calibration.self_calibration.starting_points import starts
from calibration.self_calibration.synthetic import (
    MeasurementNoise,
    draw_robot,
    measure_motor_angles,
)
from carosac_toolkit.base.errors import InvalidField
from tests.calibration.self_calibration.factor_graph import estimate
from tests.calibration.self_calibration.scenes import KNOWN, scene
from tests.calibration.self_calibration.test_problem import rotated_robot

SHARP = SelfCalibrationSettings(line_sigma=1e-6, known_sigma=(1e-6, 1e-6, 1e-6))
SILENT = MeasurementNoise(line=0.0, known=0.0)


def exits(result):
    n = result.before.n
    return result.estimate.value[: 3 * n].reshape(n, 3)


def exit_nees(result, truth):
    k = truth.exit_points.size
    error = result.estimate.value[:k] - truth.exit_points.ravel()
    return float(error @ np.linalg.solve(result.estimate.covariance[:k, :k], error))


def test_exact_angles_give_the_exact_robot_and_positions():
    before, truth, place, angles = scene(1, noise=SILENT)
    result = calibrate_motor_angles(angles, before, SHARP)
    assert np.linalg.norm(exits(result) - before.exit_points, axis=1).max() > 0.3  # it had to move
    assert exits(result) == pytest.approx(truth.exit_points, abs=1e-4)
    assert result.position == pytest.approx(place, abs=2e-5)
    k = 3 * truth.n
    assert result.estimate.value[k : k + 4] == pytest.approx(truth.drum_radius, rel=1e-4)
    assert result.estimate.value[k + 4 :] == pytest.approx(truth.drum_buildup, rel=1e-2)
    assert result.blunders == () and result.warnings == ()


def test_known_positions_on_the_bed_alone_find_the_side_by_the_ceiling():
    before, truth, place, angles = scene(2, known=(0, 1, 2, 3, 4))
    result = calibrate_motor_angles(angles, before)
    assert exits(result) == pytest.approx(truth.exit_points, abs=0.06)
    assert (exits(result)[:3, 2] < 0.0).all()
    assert result.position == pytest.approx(place, abs=0.03)


def test_eight_cables_over_pulleys_at_a_known_rotation():
    robot = rotated_robot()
    rng = np.random.default_rng(5)
    settings = SelfCalibrationSettings(exit_sigma=0.05, line_sigma=5e-4)
    truth = draw_robot(robot, rng, settings)
    place = rng.uniform(robot.workspace_min, robot.workspace_max, (20, 3))
    place[0] = robot.home_position
    angles = measure_motor_angles(
        truth, place, np.arange(6), MeasurementNoise(line=5e-4, known=5e-4), rng
    )
    result = calibrate_motor_angles(angles, robot, replace(settings, known_sigma=(5e-4,) * 3))
    assert exit_nees(result, truth) < chi2.ppf(0.9999, 24)
    assert np.linalg.norm(result.position - place, axis=1).max() < 3e-3


def test_sigmas_of_exit_points_positions_and_predictions_are_honest():
    exit_squares, place_squares, out_squares = [], [], []
    runs = 6
    for seed in range(100, 100 + runs):
        before, truth, place, angles = scene(seed, count=30)
        result = calibrate_motor_angles(angles, before, SelfCalibrationSettings(line_sigma=1e-3))
        exit_squares.append(exit_nees(result, truth))
        place_squares.append((((result.position - place) / result.position_sigma) ** 2).mean())
        out_squares += [((one.error / one.sigma) ** 2).mean() for one in result.left_out]
        assert result.blunders == ()
    low, high = chi2.ppf([0.005, 0.995], 12 * runs)
    assert low < sum(exit_squares) < high
    assert 0.6 < np.mean(place_squares) < 1.5
    assert 0.6 < np.mean(out_squares) < 1.5


def test_the_noise_of_the_line_is_found():
    before, _, _, angles = scene(9, count=60, noise=MeasurementNoise(line=2e-3))
    result = calibrate_motor_angles(angles, before)
    assert result.redundancy > 40.0
    assert result.line_sigma == pytest.approx(2e-3, rel=4.0 / np.sqrt(2.0 * result.redundancy))
    spread = result.line_residual_rms * np.sqrt(result.residual.size / result.redundancy)
    assert spread == pytest.approx(result.line_sigma, rel=0.1)


def test_gtsam_and_the_eliminated_equations_agree():
    before, _, _, angles = scene(3)
    problem = MotorAngleProblem(before, angles, SelfCalibrationSettings())
    settled = settle(problem, starts(problem)[0], SelfCalibrationSettings())
    graph = estimate(problem, settled)
    system = equations(problem, settled.fit.shared, settled.fit.position, settled.trust)
    expected = inverse(system.information)
    sigma = np.sqrt(np.diag(expected))
    assert (graph.shared - settled.fit.shared) / sigma == pytest.approx(0.0, abs=1e-3)
    assert np.sqrt(np.diag(graph.covariance)) == pytest.approx(sigma, rel=1e-3)
    assert graph.iterations <= 3


def test_lost_line_and_a_wrong_known_position_are_named_and_do_no_harm():
    blunders = {(9, 0): 0.12, (17, 3): -0.25, (3, 1): 0.08}
    before, truth, _, angles = scene(4, count=36, blunders=blunders)
    wrong = angles.known_position.copy()
    wrong[4] += [0.1, -0.03, 0.0]
    result = calibrate_motor_angles(replace(angles, known_position=wrong), before)
    assert {(b.sample, b.what) for b in result.blunders} == {
        ("9", "motor angles"), ("17", "motor angles"), ("3", "motor angles"),
        ("4", "known position"),
    }  # fmt: skip
    assert all(b.sigmas > 5.0 for b in result.blunders)
    assert np.isinf(result.position_sigma[9]).all() and np.isfinite(result.position_sigma[3]).all()
    assert exit_nees(result, truth) < chi2.ppf(0.9999, 12)
    clean = calibrate_motor_angles(scene(4, count=36)[3], before)
    assert exits(result) == pytest.approx(exits(clean), abs=0.02)


def test_exit_points_that_are_known_better_need_fewer_known_positions():
    before, truth, _, angles = scene(known=(0,))
    near = replace(
        before,
        exit_points=truth.exit_points + 0.01,
        exit_covariance=np.tile(0.02**2 * np.eye(3), (4, 1, 1)),
    )
    result = calibrate_motor_angles(angles, near)
    assert result.observability.weak or result.observability.blind
    assert exits(result) == pytest.approx(truth.exit_points, abs=0.06)


def test_too_few_samples_to_tell_the_noise_are_refused_unless_it_is_given():
    before, truth, _, angles = scene(count=6)
    with pytest.raises(
        InvalidField, match=r"more consistent lengths than parameters .* line_sigma"
    ):
        calibrate_motor_angles(angles, before)
    result = calibrate_motor_angles(angles, before, SelfCalibrationSettings(line_sigma=1e-3))
    assert exit_nees(result, truth) < chi2.ppf(0.9999, 12)


def test_a_wrong_sign_of_the_angles_is_refused():
    before, _, _, angles = scene(6)
    with pytest.raises(Unobservable, match=r"fit only to .* of line; is the robot file right"):
        calibrate_motor_angles(replace(angles, motor_angle=-angles.motor_angle), before)


@pytest.mark.parametrize(
    ("order", "known", "line"),
    [([0, 2, 1, 3], KNOWN, None), ([1, 0, 2, 3], (), None), ([0, 2, 1, 3], (), 1e-3)],
)
def test_swapped_motors_are_named(order, known, line):
    before, _, _, angles = scene(6, 40, known=known)
    settings = SelfCalibrationSettings(line_sigma=line)
    swapped = replace(angles, motor_angle=angles.motor_angle[:, order])
    first, second = (before.cable_names[k] for k in range(4) if order[k] != k)
    warnings = calibrate_motor_angles(swapped, before, settings).warnings
    assert any(f"with the motors {first} and {second} exchanged" in line for line in warnings)


def test_much_noise_of_the_line_is_a_warning_without_suspects():
    before, _, _, angles = scene(8, 40, noise=MeasurementNoise(line=8e-3))
    (warning,) = calibrate_motor_angles(angles, before).warnings
    assert "fit only to 0.00" in warning


def test_a_known_position_is_predicted_without_itself():
    before, _, _, angles = scene(7)
    result = calibrate_motor_angles(angles, before)
    assert [one.sample for one in result.left_out] == [str(k) for k in KNOWN]
    for one in result.left_out[1:3]:
        again = calibrate_motor_angles(angles.without_known([one.sample]), before)
        k = angles.index(one.sample)
        error = again.position[k] - angles.known_position[k]
        assert one.error == pytest.approx(error, abs=2e-4)
