"""Scales, zeros, mountings and headings of sensors, from rests at measured poses."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from calibration import LengthSettings, RestScene, calibrate_lengths
from calibration.rest_readings import rests_alone
from calibration.rests.sensors import SensorCalibration, calibrate_sensors
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import from_matrix, roll_and_pitch, to_matrix, wrapped_angle
from carosac_toolkit.cli.main import main
from carosac_toolkit.loop.values import Stamped
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.parameters import with_values
from carosac_toolkit.robot.robot import Robot
from tests.calibration.rests.scenes import scene

MOUNTED = np.array([0.3, -2.5, 0.8])  # rotation vector [rad]: any way round
NOISE_RAD = float(np.deg2rad(0.3))  # of an inclinometer at a rest
ZEROS = np.array([0.5, -1.0, 2.0, 3.0])  # of swivel encoders [rad]


def measured(made: RestScene) -> tuple[Recording, Robot]:
    """The rests with poses, sensors mounted any way, and the robot that was measured."""
    run, rests = made.recording, len(made.position)
    each = len(run.time) // rests
    rotation = np.repeat(made.rotation, each, axis=0)
    poses = PoseSamples.from_rotation(run.time, np.repeat(made.position, each, axis=0), rotation)
    turned = {}
    if run.attitude is not None:
        mounted = to_matrix(run.attitude.value) @ Rotation.from_rotvec(MOUNTED).as_matrix()
        turned["attitude"] = Stamped(time=run.time, value=from_matrix(mounted))
    if run.swivel_angle is not None and run.n == len(ZEROS):
        angle = wrapped_angle(run.swivel_angle.value + ZEROS)
        turned["swivel_angle"] = Stamped(time=run.time, value=angle)
    names = [f"length_offset[{cable}]" for cable in made.plant.cable_names]
    plant = with_values(made.plant, names, np.array([made.truth[name] for name in names]))
    return replace(run, poses=poses, **turned), plant


def mounting(made: RestScene) -> Array:
    """The rotation from the AHRS to the platform."""
    drawn = Rotation.from_rotvec([made.truth[f"mounting.{axis}"] for axis in "xyz"]).as_matrix()
    return np.asarray(drawn @ Rotation.from_rotvec(MOUNTED).as_matrix())


def normalised(found: SensorCalibration, made: RestScene) -> float:
    """The mean squared error of what was found, in standard deviations."""
    truth = made.truth | {
        f"swivel_offset[{cable}]": zero
        for cable, zero in zip(made.plant.cable_names, ZEROS, strict=True)
    }
    truth |= zip(
        (f"mounting.{axis}" for axis in "xyz"),
        Rotation.from_matrix(mounting(made)).as_rotvec(),
        strict=True,
    )
    off = [wrapped_angle(e.value - truth[e.name]) / e.sigma for e in found.errors]
    return float(np.mean(np.square(off)))


def found_mounting(found: SensorCalibration) -> Array:
    vector = [each.value for each in found.errors if each.name.startswith("mounting")]
    return np.asarray(Rotation.from_rotvec(vector).as_matrix())


def test_errors_are_found_to_what_their_sigmas_say_however_sensors_are_mounted() -> None:
    squares = []
    for seed in range(6):
        made = scene(seed)
        found = calibrate_sensors(*measured(made))
        assert len(found.errors) == 16
        squares.append(normalised(found, made))
        assert max(e.sigma for e in found.errors if e.name.startswith("mounting")) < 0.01
    assert 0.75 < np.mean(squares) < 1.3  # of 96, 99 % between 0.66 and 1.41


def test_an_inclinometer_is_mounted_as_found() -> None:
    run, plant = measured(scene(0, attitude=False, tension=False, swivel=False))
    assert run.poses is not None
    turn = Rotation.from_rotvec(MOUNTED).as_matrix()
    value = roll_and_pitch(to_matrix(run.poses.quaternion) @ turn)
    found = calibrate_sensors(replace(run, inclination=Stamped(time=run.time, value=value)), plant)
    assert [each.name for each in found.errors] == ["mounting.x", "mounting.y", "mounting.z"]
    angle = Rotation.from_matrix(found_mounting(found).T @ turn).magnitude()
    assert angle < 1e-5
    assert any("--mounting" in line for line in found.sentences)


def test_a_table_with_a_row_for_each_pose_tells_all_of_them() -> None:
    run, plant = measured(scene(0))
    rows = np.arange(5, len(run.time), 20)
    time = 0.7 * np.arange(len(rows)) + 0.1234

    def table(channel: Stamped | None) -> Stamped | None:
        return None if channel is None else Stamped(time=time, value=channel.value[rows])

    assert run.poses is not None
    alone = replace(
        run, time=time, unstrained_length=run.unstrained_length[rows],
        tension=table(run.tension), attitude=table(run.attitude),
        swivel_angle=table(run.swivel_angle),
        poses=PoseSamples(
            time=time, position=run.poses.position[rows], quaternion=run.poses.quaternion[rows]
        ),
    )  # fmt: skip
    found = calibrate_sensors(alone, plant)
    assert sum("calibrated at 27 rests" in line for line in found.sentences) == 3


def test_a_platform_that_never_turns_does_not_tell_how_an_inclinometer_is_mounted() -> None:
    run, plant = measured(scene(0, attitude=False, tension=False, swivel=False))
    assert run.poses is not None
    still = np.tile(np.eye(3), (len(run.time), 1, 1))
    poses = PoseSamples.from_rotation(run.time, run.poses.position, still)
    level = Stamped(time=run.time, value=np.zeros((len(run.time), 2)))
    found = calibrate_sensors(replace(run, inclination=level, poses=poses), plant)
    assert found.errors[2].sigma > 1.0  # about the vertical
    assert any("degrees only" in line for line in found.sentences)
    assert not any("--mounting" in line for line in found.sentences)


def test_a_steep_inclinometer_is_known_as_well_as_its_sigmas_say() -> None:
    off = []
    for seed in range(8):
        run, plant = measured(scene(seed, attitude=False, tension=False, swivel=False))
        assert run.poses is not None
        turn = Rotation.from_rotvec([0.0, np.pi / 2.0, 0.0])
        shaken = Rotation.from_rotvec(
            np.repeat(np.random.default_rng(seed).normal(0.0, NOISE_RAD, (27, 3)), 20, axis=0)
        )
        value = to_matrix(run.poses.quaternion) @ (turn * shaken).as_matrix()
        channel = Stamped(time=run.time, value=roll_and_pitch(value))
        found = calibrate_sensors(replace(run, inclination=channel), plant)
        vector = np.array([each.value for each in found.errors])
        off += list((vector - turn.as_rotvec()) / [each.sigma for each in found.errors])
    assert 0.4 < np.mean(np.square(off)) < 1.6


def test_more_than_six_cables_tell_swivel_zeros_but_no_load_cells() -> None:
    made = scene(0, ct.load_robot("warehouse"))
    found = calibrate_sensors(*measured(made))
    assert any("more than six cables" in line for line in found.sentences)
    zeros = [each for each in found.errors if each.name.startswith("swivel_offset")]
    assert len(zeros) == 8
    assert all(abs(each.value) < 4.0 * each.sigma for each in zeros)


def test_swivel_encoders_in_another_order_are_not_believed() -> None:
    run, plant = measured(scene(0))
    assert run.swivel_angle is not None
    swapped = Stamped(time=run.time, value=run.swivel_angle.value[:, [1, 0, 2, 3]])
    found = calibrate_sensors(replace(run, swivel_angle=swapped), plant)
    assert not any(each.name.startswith("swivel") for each in found.errors)
    assert any("the order of the cables" in line for line in found.warnings)


def test_sensors_without_rests_are_left_alone_and_it_is_said() -> None:
    run, plant = measured(scene(0))
    assert run.poses is not None
    found = calibrate_sensors(run.slice(0, 50), plant)
    assert found.errors == ()
    assert any("3 rests with its readings" in line for line in found.sentences)
    late = replace(run.poses, time=run.poses.time + 1e4)
    found = calibrate_sensors(replace(run, poses=late), plant)
    assert any("0 rests with its readings" in line for line in found.sentences)
    none = replace(run, attitude=None, tension=None, swivel_angle=None)
    assert calibrate_sensors(none, plant) == SensorCalibration()


def test_attitudes_are_compared_in_a_level_frame_where_that_of_the_poses_is_tilted() -> None:
    """Exit points that nobody surveyed are in the frame of the poses, which may lean."""
    made = scene(2)
    run, plant = measured(made)
    assert run.poses is not None
    tilt = Rotation.from_rotvec([0.03, -0.02, 0.0]).as_matrix()
    rotation = tilt.T @ to_matrix(run.poses.quaternion)
    leaning = PoseSamples.from_rotation(run.time, run.poses.position @ tilt, rotation)
    robot = replace(
        plant, exit_covariance=None, exit_points=plant.exit_points @ tilt,
            swivel_axis=plant.swivel_axis @ tilt,
        length_offset=None, length_scale=None,
    )  # fmt: skip
    result = calibrate_lengths(
        replace(run, poses=leaning), robot, settings=LengthSettings(tilt_prior=0.05)
    )
    assert result.gravity is not None and not result.anchored
    assert result.gravity.tilt == pytest.approx([0.03, -0.02], abs=2e-3)
    found = calibrate_sensors(replace(run, poses=leaning), result.level)
    assert normalised(found, made) < 1.6


def test_load_cells_in_other_units_or_of_the_other_sign_are_not_believed() -> None:
    run, plant = measured(scene(0))
    assert run.tension is not None
    for factor in (1.0 / 9.81, -1.0):
        wrong = Stamped(time=run.time, value=factor * run.tension.value)
        found = calibrate_sensors(replace(run, tension=wrong), plant)
        assert not any(each.name.startswith("tension") for each in found.errors)
        assert any("times what is taken for possible" in line for line in found.warnings)


def test_one_blunder_is_left_out_and_counted() -> None:
    made = scene(0)
    run, plant = measured(made)
    assert run.tension is not None and run.attitude is not None
    tension, attitude = run.tension.value.copy(), run.attitude.value.copy()
    tension[40:60, 1] *= 1.5
    attitude[100:120] = from_matrix(
        to_matrix(attitude[100:120]) @ Rotation.from_rotvec([0.1, 0.0, 0.0]).as_matrix()
    )
    broken = replace(
        run, tension=Stamped(time=run.time, value=tension),
        attitude=Stamped(time=run.time, value=attitude),
    )  # fmt: skip
    found = calibrate_sensors(broken, plant)
    assert sum("at 26 rests, without 1 blunder" in line for line in found.sentences) == 2
    assert normalised(found, made) < 1.6


def test_a_sensor_that_was_mostly_off_leaves_the_others_alone() -> None:
    run, plant = measured(scene(0))
    assert run.tension is not None
    few = Stamped(time=run.time[:60], value=run.tension.value[:60])
    found = calibrate_sensors(replace(run, tension=few), plant)
    assert any("load cells: not calibrated" in line for line in found.sentences)
    assert sum("calibrated at 27 rests" in line for line in found.sentences) == 2


def test_means_of_rests_are_compared_with_mean_poses() -> None:
    """A platform whose winches rest still sways, and poses show that as well as an AHRS."""
    made = scene(0, tension=False, swivel=False)
    run, plant = measured(made)
    assert run.poses is not None and run.attitude is not None
    sway = Rotation.from_rotvec(
        np.outer(np.sin(2.0 * np.pi * run.time / 0.7), [np.deg2rad(2.0), 0.0, 0.0])
    ).as_matrix()
    rotation = sway @ to_matrix(run.poses.quaternion)
    turn = Rotation.from_rotvec([0.0, 0.0, made.truth["heading"]]).as_matrix()
    felt = from_matrix(turn @ sway @ turn.T @ to_matrix(run.attitude.value))
    swaying = replace(
        run, attitude=Stamped(time=run.time, value=felt),
        poses=PoseSamples.from_rotation(run.time, run.poses.position, rotation),
    )  # fmt: skip
    found = calibrate_sensors(swaying, plant)
    assert normalised(found, made) < 2.0


def test_lengths_are_calibrated_at_rests_without_an_invented_delay() -> None:
    """Noise of a rest lasts as long as it does, and poses that rest tell of no clock."""
    squares = []
    for seed in range(3):
        made = scene(seed)
        run, plant = measured(made)
        assert run.poses is not None
        noise = np.random.default_rng(seed).normal(0.0, 1e-3, run.poses.position.shape)
        poses = replace(run.poses, position=run.poses.position + noise)
        unsurveyed = replace(plant, exit_covariance=None, length_offset=None, length_scale=None)
        result = calibrate_lengths(replace(run, poses=poses), unsurveyed)
        assert len(result.sample) == 27
        assert (result.sample // 20 == np.arange(27)).all()
        assert result.robot.length_delay == pytest.approx(0.0, abs=1e-3)
        assert result.estimate.sigma[result.estimate.index("length_delay")] > 0.09
        off = result.robot.exit_points - plant.exit_points
        assert result.robot.exit_covariance is not None
        sigma = np.sqrt(np.einsum("nii->ni", result.robot.exit_covariance))
        squares.append(np.mean((off / sigma) ** 2))
    assert np.mean(squares) < 1.5


def test_a_recording_that_moves_between_its_rests_is_used_as_it_is() -> None:
    run, plant = measured(scene(0))
    assert run.poses is not None
    assert rests_alone(run) is not None
    time = np.arange(len(run.time)) * 0.1  # winches jump from rest to rest
    moving = replace(
        run, time=time, poses=replace(run.poses, time=time), tension=None, attitude=None,
        swivel_angle=None,
    )  # fmt: skip
    assert rests_alone(moving) is None
    result = calibrate_lengths(moving, plant)
    assert len(result.sample) > 400


def test_command_prints_the_mounting_for_smooth_and_writes_all_errors(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = scene(0, ct.load_robot("scampi"), swivel=False)
    path, numbers = tmp_path / "rests.csv", tmp_path / "numbers.json"
    ct.save_recording(measured(made)[0], path)
    words = ["calibrate", "lengths", str(path), "--json", str(numbers)]
    assert main([*words, "--report", str(tmp_path / "report"), "--tension-noise", "0.02"]) == 0
    printed = capsys.readouterr().out
    assert "errors of the other sensors:" in printed and "--mounting" in printed
    sensors = json.loads(numbers.read_text())["sensors"]
    assert len(sensors) == 12
    assert sensors["heading"]["sigma"] < 0.01
    assert "Errors of other sensors" in (tmp_path / "report" / "report.html").read_text()


def test_command_holds_offsets_and_refuses_wrong_noise_before_the_fit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["calibrate", "lengths", "synthetic", "--offset-prior", "0"]
    assert main([*words, "--output", str(tmp_path / "held.yaml")]) in (0, 1)
    assert (tmp_path / "held.yaml").exists()
    made = scene(0, ct.load_robot("scampi"), swivel=False)
    path = tmp_path / "rests.csv"
    ct.save_recording(measured(made)[0], path)
    capsys.readouterr()
    assert main(["calibrate", "lengths", str(path), "--tension-noise", "0"]) == 2
    printed = capsys.readouterr()
    assert "tension" in printed.err and "> 0" in printed.err and printed.out == ""


def test_command_ends_with_status_1_where_a_sensor_does_not_fit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, _ = measured(scene(0, ct.load_robot("scampi"), swivel=False))
    assert run.tension is not None
    path, numbers = tmp_path / "kg.csv", tmp_path / "numbers.json"
    in_kg = Stamped(time=run.time, value=run.tension.value / 9.81)
    ct.save_recording(replace(run, tension=in_kg), path)
    assert main(["calibrate", "lengths", str(path), "--json", str(numbers)]) == 1
    assert "WARNING: load cells: not calibrated" in capsys.readouterr().out
    data = json.loads(numbers.read_text())
    assert any("load cells" in line for line in data["warnings"])
    assert set(data["sensors"]) == {"mounting.x", "mounting.y", "mounting.z", "heading"}
