from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.base.rotations import (
    from_matrix,
    from_rotation_vector,
    roll_and_pitch,
    wrapped_angle,
)
from carosac_toolkit.loop.values import Stamped
from carosac_toolkit.physics.cable.swivel import swivel_angle
from carosac_toolkit.validation.clocks import (
    align_clocks,
    channel_clocks,
    clock_warnings,
    not_aligned,
)
from carosac_toolkit.validation.plausibility import find_misfits
from tests.validation.moving import ROBOT, moving_run

LATE = {"poses": 2.0, "tension": -1.3, "imu": 3.1}


def late(recording, offsets=LATE):
    return replace(recording, **{
        name: replace(getattr(recording, name), time=getattr(recording, name).time + offset)
        for name, offset in offsets.items()
    })  # fmt: skip


def test_three_clocks_seconds_apart_are_aligned_within_their_sigmas():
    clocks = channel_clocks(late(moving_run()), ROBOT)
    for clock in clocks:
        assert clock.shift.seconds == pytest.approx(
            LATE[clock.channel], abs=4.0 * clock.shift.sigma
        )
        assert clock.shift.sigma < 5e-3
        assert clock.is_apart()
    aligned = align_clocks(late(moving_run()), clocks)
    assert "poses +1.99" in aligned.metadata.clock_offsets
    assert aligned.poses.time == pytest.approx(moving_run().poses.time, abs=1e-3)
    assert list(clock_warnings(aligned, ROBOT)) == []


def test_the_offset_of_a_channel_does_not_depend_on_which_others_are_asked_for():
    run = late(moving_run())
    alone, last, first = (
        next(clock for clock in channel_clocks(run, ROBOT, names) if clock.channel == "imu")
        for names in (["imu"], ["poses", "imu"], ["imu", "poses"])
    )
    assert alone.shift == last.shift == first.shift


def test_an_attitude_by_the_stamps_of_the_imu_is_shifted_with_it():
    run = late(moving_run(), {"imu": 3.1})
    level = np.tile([1.0, 0.0, 0.0, 0.0], (len(run.imu.time), 1))
    for behind, left in ((0.0, ["tension", "poses"]), (0.5, ["tension", "attitude", "poses"])):
        attitude = Stamped(time=run.imu.time + behind, value=level)
        both = replace(run, attitude=attitude)
        clocks = channel_clocks(both, ROBOT, ["imu"])
        aligned = align_clocks(both, clocks)
        moved = 0.0 if behind else clocks[0].shift.seconds
        np.testing.assert_array_equal(aligned.attitude.time, attitude.time - moved)
        assert sorted(not_aligned(both, clocks)) == sorted(left)


PULLEYS = replace(ROBOT, pulley_radius=np.full(4, 0.05))


def with_angles():
    """A run with swivel angles, an AHRS and an inclinometer, of any zeros and mounting."""
    run, rng = moving_run(), np.random.default_rng(5)
    poses, n = run.poses, len(run.poses.time)
    anchors = poses.position[:, None] + ROBOT.anchor_points @ poses.rotation.swapaxes(1, 2)
    zeros = np.array([0.1, -0.2, 3.0, 0.0])
    angles = swivel_angle(PULLEYS, anchors - ROBOT.exit_points) + zeros
    angles = wrapped_angle(angles + 3e-3 * rng.standard_normal((n, 4)))
    mounted = from_rotation_vector(np.array([0.4, -0.3, 2.0]))
    noise = from_rotation_vector(5e-3 * rng.standard_normal((n, 3)))
    turned = poses.rotation @ mounted @ noise
    heading = from_rotation_vector(np.array([0.0, 0.0, 1.2]))
    return replace(
        run, swivel_angle=Stamped(time=poses.time, value=angles),
        attitude=Stamped(time=poses.time, value=from_matrix(heading @ turned)),
        inclination=Stamped(time=poses.time, value=roll_and_pitch(turned)),
    )  # fmt: skip


