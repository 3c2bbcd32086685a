"""Calibration from synthetic lengths and poses with the whole measurement model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

import carosac_toolkit as ct
from calibration.lengths import fit
from calibration.lengths.calibrate import calibrate_lengths
from calibration.lengths.checks import MixUp
from calibration.lengths.planning import suggest_poses
from calibration.lengths.result import LengthCalibration
from calibration.lengths.settings import LengthSettings
from calibration.lengths.synthetic import LengthSceneSettings, draw_length_scene
from calibration.observability import Unobservable
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.recordings.encoders import unstrained_lengths
from carosac_toolkit.recordings.files import load_recording
from carosac_toolkit.recordings.recording import Recording
from tests.calibration.lengths.scenes import exit_error, scene, with_pulleys


@pytest.fixture(scope="module")
def calibrated() -> LengthCalibration:
    made = scene("carosac", 1)
    return calibrate_lengths(made.recording, with_pulleys("carosac"))


def test_exit_points_come_out_far_better_than_they_were(calibrated: LengthCalibration) -> None:
    made = scene("carosac", 1)
    assert np.median(exit_error(made, with_pulleys("carosac"))) > 0.03
    assert exit_error(made, calibrated.robot).max() < 0.015
    assert np.median(exit_error(made, calibrated.robot)) < 0.006


def test_delay_and_noise_come_out(calibrated: LengthCalibration) -> None:
    made = scene("carosac", 1)
    row = calibrated.estimate.index("length_delay")
    error = calibrated.estimate.value[row] - made.truth["length_delay"]
    assert abs(error) < 4.0 * calibrated.estimate.sigma[row] < 1e-3
    assert calibrated.length_noise == pytest.approx(2e-3, rel=0.1)


def test_every_blunder_is_found_and_hardly_anything_else(calibrated: LengthCalibration) -> None:
    made = scene("carosac", 1)
    truth = made.outlier[calibrated.sample]
    assert calibrated.outlier[truth].all()
    assert (calibrated.outlier & ~truth).mean() < 0.005


def test_tachymeter_holds_the_exit_points_and_the_rest_follows() -> None:
    made = scene("carosac", 2, exit_sigma=1e-3)
    found = calibrate_lengths(made.recording, with_pulleys("carosac", exit_sigma=1e-3))
    assert np.median(exit_error(made, found.robot)) < 2e-3
    for axis in "xy":
        row = found.estimate.index(f"pose_tilt.{axis}")
        error = found.estimate.value[row] - made.truth[f"pose_tilt.{axis}"]
        assert abs(error) < 4.0 * found.estimate.sigma[row] < 1e-3
    offset = found.robot.length_offset
    assert offset is not None
    truth = [made.truth[f"length_offset[{c}]"] for c in found.robot.cable_names]
    assert offset == pytest.approx(truth, abs=5e-3)


@pytest.mark.parametrize("name", ["carosac", "cogiro"])
def test_covariance_is_consistent(name: str) -> None:
    """The squared error of all parameters, in the metric of the covariance, is chi-squared."""
    total, count = 0.0, 0
    for seed in range(4):
        made = scene(name, 10 + seed)
        found = calibrate_lengths(made.recording, with_pulleys(name)).estimate
        error = found.value - np.array([made.truth[each] for each in found.names])
        total += float(error @ np.linalg.solve(found.covariance, error))
        count += len(error)
    low, high = chi2.ppf([0.001, 0.999], count)
    assert low < total < high


def test_calibrated_robot_turns_readings_into_lengths() -> None:
    made = scene("cogiro", 3, outliers=0.0)
    found = calibrate_lengths(made.recording, with_pulleys("cogiro"))
    lengths = unstrained_lengths(found.robot, made.recording.unstrained_length)
    truth = unstrained_lengths(made.plant, made.recording.unstrained_length)
    radial = np.abs(lengths - truth).mean()  # what the exit points are off along the cables
    assert radial < 0.02


def test_relative_readings_only_lose_their_zero() -> None:
    made = scene("carosac", 1, relative=True)
    found = calibrate_lengths(made.recording, with_pulleys("carosac"))
    assert np.median(exit_error(made, found.robot)) < 0.006
    assert np.isinf(found.estimate.prior_sigma[found.estimate.index("length_offset[front_left]")])


def test_parameters_with_a_prior_of_zero_are_held() -> None:
    made = scene("carosac", 1)
    settings = LengthSettings(anchor_prior=0.0, scale_prior=0.0)
    found = calibrate_lengths(made.recording, with_pulleys("carosac"), settings=settings)
    assert not any(name.startswith(("anchor", "length_scale")) for name in found.estimate.names)
    assert (found.robot.anchor_points == with_pulleys("carosac").anchor_points).all()


def test_offset_and_radial_error_are_called_one_unknown(calibrated: LengthCalibration) -> None:
    assert any("almost one unknown" in line for line in calibrated.notes)


@pytest.mark.parametrize(
    ("spread", "shape"),
    [((0.01, 0.01, 0.01), "in one point"), ((1.0, 0.01, 0.01), "on one line")],
)
def test_poses_without_extent_are_refused(spread: tuple[float, float, float], shape: str) -> None:
    robot = with_pulleys("cogiro")
    settings = LengthSceneSettings(samples=60, spread=spread, turn=0.01)
    made = draw_length_scene(robot, np.random.default_rng(0), settings=settings)
    with pytest.raises(Unobservable, match=f"60 poses are {shape}"):
        calibrate_lengths(made.recording, robot)


def test_few_poses_are_refused_unless_a_tachymeter_knows_the_exit_points() -> None:
    made = scene("carosac", 2, exit_sigma=1e-3)
    short = made.recording.slice(100, 112)
    with pytest.raises(Unobservable, match="tachymeter"):
        calibrate_lengths(short, with_pulleys("carosac"))
    found = calibrate_lengths(short, with_pulleys("carosac", exit_sigma=1e-3))
    assert exit_error(made, found.robot).max() < 5e-3


def test_a_zero_that_is_far_off_is_found_and_no_mix_up() -> None:
    recording = scene("carosac", 1).recording
    shift = np.array([2.5, 0.0, 0.0, -1.5])
    far = replace(recording, unstrained_length=recording.unstrained_length + shift)
    found = calibrate_lengths(far, with_pulleys("carosac"))
    near = calibrate_lengths(recording, with_pulleys("carosac"))
    assert found.robot.length_offset is not None and near.robot.length_offset is not None
    assert found.robot.length_offset - near.robot.length_offset == pytest.approx(shift, abs=5e-3)


def test_relative_readings_have_a_zero_of_their_own_in_each_recording() -> None:
    first = scene("carosac", 1, relative=True).recording
    robot = calibrate_lengths(first, with_pulleys("carosac")).robot
    shift = np.array([0.5, -0.3, 0.2, 0.1])
    again = calibrate_lengths(
        replace(first, unstrained_length=first.unstrained_length + shift), robot
    )
    assert again.residual_rms < 3e-3
    assert again.robot.length_offset == pytest.approx(robot.length_offset + shift, abs=0.05)


def swapped(recording: Recording) -> Recording:
    return replace(recording, unstrained_length=recording.unstrained_length[:, [1, 0, 2, 3]])


@pytest.mark.parametrize("relative", [False, True])
def test_swapped_cables_are_named(relative: bool) -> None:
    made = scene("carosac", 1, relative=relative)
    with pytest.raises(MixUp, match="reading 1 moves as cable 'front_right', reading 2 moves as"):
        calibrate_lengths(swapped(made.recording), with_pulleys("carosac"))


def test_millimetres_are_named() -> None:
    recording = scene("carosac", 1).recording
    wrong = replace(recording, unstrained_length=recording.unstrained_length * 1e3)
    with pytest.raises(MixUp, match="are they in mm"):
        calibrate_lengths(wrong, with_pulleys("carosac"))


def test_recording_without_poses_is_refused() -> None:
    recording = replace(scene("carosac", 1).recording, poses=None)
    with pytest.raises(InvalidField, match="poses"):
        calibrate_lengths(recording, with_pulleys("carosac"))


def test_another_robot_is_refused() -> None:
    with pytest.raises(InvalidField, match="cables"):
        calibrate_lengths(scene("carosac", 1).recording, with_pulleys("cogiro"))


def test_suggested_poses_teach_more_than_those_of_chance() -> None:
    robot = with_pulleys("cogiro")
    found = suggest_poses(robot, 6, rng=np.random.default_rng(0))
    assert (np.diff(found.sigma) < 0.0).all()
    other = suggest_poses(robot, 1, rng=np.random.default_rng(0))
    assert other.position[0] == pytest.approx(found.position[0])
    assert (found.position >= robot.workspace_min - 1e-9).all()
    assert (found.position <= robot.workspace_max + 1e-9).all()


def test_a_suggested_pose_is_worth_what_was_predicted(calibrated: LengthCalibration) -> None:
    found = suggest_poses(calibrated, 3, rng=np.random.default_rng(0))
    assert found.sigma[0] == pytest.approx(
        np.sqrt(np.mean(calibrated.estimate.sigma[calibrated.unknowns.exits] ** 2)), rel=1e-6
    )
    assert found.sigma[-1] < found.sigma[0]


def test_no_poses_are_no_suggestion() -> None:
    with pytest.raises(InvalidField, match="suggest-poses"):
        suggest_poses(with_pulleys("cogiro"), 0, rng=np.random.default_rng(0))


def test_real_recording_has_the_known_delay(real_data) -> None:  # type: ignore[no-untyped-def]
    import carosac_toolkit as ct

    recording = load_recording(real_data / "scampi_run_part.csv")
    found = calibrate_lengths(recording, ct.load_robot("scampi"))
    assert found.estimate.value[found.estimate.index("length_delay")] == pytest.approx(
        0.033, abs=3e-3
    )
    assert found.residual_rms < 2e-3
    assert found.residual_rms < 0.4 * found.residual_rms_before


def test_a_robot_in_the_frame_of_its_poses_stays_there_when_it_is_calibrated_again():
    """The tilt of that frame turns gravity in both runs, not the exit points in the second."""
    robot = ct.load_robot("carosac")
    tilted = LengthSettings(tilt_prior=0.02)
    drawn = draw_length_scene(robot, np.random.default_rng(5), prior=tilted)
    first = calibrate_lengths(drawn.recording, robot, settings=tilted)
    again = calibrate_lengths(drawn.recording, first.robot, settings=tilted)
    assert not first.anchored and not again.anchored
    names = [f"exit_points[{c}].{a}" for c in robot.cable_names for a in "xyz"]
    truth = np.array([drawn.truth[name] for name in names])
    off = again.estimate.select(names).value - truth
    assert np.abs(off).max() < 0.015
    assert any("tilted by" in line for line in first.notes)


def test_a_cable_in_another_unit_is_refused_by_name():
    robot = ct.load_robot("carosac")
    recording = draw_length_scene(robot, np.random.default_rng(3)).recording
    lengths = np.array(recording.unstrained_length)
    lengths[:, 2] *= 1e3
    with pytest.raises(Unobservable, match=r"cable 'rear_right'.*another unit"):
        calibrate_lengths(replace(recording, unstrained_length=lengths), robot)


def test_further_rounds_would_hardly_move_the_parameters(monkeypatch):
    """A fit that stopped while its noise was still shrinking was 0.17 sigma off here."""
    made = scene("carosac", 3, exit_sigma=2e-3, relative=True)
    robot = with_pulleys("carosac", exit_sigma=2e-3)
    found = calibrate_lengths(made.recording, robot).estimate
    monkeypatch.setattr(fit, "SETTLED_SIGMAS", 1e-6)
    exact = calibrate_lengths(made.recording, robot).estimate
    assert np.abs((found.value - exact.value) / exact.sigma).max() < 0.02
    assert found.sigma == pytest.approx(exact.sigma, rel=1e-3)
