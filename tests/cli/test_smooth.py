"""The command ``carosac smooth``."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.cli.main import main
from carosac_toolkit.recordings.robot import find_robot
from carosac_toolkit.robot.file import robot_text
from tests.baselines.smoother.runs import swing


@pytest.fixture(autouse=True)
def in_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def run_file(tmp_path_factory):
    """A short run of a simulated robot, as a file."""
    recording, _ = swing(ct.load_robot("carosac"), duration=1.0)
    path = tmp_path_factory.mktemp("run") / "run.parquet"
    ct.save_recording(recording, path)
    return path


def words(run_file, *more):
    return ["smooth", str(run_file), "--robot", "carosac", *more]


def test_a_mounting_needs_a_sensor_that_is_used(run_file, capsys):
    for more, said in (
        ((), "--mounting: got 0 0 1; allowed: nothing: the recording has no attitude"),
        (("--no-angles",), "--mounting: got 0 0 1; allowed: nothing with --no-angles"),
    ):
        assert main(words(run_file, "--mounting", "0", "0", "1", *more)) == 2
        assert said in capsys.readouterr().err


def test_the_contract_of_the_json_and_the_files(run_file, capsys):
    import pyarrow.parquet as pq

    files = ("--output", "new.csv", "--json", "x.json", "--report", "report")
    assert main(words(run_file, "--poses", "half", *files)) == 0
    printed = capsys.readouterr().out
    assert max(len(line) for line in printed.splitlines()) <= 80 + len(str(run_file))
    assert "poses that were not used" in printed and "settled" in printed
    data = json.loads(Path("x.json").read_text())
    assert data["converged"] and data["inertial_measurements"] > 0
    assert set(data["scores"]["all"]["rmse_m"]) == {"x", "y", "z", "norm"}
    assert {path.name for path in Path("report").iterdir()} == {
        ".carosac-results",
        "estimate.parquet",
        *(f"{name}.{end}" for name in ("estimate", "unknowns") for end in ("png", "svg", "pdf")),
    }
    before, after = ct.load_recording(run_file), ct.load_recording("new.csv")
    assert after.time == pytest.approx(before.time, abs=0.0)
    assert after.poses.time == pytest.approx(before.time, abs=0.0)
    assert after.unstrained_length == pytest.approx(before.unstrained_length, abs=0.0)
    assert "carosac smooth, poses half, of run.parquet" in after.metadata.source
    table = pq.read_table("report/estimate.parquet")
    position = np.column_stack([table[f"position_{axis}_m"] for axis in "xyz"])
    assert position == pytest.approx(after.poses.position, abs=1e-12)
    sigma = table["position_sigma_x_m"].to_numpy()
    assert sigma**2 == pytest.approx(table["covariance_01_01"].to_numpy())


def test_the_smoothed_recording_finds_its_robot_again(run_file):
    Path("rigs").mkdir()
    Path("rigs/mine.yaml").write_text(robot_text("carosac"))
    recording = replace(ct.load_recording(run_file), imu=None)
    ct.save_recording(
        replace(recording, metadata=replace(recording.metadata, robot="mine.yaml")), "rigs/a.csv"
    )
    assert main(["smooth", "rigs/a.csv", "--report", "report"]) == 0
    again = Path("report/smoothed.parquet")
    assert ct.load_recording(again).metadata.robot == "../rigs/mine.yaml"
    assert find_robot(ct.load_recording(again), again).robot.n == 4
    assert main(["smooth", "rigs/a.csv", "--report", "report", "--robot", "carosac"]) == 0
    assert ct.load_recording(again).metadata.robot == "carosac"


def test_a_robot_that_does_not_belong_to_the_recording_is_said(run_file, capsys):
    recording = replace(ct.load_recording(run_file), imu=None)
    moved = ct.load_robot("carosac").exit_points + np.array([0.02, 0.0, 0.0])
    ct.save_recording(replace(recording, exit_points=moved), "moved.parquet")
    assert main(words("moved.parquet")) == 0
    assert "Check the robot: its exit points lie up to 20 mm" in capsys.readouterr().err
    poses = replace(recording.poses, position=1e3 * recording.poses.position)
    ct.save_recording(replace(recording, poses=poses), "far.parquet")
    assert main(words("far.parquet")) == 1
    assert "Lengths and poses fit if the positions are in mm" in capsys.readouterr().err


def test_without_poses_there_are_no_scores(run_file, capsys):
    ct.save_recording(replace(ct.load_recording(run_file), poses=None, imu=None), "blind.parquet")
    assert main(words("blind.parquet", "--json", "x.json", "--length-bias", "0.001")) == 0
    data = json.loads(Path("x.json").read_text())
    assert data["scores"] is None and data["dynamics"]["length_bias"] == 0.001
    assert "not used" not in capsys.readouterr().out
    assert Path("carosac-results/smooth/blind-carosac/smoothed.parquet").is_file()


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--lag", "-1"), "lag: got -1.0 s; allowed: lag > 0"),
        (("--poses", "all"), "poses"),
        (("--wind-force", "-1"), "--wind-force: got -1.0"),
        (("--output", "nowhere/x.csv"), "a file in an existing folder"),
        (("--output", "x.txt"), "a file name ending in .parquet or .csv"),
        (("--robot", "cogiro"), "8 cables"),
        (("--start", "9", "--stop", "3"), "start, stop: got 9, 3"),
    ],
)
def test_wrong_words_end_with_one_message_and_no_file(run_file, capsys, more, message):
    assert main(words(run_file, *more)) == 2
    assert message in capsys.readouterr().err
    assert list(Path().iterdir()) == []


def test_the_recording_is_never_overwritten(run_file, capsys):
    content = run_file.read_bytes()
    assert main(words(run_file, "--output", str(run_file))) == 2
    assert "--output" in capsys.readouterr().err
    assert run_file.read_bytes() == content


@pytest.mark.parametrize("name", ["smoothed.parquet", "estimate.parquet"])
def test_nor_by_what_goes_into_the_folder(run_file, capsys, name):
    Path("run").mkdir()
    note = Path("run/.carosac-results")
    note.write_text("smooth")
    copied = Path(shutil.copy(run_file, Path("run") / name))
    content = copied.read_bytes()
    assert main(words(copied, "--report", "run")) == 2
    message = f"--report: got 'run/{name}'; allowed: another place; RECORDING is read from"
    assert message in capsys.readouterr().err
    assert copied.read_bytes() == content and set(Path("run").iterdir()) == {copied, note}


def test_nor_through_a_link(run_file, capsys):
    copied = Path(shutil.copy(run_file, "run.parquet"))
    Path("run").mkdir()
    Path("run/smoothed.parquet").symlink_to(copied.resolve())
    Path("hard").mkdir()
    Path("hard/estimate.png").hardlink_to(copied)
    for folder in ("run", "hard"):
        Path(folder, ".carosac-results").write_text("smooth")
    for folder in ("run", "hard"):
        assert main(words(copied, "--report", folder)) == 2
        assert "RECORDING is read from this file" in capsys.readouterr().err
    Path("away").symlink_to("run")
    assert main(words("run/smoothed.parquet", "--report", "away")) == 2
    assert "RECORDING is read from this file" in capsys.readouterr().err
    assert copied.read_bytes() == run_file.read_bytes()


def test_nor_by_default(run_file, capsys):
    """Smoothed twice: the folder of the second time would be that of the first."""
    folder = Path("carosac-results/smooth/smoothed-carosac")
    folder.mkdir(parents=True)
    copied = Path(shutil.copy(run_file, folder / "smoothed.parquet"))
    assert main(words(copied)) == 2
    assert "RECORDING is read from this file" in capsys.readouterr().err
    assert copied.read_bytes() == run_file.read_bytes()


def test_the_robot_is_never_overwritten(run_file, capsys):
    Path("robot.yaml").write_text(robot_text("carosac"))
    Path("report").mkdir()
    Path("report/.carosac-results").write_text("smooth")
    Path("report/estimate.parquet").symlink_to(Path("robot.yaml").resolve())
    assert main(["smooth", str(run_file), "--robot", "robot.yaml", "--report", "report"]) == 2
    assert "--robot is read from this file" in capsys.readouterr().err
    assert ct.load_robot("robot.yaml").n == 4


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--output", "report/estimate.parquet"), "--output: got 'report/estimate.parquet'"),
        (("--output", "link/estimate.parquet"), "--report writes 'report/estimate.parquet'"),
        (("--json", "report/estimate.png"), "--json: got 'report/estimate.png'"),
        (("--json", "report/smoothed.parquet"), "--report writes 'report/smoothed.parquet'"),
    ],
)
def test_nothing_is_written_twice(run_file, capsys, more, message):
    Path("report").mkdir()
    Path("link").symlink_to("report")
    assert main(words(run_file, "--report", "report", *more)) == 2
    assert message in capsys.readouterr().err
    assert list(Path("report").iterdir()) == []


def test_poses_that_are_to_be_used_must_be_there(run_file, capsys):
    ct.save_recording(replace(ct.load_recording(run_file), poses=None), "blind.parquet")
    assert main(words("blind.parquet", "--poses", "used")) == 2
    assert "poses: got none in the recording" in capsys.readouterr().err
