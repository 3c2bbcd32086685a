from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.drivers.replay import ReplayDriver, ReplaySettings
from carosac_toolkit.loop.values import Command, Stamped
from carosac_toolkit.recordings.encoders import (
    calibrated,
    is_calibrated,
    readings,
    unstrained_lengths,
)
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.parameters import with_values
from carosac_toolkit.validation import validate
from tests.recordings.synthetic import assert_same, full_recording
from tests.robots import eight_cable_robot, simple_robot
from tests.validation.runs import ROBOT, perfect

OFFSET, SCALE = [0.1, -0.2, 0.3, 0.0], [1.0, 1.002, 0.998, 1.001]
TURN = Rotation.from_rotvec([0.01, -0.02, 0.4]).as_matrix()
SENSORS = {"length_offset": OFFSET, "length_scale": SCALE, "pose_rotation": TURN}


def misread(recording: Recording, robot) -> Recording:
    """What the sensors of a robot say of a run: the inverse of `calibrated`."""
    turn = robot.pose_rotation
    poses = recording.poses
    rate, command, exits = recording.length_rate, recording.command, recording.exit_points
    return replace(
        recording,
        unstrained_length=readings(robot, recording.unstrained_length),
        length_rate=None if rate is None else replace(rate, value=rate.value * SCALE),
        command=None if command is None else replace(command, value=readings(robot, command.value)),
        poses=PoseSamples.from_rotation(poses.time, poses.position @ turn, turn.T @ poses.rotation),
        exit_points=None if exits is None else exits @ turn,
    )


@pytest.mark.parametrize("missing", [(), ("length_offset",), ("length_scale",)])
def test_readings_and_lengths_undo_each_other(missing):
    robot = simple_robot(**{k: v for k, v in SENSORS.items() if k not in missing})
    lengths = np.random.default_rng(0).uniform(1.0, 9.0, (5, 3, 4))
    assert unstrained_lengths(robot, readings(robot, lengths)) == pytest.approx(lengths, rel=1e-14)
    scale = robot.length_scale if robot.length_scale is not None else 1.0
    more = readings(robot, lengths + 1.0) - readings(robot, lengths)
    assert more == pytest.approx(np.broadcast_to(scale, more.shape))
    offset = robot.length_offset if robot.length_offset is not None else np.zeros(4)
    assert readings(robot, np.zeros(4)) == pytest.approx(offset)
    assert is_calibrated(robot)


def test_every_channel_is_converted_and_nothing_else_changes():
    clean, robot = full_recording(), simple_robot(**SENSORS)
    converted = calibrated(misread(clean, robot), robot)
    assert converted.unstrained_length == pytest.approx(clean.unstrained_length, rel=1e-14)
    assert converted.command.value == pytest.approx(clean.command.value, rel=1e-12)
    assert converted.length_rate.value == pytest.approx(clean.length_rate.value, rel=1e-14)
    assert converted.poses.position == pytest.approx(clean.poses.position, abs=1e-14)
    assert converted.poses.rotation == pytest.approx(clean.poses.rotation, abs=1e-14)
    assert converted.exit_points == pytest.approx(clean.exit_points, abs=1e-14)
    untouched = {
        name: getattr(clean, name)
        for name in ("unstrained_length", "command", "length_rate", "poses", "exit_points")
    }
    assert_same(replace(converted, **untouched), clean)  # time stamps, IMU, tensions