def test_clocks_of_angles_are_found_whatever_their_zeros_and_mounting():
    offsets = {"swivel_angle": 1.7, "attitude": -2.2, "inclination": 0.9}
    run = late(with_angles(), offsets)
    clocks = channel_clocks(run, PULLEYS, tuple(offsets))
    for clock in clocks:
        assert clock.shift.sigma < 5e-3 and clock.is_apart()
        assert clock.shift.seconds == pytest.approx(
            offsets[clock.channel], abs=4.0 * clock.shift.sigma
        )
    aligned = align_clocks(run, clocks)
    for name in offsets:
        early = getattr(aligned, name).time - getattr(with_angles(), name).time
        assert np.abs(early).max() < 5e-3


def test_without_poses_swivel_angles_are_those_of_rest():
    """The sway is not in it, and turns the platform more than its way does."""
    run = replace(late(with_angles(), {"swivel_angle": 1.7}), poses=None)
    swivels, attitude = channel_clocks(run, PULLEYS, ("swivel_angle", "attitude"))
    assert swivels.is_apart()
    assert swivels.shift.seconds == pytest.approx(1.7, abs=4.0 * swivels.shift.sigma)
    assert attitude.shift is None and attitude.reason


def test_an_ahrs_by_the_stamps_of_the_imu_keeps_them():
    """The IMU tells the clock of both better than the vertical does."""
    run = with_angles()
    run = late(replace(run, imu=replace(run.imu, time=run.attitude.time)),
               {"imu": 3.1, "attitude": 3.1})  # fmt: skip
    clocks = channel_clocks(run, PULLEYS, ("imu", "attitude"))
    aligned = align_clocks(run, clocks)
    np.testing.assert_array_equal(aligned.attitude.time, aligned.imu.time)
    assert aligned.metadata.clock_offsets.startswith("imu and attitude +3.")


def test_swivel_angles_of_a_robot_without_pulleys_tell_no_clock():
    (clock,) = channel_clocks(with_angles(), ROBOT, ("swivel_angle",))
    assert clock.shift is None and clock.reason == "the robot has no pulleys"


def test_a_delay_that_the_robot_states_is_no_offset_of_a_clock():
    delayed = replace(ROBOT, length_offset=np.zeros(4), length_scale=np.ones(4), length_delay=0.03)
    found = channel_clocks(late(moving_run(), {"poses": 0.03}), delayed, ["poses"])[0]
    assert found.shift.seconds == pytest.approx(0.0, abs=1e-3)


def test_a_clock_that_is_apart_is_one_sentence_that_names_channel_offset_and_command():
    (text,) = find_misfits(late(moving_run(), {"poses": -2.0}), ROBOT)
    assert "clock of channel poses is 2.000 s" in text and "behind that of the lengths" in text
    assert (
        "carosac import recording RECORDING --align --align-channels poses --robot carosac" in text
    )
    assert find_misfits(moving_run(), ROBOT) == ()
    assert find_misfits(late(moving_run(), {"poses": 0.05}), ROBOT) == ()  # a delay


def test_locked_winches_tell_no_offset():
    run = moving_run()
    lengths = np.broadcast_to(run.unstrained_length[:1], run.unstrained_length.shape)
    clocks = channel_clocks(replace(run, unstrained_length=lengths), ROBOT, ["poses"])
    assert clocks[0].shift is None and not clocks[0].is_apart()
    with pytest.raises(CarosacError, match="clock of channel poses cannot be aligned: the lengths"):
        align_clocks(run, clocks)


def test_the_real_run_has_one_clock_and_the_jitter_that_was_measured_on_it(real_data):
    run = ct.load_recording(real_data / "scampi_run_part.csv")
    robot = ct.load_robot("scampi")
    (clock,) = channel_clocks(run, robot)
    assert clock.shift.seconds == pytest.approx(0.034, abs=3e-3) and not clock.is_apart()
    assert clock.shift.jitter == pytest.approx(4.8e-3, abs=1e-3)
    moved = channel_clocks(late(run, {"poses": 1.8}), robot)[0].shift
    assert moved.seconds - clock.shift.seconds == pytest.approx(1.8, abs=1e-4)
