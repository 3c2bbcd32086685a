"""`carosac train` and `carosac evaluate`, as a user runs them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from carosac_toolkit.cli.main import main
from learned import training_study
from learned.commands.train import _report
from learned.learning_curve import CURVE_COLUMNS
from learned.policy_file import Policy


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A policy that has hardly learned anything, in both stages."""
    folder = tmp_path_factory.mktemp("train")
    status = main(["train", "--steps", "700", "--output", str(folder / "out"),
                   "--json", str(folder / "train.json")])  # fmt: skip
    assert status == 0
    return folder


def test_both_stages_leave_a_policy_and_a_curve(trained):
    data = json.loads((trained / "train.json").read_text())
    assert list(data["stages"]) == ["no_sag", "sag"]
    for name in data["stages"]:
        files = {path.name for path in (trained / "out" / name).iterdir()}
        assert {
            "settings.json",
            "curve.csv",
            "episodes.csv",
            "checkpoint.safetensors",
            "policy.onnx",
        } <= files
    settings = json.loads((trained / "out" / "sag" / "settings.json").read_text())
    assert settings["environment"]["world"] == "settle"
    assert settings["td3"]["steps"] == 700
    assert settings["started_from"]["checkpoint"] == "no_sag/checkpoint.safetensors"
    assert settings["started_from"]["steps"] >= 700


def test_the_same_command_again_has_nothing_to_do(trained, capsys):
    before = (trained / "out" / "no_sag" / "curve.csv").read_text()
    assert main(["train", "--steps", "700", "--output", str(trained / "out")]) == 0
    assert (trained / "out" / "no_sag" / "curve.csv").read_text() == before


def test_a_later_stage_of_another_seed_is_refused(trained, tmp_path, capsys):
    shutil.copytree(trained / "out" / "no_sag", tmp_path / "no_sag")
    words = ["train", "--steps", "700", "--stage", "sag", "--output", str(tmp_path)]
    assert main([*words, "--seed", "1"]) == 2
    assert "seed differ" in capsys.readouterr().err
    assert not (tmp_path / "sag").exists()


def test_paths_that_fail_are_told_in_the_table(capsys):
    row = dict.fromkeys(CURVE_COLUMNS, 0.0)
    _report(row, 1.0)
    _report(row | {"failed_paths": 7.0}, 1.0)
    fine, bad = capsys.readouterr().out.splitlines()
    assert "failed" not in fine
    assert bad == fine + "  7 paths failed"


