from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.drivers.sensors import SENSORS
from carosac_toolkit.loop.values import Imu, Stamped
from carosac_toolkit.recordings.metadata import RecordingMetadata
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import MEASURED_CHANNELS, Recording
from tests.recordings.synthetic import assert_same, full_recording
from tests.robots import eight_cable_robot, simple_robot

LENGTHS = np.full((4, 2), 7.0)
TIME = np.array([0.0, 0.1, 0.2, 0.4])


def test_a_slice_keeps_the_samples_of_all_channels_in_its_time():
    recording = full_recording()
    part = recording.slice(10, 30)
    np.testing.assert_array_equal(part.time, recording.time[10:30])
    first, last = part.time[0], part.time[-1]
    for name, time in recording.channel_times.items():
        kept = time[(time >= first) & (time <= last)]
        np.testing.assert_array_equal(part.channel_times[name], kept)
    rows = np.isin(recording.tension.time, part.tension.time)
    np.testing.assert_array_equal(part.tension.value, recording.tension.value[rows])
    assert_same(part.slice(), part)


def test_a_channel_without_samples_in_the_slice_is_absent():
    recording = full_recording()
    assert recording.slice(0, 2).poses is None
    assert recording.slice(0, 2).metadata is recording.metadata


@pytest.mark.parametrize(("start", "stop"), [(3, 3), (-1, 2), (0, 51), (60, None)])
def test_an_empty_slice_is_refused(start, stop):
    with pytest.raises(InvalidField, match=r"slice: got .*; allowed: 0 <= start < stop <= 50"):
        full_recording().slice(start, stop)


@pytest.mark.parametrize(
    ("channel", "value", "message"),
    [
        ("swivel_angle", np.zeros((1, 3)), r"swivel_angle.value: .* shape \(K, 2\), one column"),
        ("attitude", np.zeros((1, 3)), r"attitude.value: .*\(K, 4\), columns .*quaternion_w"),
        ("attitude", np.array([[1.0, 0.5, 0.0, 0.0]]), r"attitude.value\[0\]: got norm 1.118"),
        ("inclination", np.zeros((1, 3)), r"\(K, 2\), columns \['inclination_roll_rad'"),
    ],
)
def test_a_channel_of_another_shape_is_refused(channel, value, message):
    samples = {channel: Stamped(time=np.zeros(1), value=value)}
    with pytest.raises(InvalidField, match=message):
        Recording(time=TIME, unstrained_length=LENGTHS, **samples)


def test_measurements_hold_every_inertial_sample_once_and_no_pose():
    recording = full_recording()
    measurements = [recording.measurement(i) for i in range(len(recording.time))]
    assert all(m.pose is None for m in measurements)
    seen = np.concatenate([m.imu.time[0] for m in measurements if m.imu is not None])
    until = recording.imu.time[recording.imu.time <= recording.time[-1]]
    np.testing.assert_array_equal(seen, until)
    for i, measurement in enumerate(measurements):
        assert measurement.time[0] == recording.time[i]
        np.testing.assert_array_equal(
            measurement.unstrained_length[0], recording.unstrained_length[i]
        )


