from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import carosac_toolkit as ct
from calibration import RestSettings, Unobservable, calibrate_rests, draw_rest_scene
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.rotations import from_matrix, roll_and_pitch, to_matrix
from carosac_toolkit.loop.values import Stamped
from carosac_toolkit.robot.similar import similar_robot
from tests.calibration.rests.scenes import scene, surveyed_robot

SEEDS = range(4)


@pytest.fixture(scope="module")
def found():
    """Scenes of four seeds and their calibrations."""
    robot = surveyed_robot()
    scenes = [scene(seed) for seed in SEEDS]
    return [(one, calibrate_rests(one.recording, robot)) for one in scenes]


def pose_error(one, result):
    turn = Rotation.from_matrix(result.rotation[0] @ one.rotation[0].T).as_rotvec()
    return np.concatenate([result.position[0] - one.position[0], turn])


def test_errors_of_the_first_pose_are_as_large_as_claimed(found):
    total = 0.0
    for one, result in found:
        assert result.warnings == () and result.converged and not result.useless
        error = pose_error(one, result)
        assert np.linalg.norm(error[:3]) < 0.03 and np.linalg.norm(error[3:]) < np.deg2rad(0.5)
        total += error @ np.linalg.solve(result.pose_covariance[0], error)
    low, high = chi2.ppf([0.001, 0.999], 6 * len(found))
    assert low < total < high


def test_errors_of_the_parameters_are_as_large_as_claimed(found):
    total, count = 0.0, 0
    for one, result in found:
        estimate = result.estimate
        error = estimate.value - np.array([one.truth[name] for name in estimate.names])
        total += error @ np.linalg.solve(estimate.covariance, error)
        count += len(error)
    low, high = chi2.ppf([0.001, 0.999], count)
    assert low < total < high


def test_the_scales_of_load_cells_are_found_to_a_few_percent(found):
    for one, result in found:
        scales = [s for s in result.sensors if s.name.startswith("tension_scale")]
        assert len(scales) == 4
        for scale in scales:
            assert scale.value == pytest.approx(one.truth[scale.name], abs=0.05)


def test_nearly_exact_sensors_find_the_pose_nearly_exactly():
    robot = replace(surveyed_robot(), exit_covariance=None)
    fine = RestSettings(
        length_noise=1e-6, tension_noise=1e-5, attitude_noise=1e-5, swivel_noise=1e-5
    )
    one = draw_rest_scene(robot, np.random.default_rng(7), noise=fine)
    result = calibrate_rests(one.recording, robot, settings=fine)
    error = pose_error(one, result)
    assert np.linalg.norm(error[:3]) < 1e-4
    assert np.linalg.norm(error[3:]) < 1e-5


def test_encoders_that_count_another_unit_are_read_by_their_scale():
    robot = replace(surveyed_robot(), length_scale=np.full(4, 1.25))
    one = scene(0, robot)
    result = calibrate_rests(one.recording, robot)
    error = pose_error(one, result)
    assert not result.blunders and not result.warnings
    assert error @ np.linalg.solve(result.pose_covariance[0], error) < chi2.ppf(0.999, 6)


def test_eight_cables_of_a_room_meet_the_bar():
    robot = similar_robot(ct.load_robot("warehouse"), 1.0 / 3.0)
    robot = replace(robot, exit_covariance=np.tile(1e-6 * np.eye(3), (8, 1, 1)))
    one = scene(0, robot)
    result = calibrate_rests(one.recording, robot)
    error = pose_error(one, result)
    deviation = error @ np.linalg.solve(result.pose_covariance[0], error)
    assert deviation < chi2.ppf(0.999, 6)
    assert np.sqrt(np.trace(result.pose_covariance[0, :3, :3])) < 3.5e-3


def test_an_inclinometer_does_as_well_where_the_heading_is_unknown(found):
    one, by_ahrs = found[0]
    attitude = one.recording.attitude
    tilt = Stamped(time=attitude.time, value=roll_and_pitch(to_matrix(attitude.value)))
    level = replace(one.recording, attitude=None, inclination=tilt)
    result = calibrate_rests(level, surveyed_robot())
    assert {s.name for s in by_ahrs.sensors} - {s.name for s in result.sensors} == {"heading"}
    error = pose_error(one, result)
    assert error @ np.linalg.solve(result.pose_covariance[0], error) < chi2.ppf(0.999, 6)


