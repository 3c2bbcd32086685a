"""The command ``carosac identify``."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

import carosac_toolkit as ct
from calibration.commands import identify
from calibration.identification.result import MeanPoseComparison
from calibration.identification.settings import CANDIDATE_SIGMAS, IdentificationSettings
from calibration.identification.synthetic import RunSettings, simulate_run
from carosac_toolkit.cli.main import main
from carosac_toolkit.pictures.saving import PICTURE_FORMATS
from carosac_toolkit.robot.file import robot_text


@pytest.fixture(autouse=True)
def in_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def run_file(tmp_path_factory):
    """A short run of a simulated robot, as a file."""
    settings = RunSettings(moves=4, rate=10.0, condition="none")
    run = simulate_run(ct.load_robot("carosac"), 1, settings)
    path = tmp_path_factory.mktemp("run") / "run.parquet"
    ct.save_recording(run.recording, path)
    return path


def words(run_file, *more):
    return ["identify", str(run_file), "--robot", "carosac", "--train", "0:80", *more]


def test_the_contract_of_the_json_and_the_files(run_file, capsys):
    files = ("--output", "new.yaml", "--json", "x.json", "--report", "report")
    status = main(words(run_file, "--test", "80:100", *files))
    printed = capsys.readouterr().out
    data = json.loads(Path("x.json").read_text())
    assert set(data["train"]["rmse_m"]) == set(data["test"]["rmse_m"]) == {"x", "y", "z", "norm"}
    assert data["test"]["start"] == 80 and data["test"]["stop"] == 100
    assert data["parameters"]["center_of_mass.x"]["unit"] == "m"
    assert status in (0, 1) and status == (0 if data["converged"] else 1)
    assert "samples 80:100 (kept back)" in printed
    assert max(len(line) for line in printed.splitlines()) <= 80 + len(str(run_file))
    robot = ct.load_robot("new.yaml")
    assert robot.calibrated is not None and "length_delay" in robot.calibrated
    assert "carosac identify, samples 0:80 of run.parquet" in Path("new.yaml").read_text()
    found = {path.name for path in Path("report").glob("[!.]*")}
    pictures = {f"{x}.{end}" for x in ("motion", "rests", "learnt") for end in PICTURE_FORMATS}
    assert found == {"report.html", *pictures}


def test_a_robot_of_no_use_is_not_written(run_file, capsys, monkeypatch):
    monkeypatch.setattr(MeanPoseComparison, "useless", True)
    assert main(words(run_file, "--test", "80:100", "--output", "new.yaml")) == 1
    captured = capsys.readouterr()
    assert "no robot file was written: new.yaml would be of no use" in captured.out
    assert "the identified robot is of no use: in samples 80:100" in captured.err
    assert not Path("new.yaml").exists()


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--train", "a:b"), "--train: got 'a:b'; allowed: START:STOP, such as 0:400"),
        (("--train", "5:2"), "train: got 5:2; allowed: START:STOP with 0 <= START < STOP"),
        (("--test", "70:90"), "test: got 70:90; allowed: samples outside of train = 0:80"),
        (("--output", "nowhere/x.yaml"), "a file in an existing folder"),
        (("--output", "x.txt"), "a file name ending in .yaml or .yml"),
        (("--robot", "cogiro"), "8 cables"),
        (("--frequencies", "nowhere.csv"), "nowhere.csv: no such file"),
        (("--free", "drag"), "--free: got 'drag'; allowed: one or more of inertia_products"),
        (("--free",), "--free: got nothing; allowed: one or more of inertia_products"),
        (("--free", "cable_drag", "--candidates", "cable_drag"), "not among --candidates"),
    ],
)
def test_wrong_words_end_with_one_message_and_no_file(run_file, capsys, more, message):
    assert main(words(run_file, *more)) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") <= 2
    assert list(Path().iterdir()) == []


def test_candidates_without_names_are_all_that_are_fitted_only_on_request():
    settings, tried = identify._freed(identify.Options(recordings=("x",), candidates=()))
    assert set(tried) == set(CANDIDATE_SIGMAS) and settings == IdentificationSettings()
    assert identify._freed(identify.Options(recordings=("x",)))[1] == ()


def test_what_is_freed_is_fitted_by_its_usual_sigma():
    options = identify.Options(recordings=("x",), free=("capstan_friction",))
    settings, tried = identify._freed(options)
    assert settings.capstan_friction == CANDIDATE_SIGMAS["capstan_friction"] and tried == ()
    _, others = identify._freed(replace(options, candidates=()))
    assert set(others) == set(CANDIDATE_SIGMAS) - {"capstan_friction"}


def test_the_robot_file_is_never_overwritten(run_file, capsys):
    Path("mine.yaml").write_text(robot_text("carosac"))
    assert main(words(run_file, "--robot", "mine.yaml", "--output", "mine.yaml")) == 2
    assert "mine.yaml" in capsys.readouterr().err
    assert Path("mine.yaml").read_text() == robot_text("carosac")


def test_a_recording_without_poses_is_refused(run_file, capsys):
    ct.save_recording(replace(ct.load_recording(run_file), poses=None), "blind.parquet")
    assert main(words("blind.parquet")) == 2
    assert "poses" in capsys.readouterr().err


def test_several_recordings_are_fitted_together_and_others_scored(run_file, tmp_path, capsys):
    recording = ct.load_recording(run_file)
    for k, (start, stop) in enumerate(((0, 60), (40, 100), (20, 80))):
        ct.save_recording(recording.slice(start, stop), f"part{k}.parquet")
    robot = ct.load_robot("carosac")
    lengths = ct.statics.inverse_kinematics(robot, robot.home_position[None]).unstrained_length[0]
    head = [f"unstrained_length_{k:02d}_m" for k in range(1, 5)]
    Path("sway.csv").write_text(
        ",".join([*head, "frequency_Hz", "sigma_Hz", "mode"])
        + "\n" + ",".join([*map(str, lengths), "0.45", "0.01", "1"]) + "\n"
    )  # fmt: skip
    words = ["identify", "part0.parquet", "part1.parquet", "--held-out", "part2.parquet"]
    words += ["--frequencies", "sway.csv"]
    status = main([*words, "--robot", "carosac", "--json", "x.json", "--report", "report"])
    printed = capsys.readouterr().out
    data = json.loads(Path("x.json").read_text())
    assert status in (0, 1)
    assert data["recording"] == ["part0.parquet", "part1.parquet", "part2.parquet"]
    assert data["train"]["recordings"] == 2 and data["test"]["start"] == 0
    assert [each["train"] is None for each in data["recordings"]] == [False, False, True]
    assert "2 recordings (fitted)" in printed
    assert data["effects"]["rms_m"] > 0.0 and not data["effects_reason"]
    assert "identified robot looks like, as shares" in " ".join(printed.split())
    assert "1 measured frequency: off by" in printed
    assert data["frequencies"]["measured_Hz"] == [0.45]
    page = Path("report/report.html").read_text()
    assert "Natural frequencies" in page and "--frequencies sway.csv" in page
    assert Path("report/recordings.png").is_file()


def test_of_too_few_poses_it_is_said_that_effects_cannot_be_told(run_file, capsys):
    ct.save_recording(ct.load_recording(run_file).slice(0, 100), "short.parquet")
    words = ["identify", "short.parquet", "--robot", "carosac", "--json", "x.json"]
    assert main([*words, "--report", "report"]) in (0, 1)
    printed = " ".join(capsys.readouterr().out.split())
    data = json.loads(Path("x.json").read_text())
    assert data["effects"] is None and "over 15 s" in data["effects_reason"]
    assert "looks like cannot be told: samples: got" in printed
    assert "cannot be told: samples: got" in Path("report/report.html").read_text()


def test_ranges_beside_several_recordings_and_one_given_twice_are_refused(run_file, capsys):
    ct.save_recording(ct.load_recording(run_file), "other.parquet")
    assert main(words(run_file, "--held-out", "other.parquet")) == 2
    assert "only with one recording" in capsys.readouterr().err
    assert main(["identify", str(run_file), str(run_file), "--robot", "carosac"]) == 2
    assert "each recording once" in capsys.readouterr().err
