"""One robot from many short free oscillations, each with a start of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.calibration_oscillations import SURVEYED, draw_plant, robot_with_pulleys, score
from calibration.identification.measured_poses import poses_of
from calibration.identification.open_loop import OpenLoopRun, simulate, simulate_runs
from calibration.identification.procedure import identify_runs
from calibration.identification.synthetic_oscillations import (
    OscillationSettings,
    simulate_oscillations,
)
from calibration.observability import Unobservable
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.recordings.length_path import LengthPath
from carosac_toolkit.validation.first_motion import first_speed

SHORT = OscillationSettings(count=12, duration=4.0, rate=50.0)
FEW = replace(
    SURVEYED, exit_points=0.0, anchor_points=0.0, length_offset=0.0, mass=0.0, linear_density=0.0,
    axial_stiffness=0.0, axial_damping=0.0, run_length=0.0, exit_friction=0.0, pose_tilt=0.0,
    rate=8.0,
)  # fmt: skip  # what remains: centre of mass, inertia, both drags, dry friction at the anchors


@pytest.fixture(scope="module")
def robot():
    return robot_with_pulleys(3)


@pytest.fixture(scope="module")
def plant(robot):
    return draw_plant(robot, FEW, 1)


@pytest.fixture(scope="module")
def recordings(plant):
    return simulate_oscillations(plant, 1, SHORT)


@pytest.fixture(scope="module")
def found(robot, recordings):
    return identify_runs(recordings[:10], robot, FEW, held_out=recordings[10:])


def test_oscillations_begin_in_motion_with_locked_winches(robot, recordings):
    for recording in recordings:
        assert np.ptp(recording.unstrained_length, axis=0).max() < 1e-3
        poses = poses_of(recording)
        assert first_speed(
            robot, recording.time, recording.unstrained_length, poses.time, poses.position,
            poses.rotation,
        ).moves  # fmt: skip


def test_the_robot_is_found_and_its_frequencies_within_half_a_percent(found, plant, recordings):
    assert found.warnings == () and all(run.first_motion.moves for run in found.runs)
    scores = score(found, plant, recordings)
    assert scores.frequency < 5e-3
    assert scores.center < 2e-3
    assert scores.friction < 0.2
    assert scores.nees < 4.0  # sigmas here are a thousandth of the values


def test_each_recording_can_be_held_out_of_the_fit(found):
    """The estimate is where the parabolas of all of them are least, and it costs to leave one."""
    folds = found.folds
    assert len(folds.parts) == 10
    information = sum(part.information for part in [folds.known, *folds.parts])
    pull = sum(part.gradient for part in [folds.known, *folds.parts])
    assert pull @ np.linalg.solve(information, pull) < 0.1 * len(pull)
    held_out = folds.held_out(np.zeros(len(pull), dtype=bool))
    assert (held_out > [part.cost for part in folds.parts]).mean() > 0.8


def test_recordings_that_were_held_out_are_predicted_to_the_noise_of_their_poses(found):
    kept = [run for run in found.runs if run.train is None]
    assert [run.name for run in kept] == ["recording 11", "recording 12"]
    assert found.test.runs == 2 and found.train.runs == 10
    assert found.test.after.rmse[3] < 1.3 * np.sqrt(3.0) * 1e-3
    assert found.test.after.rmse[3] < 0.5 * found.test.before.rmse[3]


def test_numbers_of_each_recording_are_in_the_json(found):
    data = found.data()
    assert [each["name"] for each in data["recordings"]] == [run.name for run in found.runs]
    assert data["recordings"][10]["train"] is None
    assert data["recordings"][10]["test"]["rmse_m"]["norm"] < 3e-3
    assert any("10 recordings (fitted)" in line for line in found.sentences())
    assert data["mixed"] == [] and not any("beside the sway" in line for line in found.sentences())
    mixed = replace(found, mixed=("recording 2",))
    assert any("sway: in recording 2 they are less than" in line for line in mixed.sentences())


def test_runs_together_move_as_each_alone(robot, recordings):
    """Also where they are sampled otherwise and last for another time."""
    times = [np.arange(0.0, 2.0, 0.1), np.arange(0.0, 1.5, 0.1), np.arange(0.0, 1.0, 0.07)]
    paths = [LengthPath(each) for each in recordings[:3]]
    runs = [
        OpenLoopRun(robots=[robot], path=path, time=time)
        for path, time in zip(paths, times, strict=True)
    ]
    together = simulate_runs(runs, time_step=0.01)
    for run, motion in zip(runs, together, strict=True):
        alone = simulate(run.robots, run.path, run.time, time_step=0.01)
        assert motion.position == pytest.approx(alone.position, abs=1e-12)
        assert motion.rotation == pytest.approx(alone.rotation, abs=1e-12)


def test_nothing_to_fit_is_refused(robot, recordings):
    with pytest.raises(InvalidField, match="recordings: got none; allowed: at least one"):
        identify_runs([], robot, FEW, held_out=recordings)


def test_motion_counts_over_all_recordings(robot, recordings):
    short = [each.slice(0, 100) for each in recordings]  # 2 s each: too short alone
    with pytest.raises(InvalidField, match="with measured poses"):
        identify_runs(short[:1], robot, FEW)
    still = [
        replace(
            each,
            poses=replace(
                each.poses,
                position=np.tile(each.poses.position[:1], (len(each.poses.time), 1)),
                quaternion=np.tile(each.poses.quaternion[:1], (len(each.poses.time), 1)),
            ),
        )
        for each in recordings[:3]
    ]
    with pytest.raises(Unobservable, match="a platform at rest does not show its dynamics"):
        identify_runs(still, robot, FEW)


def test_a_recording_that_was_left_out_is_not_the_worst(found):
    worst = found.runs[found.worst].name
    assert any(f"at worst ({worst})" in line for line in found.sentences())
    without = replace(found, unfollowed=(worst,))
    assert not any(f"at worst ({worst})" in line for line in without.sentences())
