from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.loop.values import Stamped
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
