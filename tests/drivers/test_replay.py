from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit.base.errors import CarosacError, InvalidField, MissingFile
from carosac_toolkit.drivers.replay import ReplayDriver, ReplaySettings
from carosac_toolkit.loop.protocols import TruthSource, replays
from carosac_toolkit.loop.values import Command
from tests.recordings.synthetic import full_recording
from tests.robots import eight_cable_robot, simple_robot

SOMETHING = Command(time=np.zeros(1), unstrained_length=np.full((1, 4), 3.0))


@pytest.fixture
def recording():
    return full_recording()


def connected(recording, **settings):
    driver = ReplayDriver(simple_robot(), recording, ReplaySettings(**settings))
    driver.connect()
    return driver


def every_sample(driver):
    """Measurement, returned command and truth, sample by sample."""
    entries = []
    while True:
        entries.append((driver.measure(), driver.command(SOMETHING), driver.truth()))
        if not driver.wait(123.0):  # however long a cycle is
            return entries


def test_it_steps_sample_by_sample_to_the_end(recording):
    result = every_sample(connected(recording))
    time = np.concatenate([measurement.time for measurement, _, _ in result])
    lengths = np.concatenate([measurement.unstrained_length for measurement, _, _ in result])
    assert np.array_equal(time, recording.time)
    assert np.array_equal(lengths, recording.unstrained_length)


def test_after_the_end_it_stays_at_the_last_sample(recording):
    driver = connected(recording)
    every_sample(driver)
    assert driver.wait(0.1) is False
    assert driver.measure().time[0] == recording.time[-1]


def test_it_returns_the_recorded_command_that_held_at_each_sample(recording):
    for measurement, command, _ in every_sample(connected(recording)):
        earlier = np.flatnonzero(recording.command.time <= measurement.time[0])
        held = recording.command.value[earlier[-1] if len(earlier) else 0]
        assert np.array_equal(command.unstrained_length[0], held)
        assert np.array_equal(command.time, measurement.time)
        assert command.limited == ()


def test_without_recorded_commands_it_returns_the_lengths(recording):
    driver = connected(replace(recording, command=None))
    for measurement, command, _ in every_sample(driver):
        assert np.array_equal(command.unstrained_length, measurement.unstrained_length)


def test_truth_is_the_motion_capture_where_there_is_any(recording):
    driver = connected(recording)
    known = 0
    for measurement, _, truth in every_sample(driver):
        pose = recording.pose_at(measurement.time)
        assert (truth is not None) == pose.valid[0]
        if truth is not None:
            known += 1
            assert truth.position == pytest.approx(pose.pose.position)
            assert truth.rotation == pytest.approx(pose.pose.rotation)
    assert 0 < known < len(recording.time)
    assert isinstance(driver, TruthSource)


def test_a_recording_without_poses_knows_no_truth(recording):
    assert connected(replace(recording, poses=None)).truth() is None


@pytest.mark.parametrize("suite", ["lengths", "lengths+imu", "lengths+pose", "lengths+imu+pose"])
def test_poses_and_inertial_samples_are_withheld_unless_the_suite_has_them(recording, suite):
    entries = [measurement for measurement, _, _ in every_sample(connected(recording, suite=suite))]
    assert any(m.pose is not None for m in entries) == ("pose" in suite)
    assert any(m.imu is not None for m in entries) == ("imu" in suite)
    assert any(m.tension is not None for m in entries)
    if "pose" in suite:
        for m in entries:
            pose = recording.pose_at(m.time)
            assert (m.pose is not None) == pose.valid[0]


@pytest.mark.parametrize(
    ("sensor", "channel"),
    [
        ("tension", "tension"), ("swivel", "swivel_angle"), ("attitude", "attitude"),
        ("inclination", "inclination"),
    ],
)  # fmt: skip
def test_a_suite_needs_its_sensors_in_the_recording(recording, sensor, channel):
    entries = every_sample(connected(recording, suite=f"lengths+{sensor}"))
    assert any(getattr(measurement, channel) is not None for measurement, _, _ in entries)
    with pytest.raises(InvalidField, match=f"one without {sensor}: the recording has none"):
        connected(replace(recording, **{channel: None}), suite=f"lengths+{sensor}")


def test_by_default_poses_are_withheld(recording):
    entries = [measurement for measurement, _, _ in every_sample(connected(recording))]
    assert not any(m.pose is not None for m in entries)
    assert any(m.imu is not None for m in entries)


def test_what_a_recording_does_not_have_is_not_in_its_suite(recording):
    bare = replace(recording, imu=None, poses=None)
    assert connected(bare).measure().imu is None
    for suite, sensor in (("lengths+imu", "imu"), ("lengths+pose", "pose")):
        with pytest.raises(InvalidField, match=f"suite.*without {sensor}: the recording has none"):
            connected(bare, suite=suite)


def test_commands_change_nothing_and_it_says_so(recording):
    driver = connected(recording)
    assert replays(driver)
    one = driver.command(SOMETHING)
    other = driver.command(replace(SOMETHING, unstrained_length=np.full((1, 4), 9.0)))
    assert np.array_equal(one.unstrained_length, other.unstrained_length)


def test_a_command_of_other_cables_is_refused(recording):
    wide = Command(time=np.zeros(1), unstrained_length=np.ones((1, 5)))
    message = r"unstrained_length: got shape \(1, 5\); allowed: shape \(1, 4\)"
    with pytest.raises(InvalidField, match=message):
        connected(recording).command(wide)


def test_the_bundled_recording_is_found_by_name():
    driver = ReplayDriver.build(simple_robot())
    driver.connect()
    assert driver.measure().unstrained_length.shape == (1, 4)
    assert driver.truth() is not None


def test_a_recording_of_another_robot_is_refused():
    with pytest.raises(InvalidField, match="4 cables; allowed: 8 cables"):
        ReplayDriver.build(eight_cable_robot())


def test_what_is_not_there_is_named():
    with pytest.raises(InvalidField, match=r"recording: got 'synthetik'.*did you mean 'synthetic'"):
        ReplayDriver.build(simple_robot(), ReplaySettings(recording="synthetik"))
    with pytest.raises(MissingFile):
        ReplayDriver.build(simple_robot(), ReplaySettings(recording="no/such.parquet"))
    with pytest.raises(InvalidField, match="suite: got 'mocap'"):
        ReplaySettings(suite="mocap")


def test_nothing_works_without_a_connection(recording):
    driver = ReplayDriver(simple_robot(), recording, ReplaySettings())
    for call in (
        driver.measure, driver.truth, lambda: driver.wait(0.1), lambda: driver.command(SOMETHING)
    ):  # fmt: skip
        with pytest.raises(CarosacError, match="replay: not connected; call connect"):
            call()
    driver.stop("test")
    driver.close()
