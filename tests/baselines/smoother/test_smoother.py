"""The smoother on simulated runs whose truth is known, and on the real recording."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import carosac_toolkit as ct
from baselines.dynamic_estimator import DynamicEstimator, DynamicEstimatorSettings
from baselines.smoother import SmootherSettings, smooth
from baselines.smoother.arranged_recording import arrange
from baselines.smoother.report import ANGLE_NAMES, sentences, warnings
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.rotations import roll_and_pitch, to_matrix, wrapped_angle
from carosac_toolkit.drivers.sensors import PERFECT_SENSORS, SensorSettings
from carosac_toolkit.loop.consistency import band, normalised_square
from carosac_toolkit.loop.values import Stamped
from carosac_toolkit.recordings.bundled import find_recording
from carosac_toolkit.recordings.poses import PoseSamples
from tests.baselines.smoother.runs import errors_of, filtered, rms, swing
from tests.calibration.identification.oscillations import free_oscillation
from tests.validation.runs import ROBOT

KNOWN = dict(mass=0.0, center_of_mass=0.0, length_bias=5e-3, length_bias_walk=0.0)
SMOOTH = dict(stretch_damping=0.0, stretch_noise=5e-4, rate_noise=0.05)
DATA = Path(os.environ.get("CAROSAC_DATA", Path(__file__).parents[4] / "shared" / "data"))


@pytest.fixture(scope="module")
def robot():
    return ct.load_robot("carosac")


@pytest.fixture(scope="module")
def noisy(robot):
    """A run with noise, biases and wind, and its truth."""
    return swing(robot, seed=3, wind=1.0, duration=1.5)


def settings(**changes):
    return SmootherSettings(dynamics=DynamicEstimatorSettings(**KNOWN, **SMOOTH), **changes)


@pytest.fixture(scope="module")
def with_poses(noisy, robot):
    return smooth(noisy[0], robot, settings(poses="used"))


def test_perfect_lengths_alone_give_the_swing(robot):
    """The plant is the model: what is left is the time step, and lengths between samples."""
    recording, truths = swing(robot, sensors=PERFECT_SENSORS, duration=2.0, every=2)
    found = smooth(recording, robot, settings(imu=False))
    moved = np.ptp([truth.position[0] for truth in truths], axis=0)
    assert moved.max() > 0.2
    assert rms(errors_of(found, truths)) < 2e-3
    assert found.converged and found.passes == 1 and found.inertial == found.poses == 0


def test_it_is_better_than_the_causal_filter(noisy, robot, with_poses):
    recording, truths = noisy
    estimator = DynamicEstimator.build(robot, DynamicEstimatorSettings(**KNOWN))
    causal = filtered(estimator, recording, truths, poses=True)
    found = errors_of(with_poses, truths)
    assert with_poses.converged
    assert rms(found) < 0.6 * rms(causal)
    assert rms(found[:, 3:]) < rms(causal[:, 3:])
    assert rms(found[:, 6:]) < rms(causal[:, 6:])


def test_its_covariance_holds_where_the_model_is_right(noisy, robot, with_poses):
    """One run: errors at all its samples hang together, and count as one."""
    low, high = band(6)
    for found in (with_poses, smooth(noisy[0], robot, settings(imu=False))):
        errors = errors_of(found, noisy[1])
        assert low < normalised_square(errors[:, :6], found.covariance[:, :6, :6]).mean() < high
        assert low < normalised_square(errors, found.covariance).mean() < high


@pytest.fixture(scope="module")
def angles():
    """A robot with pulleys, a run of it with swivel angles and an AHRS, and its truth."""
    carosac = ct.load_robot("carosac")
    robot = replace(carosac, pulley_radius=np.full(carosac.n, 0.05))
    suite = "lengths+pose+swivel+attitude"
    return robot, *swing(robot, seed=3, wind=3.0, duration=3.0, suite=suite)


def mounted(**changes):
    """Settings for sensors with the axes of the platform."""
    chosen = settings(**changes)
    return replace(chosen, dynamics=replace(chosen.dynamics, attitude_rotation=(0.0, 0.0, 0.0)))


@pytest.mark.parametrize("channel", ["swivel_angle", "attitude", "inclination"])
def test_angles_put_the_motion_right(angles, channel):
    robot, recording, truths = angles
    tilt = Stamped(
        time=recording.attitude.time, value=roll_and_pitch(to_matrix(recording.attitude.value))
    )
    others = {name: None for name in ("swivel_angle", "attitude") if name != channel}
    changed = {"inclination": tilt} if channel == "inclination" else {}
    found = smooth(replace(recording, **others, **changed), robot, mounted())
    alone = smooth(recording, robot, mounted(angles=False))
    assert found.converged and found.readings == {channel: len(recording.time)}
    assert not found.doubted_readings and not alone.readings
    assert any(f"{len(recording.time)} {ANGLE_NAMES[channel]}" in x for x in sentences(found))
    errors, before = errors_of(found, truths), errors_of(alone, truths)
    assert rms(errors) < 0.8 * rms(before)
    assert rms(errors[:, 6:]) < 0.8 * rms(before[:, 6:])
    low, high = band(6)
    assert low < normalised_square(errors[:, :6], found.covariance[:, :6, :6]).mean() < high


def test_an_ahrs_whose_mounting_is_not_stated_is_not_used(angles):
    robot, recording, _ = angles
    arranged = arrange(recording, robot, settings())
    assert {name for each in arranged.readings.values() for name in each} == {"swivel_angle"}
    said = "Not used: the AHRS or inclinometer"
    assert said in sentences(smooth(recording, robot, settings()))[0]
    assert said not in sentences(smooth(recording, robot, mounted()))[0]


def test_zeros_of_swivel_angles_are_found_from_nothing(angles):
    robot, recording, _ = angles
    zeros = np.array([3.0, -1.0, 0.5, 2.0])
    wrong = replace(
        recording.swivel_angle, value=wrapped_angle(recording.swivel_angle.value + zeros)
    )
    found, others = (
        smooth(replace(recording, swivel_angle=each, attitude=None), robot, settings())
        for each in (wrong, recording.swivel_angle)
    )
    away = wrapped_angle(found.swivel_offset - zeros)
    sigma = np.hypot(found.swivel_offset_sigma, SensorSettings().swivel_bias)
    assert (np.abs(away) < 3.5 * sigma).all()
    assert (found.swivel_offset_sigma < 0.02).all()
    np.testing.assert_allclose(found.position, others.position, atol=1e-3)


def test_an_ahrs_that_is_mounted_otherwise_than_stated_is_found_and_said(angles):
    robot, recording, _ = angles
    dynamics = replace(settings().dynamics, attitude_rotation=(0.4, 0.0, 0.0))
    found = smooth(recording, robot, replace(settings(), dynamics=dynamics))
    right = smooth(recording, robot, mounted())
    said = [line for line in warnings(found) if "sigma, from how --mounting" in line]
    assert len(said) == 1 and "turned by 24 degrees" in said[0]  # 0.4 rad and its own error
    assert not any("--mounting" in line for line in warnings(right))
    np.testing.assert_allclose(found.position, right.position, atol=1e-3)


def test_of_angles_that_are_read_often_some_are_used(angles):
    robot, recording, _ = angles
    time = np.arange(recording.time[0], recording.time[-1], 1e-3)
    quick = Stamped(time=time, value=np.zeros((len(time), 4)))
    arranged = arrange(replace(recording, swivel_angle=quick), robot, settings())
    assert len(arranged.readings) <= 50.0 * recording.duration + 2


def test_a_delay_that_is_not_known_is_told_by_an_ahrs_and_not_by_swivel_angles(angles):
    """These share the clock of the lengths."""
    robot, recording, _ = angles
    late = 0.02
    by_swivel = replace(
        recording, attitude=None, time=recording.time - late,
        swivel_angle=replace(recording.swivel_angle, time=recording.swivel_angle.time - late),
    )  # fmt: skip
    found = smooth(by_swivel, robot, mounted(delay=0.03))
    assert found.delay_sigma == pytest.approx(0.03, rel=0.02)
    both = smooth(replace(by_swivel, attitude=recording.attitude), robot, mounted(delay=0.03))
    assert both.delay_sigma < 0.01
    assert both.delay == pytest.approx(late, abs=3.0 * both.delay_sigma)


def test_poses_that_were_not_used_are_met_to_their_noise(noisy, robot):
    found = smooth(noisy[0], robot, settings(poses="half"))
    assert found.poses + len(found.measured.time) <= len(noisy[0].poses.time)
    parts = found.scores.parts
    assert parts["all"].samples == len(found.measured.time) > 10
    assert found.compared.time == pytest.approx(found.measured.time, abs=0.0)
    assert parts["all"].rmse[3] < 2.0 * np.sqrt(3.0) * 1e-3  # 1 mm an axis
    assert 0.2 < found.scores.nees["all"] < 2.0


def test_poses_between_the_length_samples_are_scored_at_their_own_times(noisy, robot):
    """13 ms of a swing are centimetres: an estimate at the nearest sample would be far off."""
    recording = noisy[0]
    shift = 0.013
    turn, place = recording.poses.rotation, recording.poses.position
    poses = PoseSamples.from_rotation(recording.poses.time + shift, place, turn)
    lengths = replace(recording, time=recording.time + shift, imu=None)
    late = replace(recording, poses=poses, imu=None)
    same = smooth(replace(lengths, poses=poses), robot, settings(poses="half"))
    # lengths lead by the shift now, and their own time says so
    found = smooth(late, replace(robot, length_delay=shift), settings(poses="half"))
    parts, fair = found.scores.parts["all"], same.scores.parts["all"]
    own = poses.time[1::2]
    own = own[own <= late.time[-1]]
    assert found.measured.time == pytest.approx(own, abs=0.0)
    assert parts.samples == len(own) >= fair.samples - 1
    speed = np.linalg.norm(np.diff(place, axis=0), axis=1) / np.diff(recording.poses.time)
    assert speed.max() * shift > 5e-3
    assert parts.rmse[3] < 1.3 * fair.rmse[3] + 2e-4
    assert parts.rmse[3] < 2.0 * np.sqrt(3.0) * 1e-3


def test_what_is_scored_lies_between_start_and_stop(noisy, robot):
    recording = noisy[0]
    poses = replace(recording.poses, time=recording.poses.time + 0.013)
    data = arrange(replace(recording, poses=poses), robot, settings(poses="half", imu=False))
    keys, wanted = data.withheld(8, 20)
    low, high = recording.time[[8, 19]]
    inside = (poses.time >= low) & (poses.time <= high) & (np.arange(len(poses.time)) % 2 == 1)
    assert wanted.time == pytest.approx(poses.time[inside], abs=0.0) and inside.sum() > 3
    assert data.time[keys] == pytest.approx(wanted.time, abs=2e-6)
    assert data.withheld(8, 9) is None


def test_that_nothing_is_left_to_score_is_said(noisy, robot):
    recording = noisy[0]
    away = replace(recording.poses, time=recording.poses.time + 100.0)
    found = smooth(replace(recording, poses=away), robot, settings(imu=False))
    assert found.scores is None and found.measured is None
    assert any("no score" in line for line in warnings(found))


def test_constants_found_far_away_are_said(without_imu):
    assert not any("sigma away" in line for line in warnings(without_imu))
    known = replace(without_imu.settings.dynamics, mass=0.03, center_of_mass=0.01)
    taken = replace(without_imu.settings, dynamics=known)
    light = replace(without_imu, settings=taken, mass=0.85 * without_imu.robot.mass)
    assert any("5.4 sigma away" in line for line in warnings(light))
    center = without_imu.robot.center_of_mass - np.array([0.0, 0.04, 0.0])
    aside = replace(without_imu, settings=taken, center_of_mass=center)
    assert any("40.0 mm, 4.0 sigma, away" in line for line in warnings(aside))


@pytest.fixture(scope="module")
def without_imu(noisy, robot):
    return smooth(noisy[0], robot, settings(poses="used", imu=False))


@pytest.fixture(scope="module")
def uncalibrated():
    """The bundled recording: another plant, wind, and lengths that lead poses by 30 ms."""
    recording = ct.load_recording(find_recording("synthetic")).slice(0, 220)
    return smooth(recording, ct.load_robot("carosac"), SmootherSettings(poses="half"))


def test_an_uncalibrated_robot_settles_and_its_delay_is_found(uncalibrated):
    """Each key frame starts anew from where the last pass left it: sway does not add up."""
    assert uncalibrated.converged and uncalibrated.passes <= 6
    assert uncalibrated.delay == pytest.approx(0.03, abs=1.5e-3)
    assert uncalibrated.delay_sigma < 1e-3
    assert uncalibrated.scores.parts["moving"].rmse[3] < 1.3 * np.sqrt(3.0) * 1e-3
    assert 0.4 < uncalibrated.scores.nees["moving"] < 1.5


def test_what_the_data_told_is_kept_apart_from_what_was_taken_for_granted(uncalibrated, noisy):
    assert uncalibrated.told["delay"] and uncalibrated.told["length_bias"]
    assert any(line.startswith("Told by the data: readings") for line in sentences(uncalibrated))
    alone = smooth(noisy[0], ct.load_robot("carosac"), SmootherSettings(imu=False))
    assert not any(alone.told.values())
    said = [line for line in sentences(alone) if "mass" in line]
    assert len(said) == 1 and said[0].startswith("Taken for granted: readings too long by +0.0 +-7")


def test_what_is_not_known_of_the_delay_counts_where_nothing_tells_it(noisy, robot):
    """Lengths alone: the platform is somewhere along its path, by its speed times the delay."""
    known = smooth(noisy[0], replace(robot, length_delay=0.0), settings(imu=False))
    found = smooth(noisy[0], robot, settings(imu=False, delay=0.02))
    more = np.trace((found.covariance - known.covariance)[:, :3, :3], axis1=1, axis2=2)
    assert more == pytest.approx(((0.02 * known.twist[:, :3]) ** 2).sum(axis=1), abs=1e-9)
    assert found.delay_sigma == pytest.approx(0.02, rel=1e-6) and known.delay_sigma == 0.0


def test_a_robot_of_another_recording_is_said(noisy, robot):
    assert smooth(noisy[0], robot, settings(imu=False)).misfits == ()
    longer = replace(noisy[0], unstrained_length=noisy[0].unstrained_length + 50.0)
    with pytest.raises(CarosacError, match=r"(?s)cannot hang at rest.*times the distance at the"):
        smooth(longer, robot, settings())


def test_passes_end_at_the_tolerance_or_at_their_largest_number(noisy, robot, without_imu):
    assert without_imu.converged and without_imu.passes > 1
    coarse = smooth(noisy[0], robot, settings(poses="used", imu=False, tolerance=1.0))
    assert coarse.converged and coarse.passes < without_imu.passes
    assert coarse.change > without_imu.change
    once = smooth(noisy[0], robot, settings(poses="used", imu=False, iterations=1))
    assert once.passes == 1 and not once.converged


def test_gross_poses_count_little(noisy, robot, without_imu):
    recording, truths = noisy
    wrong = recording.poses.position.copy()
    wrong[[7, 20]] += [0.3, -0.2, 0.1]
    poses = PoseSamples(
        time=recording.poses.time, position=wrong, quaternion=recording.poses.quaternion
    )
    found = smooth(replace(recording, poses=poses), robot, settings(poses="used", imu=False))
    assert found.doubted == 2 and without_imu.doubted == 0
    assert rms(errors_of(found, truths)) < 1.3 * rms(errors_of(without_imu, truths)) + 2e-4


def test_a_lag_gives_nearly_the_same(noisy, robot, without_imu):
    found = smooth(noisy[0], robot, settings(poses="used", imu=False, lag=0.5))
    error = errors_of(found, noisy[1])
    assert rms(error) < 1.5 * rms(errors_of(without_imu, noisy[1])) + 2e-4
    assert found.position[-1] == pytest.approx(without_imu.position[-1], abs=5e-4)


def test_an_outlier_of_the_lengths_is_left_out(noisy, robot):
    recording = noisy[0]
    lengths = recording.unstrained_length.copy()
    lengths[15, 1] += 0.5
    data = arrange(replace(recording, unstrained_length=lengths), robot, settings())
    clean = arrange(recording, robot, settings())
    assert data.outliers == 1 and clean.outliers == 0
    time = recording.time
    assert data.path.at(time) == pytest.approx(clean.path.at(time), abs=5e-3)


@pytest.mark.parametrize("cables", [[1], [0, 1, 2, 3]])
def test_what_encoders_slipped_by_is_taken_off(noisy, robot, cables):
    """The first reading after the slip is in doubt; the next ones say that it lasts."""
    recording = noisy[0]
    lengths = recording.unstrained_length.copy()
    lengths[15:, cables] += 0.3
    data = arrange(replace(recording, unstrained_length=lengths), robot, settings())
    clean = arrange(recording, robot, settings())
    assert 1 <= data.outliers <= 5
    time = recording.time
    assert data.path.at(time) == pytest.approx(clean.path.at(time), abs=5e-3)


def test_lengths_count_late_by_the_delay(noisy, robot):
    late = replace(robot, length_delay=0.03)
    data = arrange(noisy[0], late, settings())
    when = float(noisy[0].time[20])
    assert data.reading(when + 0.03, data.delay) == pytest.approx(
        data.path.at(np.array(when)), abs=1e-12
    )


def test_key_frames_are_where_something_was_measured(noisy, robot):
    data = arrange(noisy[0], robot, settings(poses="used"))
    assert (np.diff(data.time) > 0.0).all()
    assert data.time[data.samples] == pytest.approx(noisy[0].time, abs=1e-6)
    steps = [data.time[k] - data.time[k - 1] for k in data.felt]
    assert max(steps) < 0.0101
    samples = sum(felt.samples for felt in data.felt.values())
    inside = (noisy[0].imu.time > data.time[0]) & (noisy[0].imu.time <= data.time[-1])
    assert samples == pytest.approx(inside.sum(), abs=1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (dict(poses="all"), "poses: got 'all'; allowed: one of"),
        (dict(lag=0.0), "lag: got 0.0 s; allowed: lag > 0"),
        (dict(iterations=0), "iterations: got 0; allowed: a whole number from 1"),
        (dict(tolerance=0.0), "tolerance"),
    ],
)
def test_settings_that_make_no_sense_are_refused(changes, message):
    with pytest.raises(InvalidField, match=message):
        SmootherSettings(**changes)


def test_recordings_that_cannot_be_smoothed_are_refused(noisy, robot):
    recording = noisy[0]
    with pytest.raises(InvalidField, match="two length samples"):
        smooth(recording.slice(0, 1), robot)
    with pytest.raises(InvalidField, match="poses"):
        smooth(replace(recording, poses=None), robot, SmootherSettings(poses="used"))
    with pytest.raises(InvalidField, match="start, stop"):
        smooth(recording, robot, start=5, stop=5)
    with pytest.raises(InvalidField, match="cables"):
        smooth(recording, ct.load_robot("cogiro"))
    far = replace(recording, unstrained_length=recording.unstrained_length + 50.0, poses=None)
    with pytest.raises(CarosacError, match="cannot hang at rest"):
        smooth(far, robot, settings(imu=False))


@pytest.mark.skipif(not DATA.is_dir(), reason=f"no data in {DATA}")
def test_every_second_pose_of_the_real_run_halves_the_error_or_better():
    recording = ct.load_recording(DATA / "scampi_run_part.csv").slice(0, 45)
    robot = ct.load_robot("scampi")
    alone = smooth(recording, robot)
    found = smooth(recording, robot, SmootherSettings(poses="half"))
    assert found.scores.parts["all"].rmse[3] < 0.01
    assert found.scores.parts["all"].rmse[3] < 0.5 * alone.scores.parts["all"].rmse[3]


def test_a_recording_that_begins_in_motion_is_smoothed_from_there():
    """A free oscillation with locked winches: without poses nothing tells it, which is said."""
    recording, (position, _) = free_oscillation(ROBOT, 1, swing=0.15, duration=5.0)
    seen = smooth(recording, ROBOT, SmootherSettings(poses="half"))
    away = np.linalg.norm(seen.position - position, axis=1)
    assert away.max() < 2e-3 < 0.05 * np.ptp(position, axis=0).max()
    assert not seen.misfits
    blind = smooth(recording, ROBOT)
    assert any("begins at rest" in line for line in blind.misfits)
