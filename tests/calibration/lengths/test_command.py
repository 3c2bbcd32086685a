"""carosac calibrate lengths."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import carosac_toolkit as ct
from calibration.lengths.synthetic import LengthSceneSettings, draw_length_scene
from carosac_toolkit.cli.main import main


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = draw_length_scene(
        ct.load_robot("carosac"),
        np.random.default_rng(0),
        settings=LengthSceneSettings(samples=150),
    )
    path = tmp_path_factory.mktemp("lengths") / "run.csv"
    ct.save_recording(made.recording, path)
    swapped = replace(
        made.recording, unstrained_length=made.recording.unstrained_length[:, [0, 2, 1, 3]]
    )
    ct.save_recording(swapped, path.with_name("swapped.csv"))
    return path


def test_command_writes_robot_report_and_numbers(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    new, numbers = tmp_path / "new.yaml", tmp_path / "numbers.json"
    words = ["calibrate", "lengths", str(recording), "--output", str(new), "--json", str(numbers)]
    words += ["--report", str(tmp_path / "report"), "--suggest-poses", "2"]
    assert main(words) == 0
    printed = capsys.readouterr().out
    assert "lead the measured poses by" in printed and "poses to measure next" in printed
    data = json.loads(numbers.read_text())
    assert len(data["positions_m"]) == data["samples"] > 140
    assert len(data["suggested_poses"]) == 2
    assert data["residual_rms_m"] < 3e-3
    robot = ct.load_robot(new)
    found = data["parameters"]["exit_points[front_left].x"]
    assert robot.exit_points[0, 0] == pytest.approx(found["value"], abs=1e-6)
    assert robot.exit_covariance is not None and robot.calibrated is not None
    assert (tmp_path / "report" / "report.html").read_text().count("<img") == 4


def test_command_refuses_swapped_cables(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", "lengths", str(recording.with_name("swapped.csv"))]) == 2
    assert "Cables seem swapped" in capsys.readouterr().err


def test_command_says_what_to_measure_where_it_refuses(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["calibrate", "lengths", str(recording), "--stop", "8", "--suggest-poses", "3"]
    assert main(words) == 2
    printed = capsys.readouterr()
    assert "poses to measure next" in printed.out
    assert "8 poses are in one point" in printed.err or "8 poses are on one line" in printed.err


def test_command_never_writes_over_the_robot_it_read(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from carosac_toolkit.robot.file import robot_text

    old = tmp_path / "old.yaml"
    old.write_text(robot_text("carosac"))
    words = ["calibrate", "lengths", str(recording), "--robot", str(old), "--output", str(old)]
    assert main(words) == 2
    assert "--output" in capsys.readouterr().err