def test_a_measured_tension_comes_once_with_its_own_stamp():
    recording = full_recording()  # tensions at every third length sample
    for i in range(9):
        tension = recording.measurement(i).tension
        assert (tension is None) == (i % 3 != 0)
        if tension is not None:
            np.testing.assert_array_equal(tension.value[0], recording.tension.value[i // 3])
            assert tension.time[0] == recording.time[i]


@pytest.mark.parametrize("name", MEASURED_CHANNELS)
def test_each_sample_of_a_channel_is_measured_at_the_next_length_sample(name):
    recording = full_recording()
    channel = getattr(recording, name)
    for i in range(len(recording.time)):
        after = recording.time[i - 1] if i else -np.inf
        new = np.flatnonzero((channel.time > after) & (channel.time <= recording.time[i]))
        measured = getattr(recording.measurement(i), name)
        assert (measured is None) == (len(new) == 0)
        if measured is not None:
            np.testing.assert_array_equal(measured.value[0], channel.value[new[-1]])
            assert measured.time[0] == channel.time[new[-1]]


def test_a_recording_names_its_sensors_as_suites_do():
    assert full_recording().sensors == SENSORS
    bare = full_recording(poses=None, imu=None, tension=None, swivel_angle=None, inclination=None)
    assert bare.sensors == ("attitude",)


def test_an_index_outside_is_refused():
    with pytest.raises(InvalidField, match=r"index: got 50; allowed: 0 <= index < 50"):
        full_recording().measurement(50)


def test_duration_and_rates():
    recording = Recording(
        time=TIME,
        unstrained_length=LENGTHS,
        tension=Stamped(time=np.array([3.0]), value=np.ones((1, 2))),
    )
    assert recording.duration == pytest.approx(0.4)
    assert recording.rates["unstrained_length"] == pytest.approx(10.0)
    assert recording.rates["tension"] is None
    assert recording.n == 2


def turning_recording() -> Recording:
    """A platform that turns at a constant rate about one axis and moves on a line."""
    time = np.array([0.0, 0.2, 0.4, 2.0, 2.2])
    axis = np.array([0.6, 0.0, 0.8])
    poses = PoseSamples.from_rotation(
        time,
        np.outer(time, [1.0, 2.0, 3.0]),
        Rotation.from_rotvec(np.outer(1.3 * time, axis)).as_matrix(),
    )
    return Recording(time=TIME, unstrained_length=LENGTHS, poses=poses)


def test_interpolation_is_exact_for_a_constant_twist():
    time = np.array([0.0, 0.05, 0.2, 0.31, 2.1, 2.2])
    poses = turning_recording().pose_at(time)
    assert poses.valid.all()
    np.testing.assert_allclose(poses.pose.position, np.outer(time, [1, 2, 3]), atol=1e-14)
    wanted = Rotation.from_rotvec(np.outer(1.3 * time, [0.6, 0.0, 0.8])).as_matrix()
    np.testing.assert_allclose(poses.pose.rotation, wanted, atol=1e-14)


def test_interpolation_is_invalid_outside_and_in_long_gaps():
    time = np.array([-0.1, 0.0, 0.4, 0.5, 1.9, 2.0, 2.2, 2.3])
    poses = turning_recording().pose_at(time, gap_max=0.5)
    assert poses.valid.tolist() == [False, True, True, False, False, True, True, False]
    np.testing.assert_allclose(poses.pose.position[[0, 3, 4, 7], 0], [0.0, 0.4, 2.0, 2.2])
    assert turning_recording().pose_at(time, gap_max=2.0).valid[3:5].all()


def test_interpolation_without_poses_is_refused():
    with pytest.raises(InvalidField, match=r"poses: got None.* position_x_m.* quaternion_w"):
        Recording(time=TIME, unstrained_length=LENGTHS).pose_at([0.0])


def test_a_robot_with_other_cables_is_refused():
    recording = full_recording()
    recording.require_cables(simple_robot())
    wanted = (
        r"got 4 cables; allowed: 8 cables, as robot 'eight' has; is column 'unstrained_.*_05_m'"
    )
    with pytest.raises(InvalidField, match=wanted):
        recording.require_cables(eight_cable_robot())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"time": [0.0, 0.1, 0.1, 0.4]}, r"time\[2\]: got 0.1 s; allowed: > 0.1 s"),
        ({"time": [0.0, 0.1, np.nan, 0.4]}, r"time\[2\]: got nan; allowed: a finite number"),
        ({"time": [0.0, 0.1, 0.2]}, r"unstrained_length: got shape \(4, 2\); allowed: shape \(3,"),
        ({"unstrained_length": np.ones(4)}, r"unstrained_length: got shape \(4,\)"),
        ({"unstrained_length": np.ones((0, 2))}, r"unstrained_length: got shape \(0, 2\)"),
        ({"unstrained_length": LENGTHS - 7}, r"unstrained_length\[0, 0\]: got 0.0 m; .*'relative'"),
        (
            {"tension": Stamped(time=TIME, value=np.ones((4, 3)))},
            r"tension.value: got shape \(4, 3\); allowed: shape \(K, 2\)",
        ),
        (
            {"command": Stamped(time=TIME[::-1], value=np.ones((4, 2)))},
            r"command.time\[1\]: got 0.2 s; allowed: > 0.4 s",
        ),
        (
            {"imu": Imu(time=np.zeros(0), angular_rate=np.zeros((0, 3)),
                        specific_force=np.zeros((0, 3)))},
            r"imu.time: got shape \(0,\); allowed: .* the whole channel None",
        ),
        ({"exit_points": np.ones((3, 3))}, r"exit_points: got shape \(3, 3\)"),
    ],
)  # fmt: skip
def test_faults_name_field_value_and_what_is_allowed(changes, message):
    with pytest.raises(InvalidField, match=message):
        Recording(**({"time": TIME, "unstrained_length": LENGTHS} | changes))


def test_relative_lengths_may_have_any_sign():
    metadata = RecordingMetadata(length_kind="relative")
    assert Recording(time=TIME, unstrained_length=LENGTHS - 9, metadata=metadata).n == 2


def test_arrays_are_copies_and_read_only():
    lengths = LENGTHS.copy()
    recording = Recording(time=TIME, unstrained_length=lengths)
    lengths[:] = 0.0
    assert recording.unstrained_length[0, 0] == 7.0
    with pytest.raises(ValueError, match="read-only"):
        recording.time[0] = 1.0