def test_a_slipped_cable_and_a_stuck_load_cell_are_left_out(found):
    one, good = found[1]
    length = np.array(one.recording.unstrained_length)
    length[100:120, 2] += 0.1  # the sixth rest
    tension = np.array(one.recording.tension.value)
    tension[200:220, 1] *= 1.5  # the eleventh
    spoilt = replace(
        one.recording,
        unstrained_length=length,
        tension=replace(one.recording.tension, value=tension),
    )
    result = calibrate_rests(spoilt, surveyed_robot())
    left_out = {(b.sensor, b.rest, b.cable) for b in result.blunders}
    cables = surveyed_robot().cable_names
    assert ("length", 5, cables[2]) in left_out and ("tension", 10, cables[1]) in left_out
    assert len(left_out) <= 4  # another cable may as well have slipped
    shift = np.linalg.norm(result.position[0] - good.position[0])
    assert shift < 0.5 * np.sqrt(np.trace(good.pose_covariance[0, :3, :3]))


def test_an_ahrs_may_head_anywhere(found):
    one, before = found[2]
    attitude = one.recording.attitude
    first = before.sensors[-1]
    assert first.name == "heading"
    turn = Rotation.from_rotvec([0.0, 0.0, np.pi - first.value]).as_matrix()
    turned = from_matrix(turn @ to_matrix(attitude.value))
    result = calibrate_rests(
        replace(one.recording, attitude=replace(attitude, value=turned)), surveyed_robot()
    )
    assert abs(result.sensors[-1].value) == pytest.approx(np.pi, abs=0.05)
    np.testing.assert_allclose(result.position, before.position, atol=1e-3)


def test_lengths_alone_are_refused_with_what_would_help():
    one = scene(0, tension=False, attitude=False, swivel=False)
    with pytest.raises(
        Unobservable, match="rests with lengths leave the first pose unknown"
    ) as caught:
        calibrate_rests(one.recording, surveyed_robot())
    assert "load cells or an AHRS or swivel angles" in str(caught.value)


def test_angles_of_the_wrong_sign_make_the_result_useless():
    one = scene(2)
    swivel = one.recording.swivel_angle
    wrong = replace(one.recording, swivel_angle=replace(swivel, value=-swivel.value))
    try:
        result = calibrate_rests(wrong, surveyed_robot())
    except Unobservable as error:
        assert "signs of the angles" in str(error)
        return
    assert result.useless
    assert any("signs of the angles right?" in line for line in result.warnings)


def test_more_noise_than_stated_widens_the_sigmas_and_is_said(found):
    good = found[3][1]
    loud = draw_rest_scene(
        surveyed_robot(), np.random.default_rng(3), noise=RestSettings(swivel_noise=0.01)
    )
    result = calibrate_rests(loud.recording, surveyed_robot())
    assert any("that of swivel angles above all" in line for line in result.warnings)
    assert result.misfit > 1.3
    assert result.pose_sigma[0, 2] > 1.2 * good.pose_sigma[0, 2]


def test_measured_poses_and_swivels_of_eyelets_are_said_to_be_unused(found):
    one, _ = found[0]
    eyelets = replace(surveyed_robot(), pulley_radius=np.zeros(4))
    result = calibrate_rests(one.recording, eyelets)
    assert "swivel angles are not used, as the robot has no pulleys" in result.sentences()


def test_another_number_of_cables_and_a_run_without_rests_are_refused(found):
    recording = found[0][0].recording
    with pytest.raises(InvalidField, match="8 cables"):
        calibrate_rests(recording, ct.load_robot("warehouse"))
    time = np.arange(0.0, 10.0, 0.1)
    moving = ct.Recording(time=time, unstrained_length=5.0 + time[:, None] + np.zeros(4))
    with pytest.raises(Unobservable, match="the winches never rest"):
        calibrate_rests(moving, surveyed_robot())