def test_seeds_and_variations_are_a_study(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["train", "--stage", "no-sag", "--steps", "300", "--set", "environment.path.steps=2",
             "--workers", "0", "--seeds", "2", "--vary", "td3.target_rate=[0.005,0.02]",
             "--json", "a.json"]  # fmt: skip
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "4 trainings" in said and "target_rate=0.005" in said and "2 of 2" in said
    data = json.loads((tmp_path / "a.json").read_text())
    name = "carosac-path.steps=2"
    assert data["preset"] == name
    assert data["folder"] == f"carosac-results/train/{name}-carosac-study-300steps"
    assert [(x["seed"], x["varied"]["td3.target_rate"]) for x in data["trainings"]] == [
        (0, 0.005), (1, 0.005), (0, 0.02), (1, 0.02)
    ]  # fmt: skip
    for training in data["trainings"]:
        stage = training["stages"]["no_sag"]
        assert (tmp_path / stage["policy"]).is_file()
        assert stage["steps"] >= 300
        settings = json.loads((tmp_path / training["folder"] / "no_sag/settings.json").read_text())
        assert settings["td3"]["target_rate"] == training["varied"]["td3.target_rate"]
        assert settings["preset"] == "carosac"
        rate = training["varied"]["td3.target_rate"]
        assert settings["changes"] == f"path.steps=2_target_rate={rate}"
    names = {Path(picture).name for picture in data["pictures"]}
    assert names == {"curves-no-sag.png", "sweep-no-sag.png"}
    assert all((tmp_path / picture).is_file() for picture in data["pictures"])


def test_a_training_that_fails_is_said(tmp_path, monkeypatch, capsys):
    def fail(job, folder):
        raise RuntimeError("no memory")

    monkeypatch.setattr(training_study, "train", fail)
    words = ["train", "--stage", "no-sag", "--steps", "300", "--seeds", "1", "--workers", "0"]
    assert main([*words, "--output", str(tmp_path / "out")]) == 1
    said = capsys.readouterr().out
    assert "seed0: failed: RuntimeError: no memory" in said
    assert "0 of 1" in said


def test_a_study_and_a_single_training_keep_apart(tmp_path, capsys):
    words = ["train", "--stage", "no-sag", "--steps", "300", "--output", str(tmp_path / "one")]
    assert main(words) == 0
    assert main([*words, "--seeds", "1", "--workers", "0"]) == 2
    assert "a folder without a single training in it" in capsys.readouterr().err
    words[-1] = str(tmp_path / "many")
    assert main([*words, "--seeds", "1", "--workers", "0"]) == 0
    assert main(words) == 2
    assert "a folder without a study in it" in capsys.readouterr().err


def test_a_scheduler_that_does_not_answer_leaves_nothing(tmp_path, capsys):
    words = ["train", "--seeds", "2", "--scheduler", "nonsense", "--output", str(tmp_path / "out")]
    assert main(words) == 2
    assert "scheduler: got 'nonsense'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_one_setting_changes_a_single_training(tmp_path, capsys):
    words = ["train", "--stage", "no-sag", "--steps", "300", "--set", "td3.hidden=[16,16]"]
    assert main([*words, "--output", str(tmp_path)]) == 0
    settings = json.loads((tmp_path / "no_sag" / "settings.json").read_text())
    assert settings["td3"]["hidden"] == [16, 16]
    assert (settings["preset"], settings["changes"]) == ("carosac", "hidden=16+16")
    about = Policy.load(tmp_path / "no_sag" / "policy.onnx").description
    assert about.preset == "carosac-hidden=16+16"


def test_a_later_stage_may_be_changed_alone(tmp_path, capsys):
    words = ["train", "--steps", "300", "--output", str(tmp_path)]
    assert main([*words, "--stage", "no-sag"]) == 0
    assert main([*words, "--stage", "sag", "--set", "sag.td3.rate_end=0.5"]) == 0
    settings = json.loads((tmp_path / "sag" / "settings.json").read_text())
    assert settings["changes"] == "sag.rate_end=0.5"
    capsys.readouterr()
    shutil.rmtree(tmp_path / "sag")
    more = ["--set", "no_sag.td3.rate_end=0.3"]  # the first stage was trained without that
    assert main([*words, "--stage", "sag", *more]) == 2
    said = capsys.readouterr().err
    assert "trained with no changes; allowed: one trained with no_sag.rate_end=0.3" in said
    assert settings["started_from"]["checkpoint"] == "no_sag/checkpoint.safetensors"


def test_steps_are_said_once(capsys):
    assert main(["train", "--steps", "300", "--set", "td3.steps=400"]) == 2
    assert "--steps: got 300; allowed: nothing beside td3.steps" in capsys.readouterr().err


def test_a_device_that_is_not_there_is_refused(tmp_path, capsys):
    words = ["train", "--steps", "300", "--device", "cuda:77", "--output", str(tmp_path / "out")]
    assert main(words) == 2
    assert "device: got 'cuda:77'; allowed: one of ['cpu'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_an_estimator_that_cannot_be_trained_behind_leaves_no_folder(tmp_path, capsys):
    words = ["train", "--preset", "residual", "--set", "td3.environments=4"]
    words += ["--set", "environment.moving.estimator=simulator", "--output", str(tmp_path / "out")]
    assert main(words) == 2
    assert "estimator: got 'simulator'; allowed: one whose beliefs" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_folder_of_another_training_is_refused(trained, capsys):
    assert main(["train", "--steps", "1300", "--output", str(trained / "out")]) == 2
    assert "there td3.steps is 700, not 1300" in capsys.readouterr().err


def test_evaluation_says_errors_beside_inconsistency(trained, capsys):
    policy = str(trained / "out" / "sag" / "policy.onnx")
    out = ["--output", str(trained / "pictures"), "--json", str(trained / "e.json")]
    assert main(["evaluate", policy, "--protocol", "no-sag", "--trajectories", "3", *out]) == 0
    data = json.loads((trained / "e.json").read_text())
    assert set(data["median_error_m"]) == {"x", "y", "z", "norm"}
    assert data["trajectories"] == 3
    assert data["inconsistency_m"] > 0.0
    assert (trained / "pictures" / "histograms.png").exists()
    assert "median inconsistency" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["train", "--preset", "papper"], "preset: got 'papper'"),
        (["train", "--stage", "sagg"], "--stage: got 'sagg'; allowed: one of"),
        (["train", "--steps", "0"], "--steps: got 0"),
        (["train", "--seeds", "0"], "--seeds: got 0"),
        (["train", "--seed", "-1"], "--seed: got -1"),
        (["train", "--bogus"], "--steps, --set, --seeds"),
        (["train", "--workers", "2"], "--workers: got 2; allowed: nothing without --seeds"),
        (["train", "--set", "steps=2"], "--set: got 'steps=2'"),
        (["train", "--set", "td3.step=2"], "no_sag.td3.step: got 2"),
        (["train", "--stage", "no-sag", "--set", "sag.td3.step=2"], "sag.td3.step: got 2"),
        (
            ["train", "--stage", "no-sag", "--vary", "sag.td3.critics=[1,2]"],
            "--vary: got 'sag.td3.critics'; allowed: a setting of a stage that is trained",
        ),
        (["train", "--set", "td3.hidden=[0]"], "hidden[0]: got 0"),
        (["train", "--set", "environment.moving.perturbation=x"], "condition: got 'x'"),
        (["train", "--vary", "td3.critics=2"], "--vary: got 'td3.critics=2'"),
        (["train", "--seeds", "2", "--set", "sag.td3.rate_end=2"], "rate_end: got 2"),
        (["train", "--seeds", "2", "--stage", "sag"], "--stage: got"),
        (["evaluate", "nothing.onnx"], "nothing.onnx: no such file"),
        (["evaluate", "carosak"], "POLICY: got 'carosak'"),
    ],
)
def test_wrong_input_is_said(words, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    assert message in capsys.readouterr().err


def test_a_protocol_must_fit_the_policy(trained, capsys):
    policy = str(trained / "out" / "sag" / "policy.onnx")
    assert main(["evaluate", policy, "--protocol", "realtime", "--trajectories", "2"]) == 2
    assert "as the policy was trained" in capsys.readouterr().err