def test_hysteresis_is_taken_off_as_the_winches_wind():
    """After long winding one way a cable is shorter than was read by it, then longer."""
    clean = full_recording()
    there = np.linspace(0.0, 1.0, len(clean.time) // 2)
    way = np.concatenate([there, there[::-1], np.zeros(len(clean.time) - 2 * len(there))])
    read = replace(clean, unstrained_length=clean.unstrained_length[:1] + way[:, None])
    hysteresis = np.array([0.002, 0.0, 0.001, 0.004])
    found = calibrated(read, simple_robot(length_hysteresis=hysteresis)).unstrained_length
    late = read.unstrained_length - found
    assert late[0] == pytest.approx(0.0, abs=1e-15)
    assert late[len(there) - 1] == pytest.approx(hysteresis, rel=1e-6)
    assert late[2 * len(there) - 1] == pytest.approx(-hysteresis, rel=1e-6)


def test_absent_channels_stay_absent():
    bare = full_recording(length_rate=None, command=None, poses=None, exit_points=None)
    converted = calibrated(bare, simple_robot(**SENSORS))
    assert (
        converted.length_rate
        is converted.command
        is converted.poses
        is converted.exit_points
        is None
    )


def test_a_robot_that_says_nothing_of_its_sensors_leaves_the_recording_alone():
    recording = full_recording()
    assert calibrated(recording, simple_robot()) is recording
    assert not is_calibrated(simple_robot())
    turned = calibrated(recording, simple_robot(pose_rotation=TURN))
    assert np.array_equal(turned.unstrained_length, recording.unstrained_length)
    assert turned.poses.position == pytest.approx(recording.poses.position @ TURN.T)


def test_relative_readings_of_calibrated_sensors_become_lengths():
    recording = full_recording()
    relative = replace(recording, metadata=replace(recording.metadata, length_kind="relative"))
    assert calibrated(relative, simple_robot(**SENSORS)).metadata.length_kind == "unstrained"
    only_turned = calibrated(relative, simple_robot(pose_rotation=TURN))
    assert only_turned.metadata.length_kind == "relative"
    only_delay = with_values(simple_robot(), ["length_delay"], np.array([0.03]))
    assert calibrated(relative, only_delay).metadata.length_kind == "relative"


def test_a_recording_of_another_robot_is_refused():
    robot = eight_cable_robot(length_offset=[0.0] * 8)
    with pytest.raises(InvalidField, match="4 cables; allowed: 8 cables"):
        calibrated(full_recording(), robot)


def test_the_readings_of_a_calibrated_robot_score_as_the_lengths_themselves():
    robot = replace(ROBOT, **SENSORS)
    models = ["straight_line", "kinematic_solver"]
    clean = validate(perfect(), ROBOT, models)
    scores = validate(misread(perfect(), robot), robot, models)
    assert scores.samples == clean.samples and scores.models.keys() == clean.models.keys()
    for name, model in scores.models.items():
        wanted = clean.models[name]
        assert model.scores.rmse == pytest.approx(wanted.scores.rmse, abs=1e-7)
        assert model.length_scores.rmse == pytest.approx(wanted.length_scores.rmse, abs=1e-10)
    uncorrected = validate(misread(perfect(), robot), ROBOT, ["kinematic_solver"])
    assert uncorrected.models["kinematic_solver"].scores.rmse[3] > 0.1


def test_a_replay_gives_lengths_commands_and_truth_in_material_and_in_w():
    recording = perfect()
    held = Stamped(time=recording.time, value=recording.unstrained_length + 0.01)
    recording, robot = replace(recording, command=held), replace(ROBOT, **SENSORS)
    clean = ReplayDriver(ROBOT, recording, ReplaySettings(suite="lengths+pose"))
    driver = ReplayDriver(robot, misread(recording, robot), ReplaySettings(suite="lengths+pose"))
    for each in (clean, driver):
        each.connect()
    nothing = Command(time=np.zeros(1), unstrained_length=np.zeros((1, 4)))
    for _ in range(5):
        result, wanted = driver.measure(), clean.measure()
        assert result.unstrained_length == pytest.approx(wanted.unstrained_length, abs=1e-13)
        assert result.pose.position == pytest.approx(wanted.pose.position, abs=1e-13)
        sent, meant = driver.command(nothing), clean.command(nothing)
        assert sent.unstrained_length == pytest.approx(meant.unstrained_length, abs=1e-13)
        assert driver.truth().position == pytest.approx(clean.truth().position, abs=1e-13)
        driver.wait(0.1)
        clean.wait(0.1)


def test_a_tilt_of_the_poses_is_taken_out_to_first_order():
    """A plumb line that measures as leaning by a little stands upright again."""
    tilt = np.array([2e-3, -1e-3])
    robot = with_values(simple_robot(), ["pose_tilt.x", "pose_tilt.y"], tilt)
    recording = full_recording(length_rate=None, command=None, exit_points=None)
    lean = np.tile([-tilt[1], tilt[0], 1.0], (30, 1))  # what stands upright in W
    poses = replace(recording.poses, position=lean)
    converted = calibrated(replace(recording, poses=poses), robot)
    assert converted.poses.position == pytest.approx(np.tile([0.0, 0.0, 1.0], (30, 1)), abs=1e-5)
