"""Trajectories of files: positions and times as they are there, at rest at both ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit import load_robot, save_recording
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.recordings.bundled import find_recording
from carosac_toolkit.recordings.files import load_recording
from carosac_toolkit.studies.compare.feasibility import slowest_stop
from carosac_toolkit.trajectories import build, from_file
from carosac_toolkit.trajectories.path_file import (
    departure_from_rows,
    is_path_file,
    path_digest,
)
from carosac_toolkit.trajectories.path_table import PATH_COLUMNS
from tests.robots import hanging

ROBOT = load_robot("carosac")
HEADER = ",".join(PATH_COLUMNS)


def write(path, time, position):
    rows = [",".join(map(repr, row)) for row in np.column_stack([time, position]).tolist()]
    path.write_text("\n".join([HEADER, *rows]) + "\n")
    return str(path)


def test_a_table_is_followed_at_its_own_times_with_the_speeds_it_has(tmp_path):
    truth = build("spiral", ROBOT, 3, speed_max=0.8, acceleration_max=0.7)
    time = np.linspace(0.0, truth.duration, 2000)
    name = write(tmp_path / "mine.csv", 7.0 + time, truth.sample(time).position)
    path = from_file(name, ROBOT)
    assert path.duration == pytest.approx(truth.duration)
    between = 0.5 * (time[1:] + time[:-1])
    wanted, found = truth.sample(between), path.sample(between)
    assert np.abs(found.position - wanted.position).max() < 1e-6
    assert np.abs(found.velocity - wanted.velocity).max() < 1e-3
    assert path.peak_speed == pytest.approx(truth.peak_speed, rel=1e-4)
    assert path.peak_acceleration == pytest.approx(truth.peak_acceleration, rel=1e-2)


def test_it_passes_every_row_and_rests_at_both_ends(tmp_path):
    time = np.array([0.0, 2.0, 3.5, 7.0])  # not evenly spaced
    position = ROBOT.home_position + np.array([[0, 0, 0], [0.3, 0, 0], [0.3, 0.2, 0], [0, 0, 0.1]])
    path = from_file(write(tmp_path / "few.csv", time, position), ROBOT)
    assert np.abs(path.sample(time).position - position).max() < 1e-12
    ends = path.sample([0.0, 7.0])
    assert np.abs(ends.velocity).max() < 1e-12 and np.abs(ends.acceleration).max() < 1e-11


def test_a_start_at_speed_is_an_acceleration_that_the_robot_cannot_follow(tmp_path):
    time = np.linspace(0.0, 10.0, 2001)
    position = ROBOT.home_position + np.outer(time, [0.05, 0.0, 0.0])
    path = from_file(write(tmp_path / "fast.csv", time, position), ROBOT)
    assert path.peak_acceleration > 10.0 and 0.0 < path.peak_times[1] < 10.0
    assert slowest_stop(ROBOT, path).scale < 1.0


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_a_recording_gives_the_path_of_its_poses_and_a_folder_its_only_recording(tmp_path, suffix):
    recording = load_recording(find_recording("synthetic")).slice(0, 400)
    save_recording(recording, tmp_path / f"run{suffix}")
    path = from_file(str(tmp_path / f"run{suffix}"), ROBOT)
    poses = recording.poses
    error = path.sample(poses.time - poses.time[0]).position - poses.position
    assert np.sqrt(np.mean(error**2)) < 0.02
    alone = from_file(str(tmp_path), ROBOT)
    assert alone.duration == path.duration
    save_recording(recording, tmp_path / "more.csv")
    with pytest.raises(CarosacError, match=r"recordings: got more.csv, run.*; allowed: one in a"):
        from_file(str(tmp_path), ROBOT)


def test_lengths_alone_give_the_path_of_the_equilibria(tmp_path):
    recording = load_recording(find_recording("synthetic")).slice(0, 200)
    save_recording(replace(recording, poses=None), tmp_path / "run.csv")
    start = from_file(str(tmp_path / "run.csv"), ROBOT).sample([0.0]).position[0]
    assert start == pytest.approx(recording.poses.position[0], abs=0.05)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty"),
        (HEADER, "got 0 rows; allowed: 2 or more"),
        (f"{HEADER}\n0,0,0,2\n", "got 1 rows; allowed: 2 or more"),
        ("time_s,position_x_m,position_y_m\n0,0,0\n", "column 'position_z_m' is missing"),
        (f"{HEADER},speed\n0,0,0,2,1\n", "column 'speed': allowed: time_s, position_x_m, "),
        (f"{HEADER}\n0,0,0,2\n1,nan,0,2\n",
         "line 3, column 'position_x_m': got nan; allowed: a finite number"),
        (f"{HEADER}\n0,0,0,2\n1,0,,2\n",
         "line 3, column 'position_y_m': got nothing; allowed: a finite number"),
        (f"{HEADER}\n0,0,0,2\n1,0,0,high\n",
         "line 3, column 'position_z_m': got 'high'; allowed: a number"),
        (f"{HEADER}\n0,0,0,2\n2,0,0,2\n2,0,0,2.1\n",
         "line 4, column 'time_s': got 2 after 2; allowed: rising times"),
        ("0,0,0,2\n1,0,0,2\n", "the first line must name the columns: got '0,0,0,2'; allowed: "
         "time_s,position_x_m,position_y_m,position_z_m for a path, time_s,cable_length_1_m"),
        (HEADER.replace(",", ";") + "\n0;0;0;2\n", "is the separator ';'?"),
    ],
)  # fmt: skip
def test_a_bad_table_is_one_message(tmp_path, text, message):
    (tmp_path / "bad.csv").write_text(text)
    with pytest.raises(CarosacError) as caught:
        from_file(str(tmp_path / "bad.csv"), ROBOT)
    assert message in str(caught.value)


def test_a_path_that_leaves_the_box_is_refused_with_place_and_time(tmp_path):
    high = ROBOT.home_position + np.array([[0, 0, 0], [0, 0, 9.0], [0, 0, 0]])
    name = write(tmp_path / "high.csv", [0.0, 2.0, 4.0], high)
    expected = r"high.csv: line 3, column 'position_z_m': got 11.* m; .* the box of 'carosac'$"
    with pytest.raises(InvalidField, match=expected):
        from_file(name, ROBOT)
    low, top = ROBOT.workspace_min, ROBOT.workspace_max
    round_trip = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]) * (top - low)[:2] + low[:2]
    time = np.linspace(0.0, 8.0, 41)  # dense rows at the edge of the box, which a spline leaves
    edge = np.column_stack([np.interp(time, np.arange(0.0, 9.0, 2.0), x) for x in round_trip.T])
    name = write(tmp_path / "edge.csv", time, np.column_stack([edge, np.full(41, low[2])]))
    with pytest.raises(InvalidField, match=r"edge.csv: x at .* s, between lines \d+ and \d+: got"):
        from_file(name, ROBOT)


@pytest.mark.parametrize(
    ("box_min", "end", "factor", "units"),
    [
        ((-1.6, -3.8, 1.0), 0.1, 1e3, "mm"),
        ((-1.6, -3.8, 1.0), 0.1, 1e2, "cm"),
        ((-1.6, -3.8, 0.0), 0.1, 1e2, "mm or cm"),  # both lie in a box that has the origin in it
        ((-1.6, -3.8, 1.0), 99.0, 1e3, "mm or cm"),  # neither does
    ],
)
def test_positions_in_another_unit_are_asked_about_with_their_row(
    tmp_path, box_min, end, factor, units
):
    rows = factor * (ROBOT.home_position + np.array([[0, 0, 0], [end, 0, 0]]))
    name = write(tmp_path / "far.csv", [0.0, 2.0], rows)
    robot = replace(ROBOT, workspace_min=np.array(box_min))
    message = rf"far.csv: line 2, column .* are the positions in {units}\?"
    with pytest.raises(InvalidField, match=message):
        from_file(name, robot)


def test_a_path_that_curves_between_rows_is_told_and_a_straight_one_is_not(tmp_path):
    corners = ROBOT.home_position + np.array([[0.5, 0, 0], [0, 0.5, 0], [-0.5, 0, 0]])
    text = departure_from_rows(write(tmp_path / "turned.csv", [0.0, 2.0, 4.0], corners))
    assert text.startswith("turned.csv: between lines ") and "% of the size" in text
    straight = ROBOT.home_position + np.array([[0.5, 0, 0], [0, 0, 0], [-0.5, 0, 0]])
    assert departure_from_rows(write(tmp_path / "line.csv", [0.0, 2.0, 3.0], straight)) is None
    assert departure_from_rows("circle") is None and departure_from_rows("synthetic") is None


def test_files_are_told_from_names_and_by_their_content(tmp_path):
    assert not is_path_file("circle") and not is_path_file("my.module")
    assert is_path_file("mine.csv") and is_path_file("runs/x") and is_path_file("synthetic")
    one = write(tmp_path / "a.csv", [0.0, 1.0], np.zeros((2, 3)))
    other = write(tmp_path / "b.csv", [0.0, 2.0], np.zeros((2, 3)))
    assert path_digest(one) != path_digest(other) and path_digest("circle") is None
    with pytest.raises(CarosacError, match="no such file"):
        from_file(str(tmp_path / "none.csv"), ROBOT)


def test_a_path_of_two_cables_is_moved_to_where_they_let_the_platform_rest(tmp_path):
    time = np.linspace(0.0, 4.0, 5)
    position = np.array([[0.0, 0.1, 2.0]]) + 0.1 * np.arange(5)[:, None] * [1.0, 0.5, 1.0]
    name = write(tmp_path / "path.csv", time, position)
    path = from_file(name, hanging(2))
    where = path.sample(time).position
    np.testing.assert_allclose(where, position * [1.0, 0.0, 1.0], atol=1e-9)
    assert path.moved == pytest.approx(0.3, abs=1e-6)
    assert from_file(name, hanging(3)).moved == 0.0
