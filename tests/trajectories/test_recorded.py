from __future__ import annotations

import numpy as np
import pytest

from carosac_toolkit import load_recording, load_robot
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.values import Stamped
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.trajectories import from_recording, line, minimum_snap
from tests.trajectories.samples import POINTS


def recorded(noise: float = 0.0, gap: tuple[float, float] = (0.0, 0.0)) -> Recording:
    """A minimum-snap run, measured at 20 Hz from time 5 s on, with noise [m] and a gap [s]."""
    truth = minimum_snap(POINTS, speed_max=0.5, acceleration_max=0.5)
    time = np.arange(0.0, truth.duration, 0.05)
    time = time[(time < gap[0]) | (time >= gap[1])]
    rng = np.random.default_rng(0)
    position = truth.sample(time).position + noise * rng.normal(size=(len(time), 3))
    quaternion = np.tile([1.0, 0, 0, 0], (len(time), 1))
    poses = PoseSamples(time=5.0 + time, position=position, quaternion=quaternion)
    return Recording(time=5.0 + time, unstrained_length=np.ones((len(time), 4)), poses=poses)


def error(recording: Recording, truth: Recording) -> np.ndarray:
    trajectory = from_recording(recording)
    return trajectory.sample(truth.poses.time - 5.0).position - truth.poses.position


def test_clean_poses_are_followed_and_noisy_ones_smoothed():
    truth = recorded()
    assert np.abs(error(truth, truth)).max() < 1e-3
    rms = np.sqrt(np.mean(error(recorded(noise=0.02), truth) ** 2))
    assert rms < 0.5 * 0.02  # ten samples for every knot


def test_a_gap_is_bridged():
    truth = recorded()
    assert np.abs(error(recorded(gap=(3.0, 5.0)), truth)).max() < 0.1


def test_it_starts_at_the_first_pose_at_rest_up_to_the_jerk():
    recording = recorded()
    trajectory = from_recording(recording)
    last = recording.poses.time[-1] - recording.poses.time[0]
    assert trajectory.duration == pytest.approx(last)
    s = trajectory.sample([0.0, trajectory.duration])
    for part in (s.velocity, s.acceleration, s.jerk):
        assert np.abs(part).max() < 1e-8


def test_limits_slow_it_down_only_where_they_must():
    recording = recorded()
    free = from_recording(recording)
    assert from_recording(recording, speed_max=9.0).duration == free.duration
    slow = from_recording(recording, speed_max=free.peak_speed / 2)
    assert slow.duration == pytest.approx(2 * free.duration)
    s = slow.sample(np.linspace(0, slow.duration, 20001))
    assert np.linalg.norm(s.velocity, axis=1).max() <= free.peak_speed / 2
    gentle = from_recording(recording, acceleration_max=free.peak_acceleration / 4)
    assert gentle.duration == pytest.approx(2 * free.duration)


def test_derivatives_agree_with_finite_differences():
    trajectory = from_recording(recorded(noise=0.01))
    time = np.linspace(0.1, trajectory.duration - 0.1, 300)
    h = 1e-4
    before, now, after = (trajectory.sample(time + s) for s in (-h, 0.0, h))
    np.testing.assert_allclose(
        (after.position - before.position) / (2 * h), now.velocity, atol=1e-6
    )
    np.testing.assert_allclose(
        (after.velocity - before.velocity) / (2 * h), now.acceleration, atol=1e-5
    )


def test_two_poses_are_enough():
    trajectory = from_recording(recorded().slice(0, 2))
    np.testing.assert_allclose(trajectory.sample([0.0]).position[0], POINTS[0], atol=1e-3)


def test_bad_arguments_are_refused():
    with pytest.raises(InvalidField, match=r"poses: got None; allowed: a recording with measured"):
        from_recording(Recording(time=[0.0], unstrained_length=[[1.0]]))
    with pytest.raises(InvalidField, match=r"poses: got 1 pose; allowed: at least 2 poses"):
        from_recording(recorded().slice(0, 1))
    one = Recording(time=[0.0], unstrained_length=np.full((1, 4), 9.0))
    with pytest.raises(InvalidField, match=r"poses: got 1 pose; allowed: at least 2 poses"):
        from_recording(one, load_robot("carosac"))
    with pytest.raises(InvalidField, match=r"knot_spacing: got 0.0 s; allowed: knot_spacing > 0"):
        from_recording(recorded(), knot_spacing=0.0)
    with pytest.raises(InvalidField, match=r"speed_max: got 0.0 m/s"):
        from_recording(recorded(), speed_max=0.0)


def test_without_poses_those_of_rest_on_the_lengths_sent_are_followed():
    robot = load_robot("carosac")
    truth = line(
        robot.home_position, robot.home_position + 0.5, speed_max=0.5, acceleration_max=0.5
    )
    time = np.arange(0.0, truth.duration, 0.02)
    asked = truth.sample(time).position
    lengths = statics.inverse_kinematics(robot, asked).unstrained_length
    run = Recording(
        time=3.0 + time,
        unstrained_length=lengths + 0.05,  # misread: what was sent counts
        command=Stamped(time=3.1 + time, value=lengths),  # and when
    )
    result = from_recording(run, robot, knot_spacing=0.25).sample(0.1 + time).position
    assert np.abs(result - asked).max() < 2e-3


def test_the_real_run_is_followed_to_millimetres(real_data):
    run = load_recording(real_data / "scampi_run_part.csv")
    trajectory = from_recording(run)
    result = trajectory.sample(run.poses.time - run.poses.time[0]).position
    rms = np.sqrt(np.mean((result - run.poses.position) ** 2, axis=0))
    assert rms.max() < 0.005  # the samples are 0.256 s apart, the sway has 2 s
    assert 0.5 < trajectory.peak_speed < 1.2
