from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from calibration.commands import guide as command
from calibration.guide.samples import SampleFile
from calibration.self_calibration.motor_angle_files import load_motor_angles
from carosac_toolkit.base.errors import InvalidField, InvalidFile
from carosac_toolkit.cli.arguments import parse_options
from carosac_toolkit.robot.file import load_robot, robot_text

PROGRAM = """
import sys
from calibration.commands import guide
from carosac_toolkit.cli.arguments import parse_options
sys.exit(guide.run(parse_options(guide, "calibrate guide", sys.argv[1:])).status)
"""
START_TIMEOUT_S = 120.0


def run(*words):
    return command.run(parse_options(command, "calibrate guide", [str(word) for word in words]))


def names(path):
    return SampleFile(path, load_robot("hangprinter")).names


def test_a_person_is_guided_to_a_robot_file_and_its_verdict(tmp_path, monkeypatch, capsys):
    asked = []
    monkeypatch.setattr("builtins.input", lambda text: asked.append(text) or "")
    path, output = tmp_path / "samples.csv", tmp_path / "found.yaml"
    result = run(path, "--by-hand", "--tape", "a", "b", "--accuracy", 0.02, "--output", output)
    shown = capsys.readouterr().out
    assert result.status == 0
    assert result.data["accurate"] and result.data["verdict"]["holds"]
    assert len(asked) == result.data["samples"] - 1 + 10
    assert "m from home" in asked[0] and "Enter when it rests" in asked[0]
    assert "tape: --distance a b" in shown
    verdict, _, new_file, upright = shown.rstrip().splitlines()[-4:]
    assert "within their claim" in verdict
    assert upright.startswith("it is upright by the measured tensions")
    assert new_file == f"new robot file: {output}"
    robot, before = load_robot(str(output)), load_robot("hangprinter")
    assert np.abs(robot.exit_points - before.exit_points).max() > 0.05
    known = np.linalg.eigvalsh(robot.calibration_covariance[:12, :12])
    assert np.sqrt(known[:-3].sum() / 4) < 0.03  # but for the direction of it all
    assert load_motor_angles(path).is_known.sum() == 1
    table = shown[shown.index("tensions\n") :].split("\n* ")[0].splitlines()
    last = next(line for line in reversed(table) if line.lstrip()[:1].isdigit())
    mean, largest, median = (float(cell) for cell in last[69:94].split())
    assert median <= largest
    assert mean <= largest
    assert np.mean(list(result.data["exit_distances_m"].values())) == pytest.approx(
        result.data["exit_distance_m"]
    )
    again = run(path, "--by-hand", "--tape", "a", "b", "--accuracy", 0.02)
    assert again.data["verdict"]["holds"]
    assert len(asked) == result.data["samples"] - 1 + 10
    assert "all samples and checks are there already" in capsys.readouterr().out


def test_no_robot_file_is_written_where_the_verdict_is_negative(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("builtins.input", lambda text: "")
    monkeypatch.setattr("calibration.guide.verdict.CHANCE_MIN", 2.0)
    output = tmp_path / "found.yaml"
    words = ("--by-hand", "--max-samples", 4, "--checks", 2, "--output", output)
    assert run(tmp_path / "samples.csv", *words).status == 1
    assert not output.exists()
    assert "no new robot file is written: the verdict is negative" in capsys.readouterr().out


def test_two_processes_do_not_share_a_file(tmp_path, monkeypatch):
    path = tmp_path / "samples.csv"
    with SampleFile.held(path, load_robot("hangprinter")):
        with pytest.raises(InvalidField, match=r"SAMPLES: .* no other process collects"):
            run(path, "--by-hand")
    assert not path.exists()  # nothing was begun


def test_kill_9_in_the_middle_loses_no_sample(tmp_path):
    """A real process that moves the robot by its driver; another one goes on."""
    path = tmp_path / "samples.csv"
    words = [sys.executable, "-c", PROGRAM, str(path), "--max-samples", "7", "--checks", "2",
             "--tape", "a", "b"]  # fmt: skip
    root = str(Path(__file__).parents[3])
    environment = os.environ | {"PYTHONPATH": root}
    process = subprocess.Popen(words, env=environment, stdout=subprocess.PIPE, cwd=tmp_path)
    seen = 0
    try:
        assert process.stdout is not None
        end = time.monotonic() + START_TIMEOUT_S
        for line in process.stdout:
            seen += line.split()[:1] in ([b"home"], [b"1"], [b"2"], [b"3"])
            if seen == 4 or time.monotonic() > end:
                break
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    assert seen == 4
    kept = path.read_bytes()
    assert names(path)[:4] == ["home", "1", "2", "3"]
    again = subprocess.run(words, env=environment, capture_output=True, cwd=tmp_path, check=False)
    assert again.returncode == 1, again.stderr.decode()  # the accuracy takes more samples
    assert path.read_bytes().startswith(kept[: kept.rfind(b"\n") + 1])
    assert names(path) == ["home", *(str(k) for k in range(1, 7)), "check_1", "check_2"]
    assert b"VERDICT: the errors are within their claim" in again.stdout
    assert b"4 samples are there already" in again.stdout


@pytest.mark.slow
def test_any_driver_moves_in_real_time_behind_the_guard(tmp_path, capsys):
    """As a real robot would: the driver goes on while the host computes."""
    driver = "carosac_toolkit.drivers.quasi_static:QuasiStaticDriver"
    words = ("--driver", driver, "--enable", "--max-samples", 2, "--checks", 0)
    assert run(tmp_path / "samples.csv", *words).status == 1
    assert names(tmp_path / "samples.csv") == ["home", "1"]
    assert "simulated truth" not in capsys.readouterr().out


def test_wrong_calls_are_refused_with_the_reason(tmp_path, monkeypatch, capsys):
    path = tmp_path / "samples.csv"
    cases = [
        (("--robot", "carosac"), "drum_radius"),
        (("--driver", "ads"), "--enable: got not given"),
        (("--driver", "simulator"), "--driver: got 'simulator'; allowed: quasi_static"),
        (("--enable",), "--enable: got given; allowed: not with --driver quasi_static"),
        (("--driver", "ads", "--tape", "a", "b"), "--tape: .* with --driver quasi_static only"),
        (("--speed", "50"), r"--speed: got 50 m/s; allowed: at most .* slowest winch does"),
        (("--tape", "a", "q"), "--tape: got 'q'; allowed: one of"),
        (("--accuracy", "0"), "accuracy: got 0.0 m"),
        (("--true-robot", "carosac"), "--true-robot: got cables"),
        (("--distance", "a", "q", "1", "0.1"), "end of a distance: got 'q'"),
    ]
    for words, message in cases:
        with pytest.raises(InvalidField, match=message):
            run(path, *words)
    wide = tmp_path / "wide.yaml"
    text = robot_text("hangprinter").replace("a: [0, -0.001, 0]", "a: [0, -0.3, 0]")
    wide.write_text(text)
    with pytest.raises(InvalidField, match=r"anchor points 0.3.* m apart .* --keeps-rotation"):
        run(path, "--robot", wide)
    monkeypatch.setattr("builtins.input", lambda text: (_ for _ in ()).throw(EOFError))
    assert run(path, "--by-hand").status == 1
    assert "--by-hand: got the end of the input" in (shown := capsys.readouterr().out)
    assert "the same command goes on" in shown
    (tmp_path / "other.csv").write_text("x\n")
    with pytest.raises(InvalidFile, match="not the samples of a guided calibration"):
        run(tmp_path / "other.csv")
    assert json.dumps(names(path)) == '["home"]'
