"""Trainings as cases of a study: the same policies as alone, whatever happens to processes."""

import json
import shutil

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

import torch

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.studies import Case
from learned import training_study
from learned.checkpoint import CHECKPOINT_FILE, read_checkpoint
from learned.training import train
from learned.training_study import TrainingRun, TrainingStudy, check_stages, free_study, train_case

SMALL = {"td3.hidden": [16, 16], "td3.environments": 8, "environment.path.steps": 20}


def some_trainings(seeds=(0, 1), **more):
    values = {"preset": "carosac", "robot": "carosac", "stages": ("no_sag",), "steps": 400,
              "fixed": SMALL} | more  # fmt: skip
    return tuple(TrainingRun(seed=seed, **values) for seed in seeds)


def networks(folder):
    state = read_checkpoint(folder / "no_sag" / CHECKPOINT_FILE, ["parameters"], ())
    return state["parameters"]["policy"]


def assert_same(one, other):
    assert one.keys() == other.keys()
    for name, value in one.items():
        assert torch.equal(value, other[name]), name


@pytest.fixture(scope="module")
def studied(tmp_path_factory):
    """Two seeds, each in a process of its own."""
    folder = tmp_path_factory.mktemp("study")
    study = TrainingStudy(trainings=some_trainings(), folder=folder)
    return study, study.run(workers=2, progress=False)


def test_a_training_of_a_study_is_the_same_as_alone(studied, tmp_path):
    study, rows = studied
    assert [row["status"] for row in rows] == ["ok", "ok"]
    for training in study.trainings:
        (job,) = training.jobs(load_robot("carosac"), tmp_path)
        train(job, tmp_path / str(training.seed) / job.stage_name)
        alone = networks(tmp_path / str(training.seed))
        assert_same(networks(study.folder / training.place), alone)


def test_a_training_knows_where_its_worlds_are():
    here, there = (some_trainings((0,), device=x)[0] for x in ("cpu", "cuda"))
    assert "device" not in here.case().settings  # as in studies of before
    assert TrainingRun.of_case(there.case()) == there
    (job,) = there.jobs(load_robot("carosac"), there.place)
    assert job.device == job.settings()["device"] == "cuda"


def test_rows_hold_the_last_point_of_the_curve(studied):
    study, rows = studied
    text = (study.folder / "seed1" / "no_sag" / "curve.csv").read_text().splitlines()
    last = dict(zip(text[0].split(","), text[-1].split(","), strict=True))
    assert rows[1]["no_sag_median_error_m"] == float(last["median_error_m"])
    assert rows[1]["no_sag_steps"] == 400
    assert study.share() == 1.0


def test_a_second_call_trains_nothing_and_more_seeds_extend_it(studied, monkeypatch):
    study, rows = studied
    file = study.folder / "seed0" / "no_sag" / "policy.onnx"
    before = file.stat().st_mtime_ns
    more = TrainingStudy(trainings=some_trainings((0, 1, 2)), folder=study.folder)
    assert more.share() == pytest.approx(2 / 3)
    found = more.run(workers=0, progress=False)
    assert found[:2] == rows
    assert file.stat().st_mtime_ns == before
    assert more.share() == 1.0


def test_a_training_goes_on_where_it_failed(studied, tmp_path, monkeypatch):
    def die(job, folder, **more):
        train(job, folder, stop_after=200)
        raise RuntimeError("no memory")

    study = TrainingStudy(trainings=some_trainings((0,)), folder=tmp_path)
    monkeypatch.setattr(training_study, "train", die)
    (row,) = study.run(workers=0, progress=False)
    assert (row["status"], row["reason"]) == ("failed", "RuntimeError: no memory")
    monkeypatch.undo()
    (row,) = study.run(workers=0, progress=False)
    assert row["status"] == "ok"
    assert_same(networks(tmp_path / "seed0"), networks(studied[0].folder / "seed0"))


def test_a_training_that_was_removed_is_trained_again(studied, tmp_path):
    study = TrainingStudy(trainings=some_trainings((0,)), folder=tmp_path)
    study.run(workers=0, progress=False)
    shutil.rmtree(tmp_path / "seed0")
    (row,) = study.run(workers=0, progress=False)
    assert row["status"] == "ok"
    assert_same(networks(tmp_path / "seed0"), networks(studied[0].folder / "seed0"))


def test_a_case_is_the_training_it_stands_for():
    (training,) = some_trainings((3,), varied={
        "td3.target_rate": 0.02, "td3.critics": 1, "td3.exploration": {"start": 0.2, "end": 0.1}
    })  # fmt: skip
    case = training.case()
    there = Case.from_dict(json.loads(json.dumps(case.to_dict())))
    assert TrainingRun.of_case(there) == training
    assert TrainingRun.of_case(there).place == training.place  # whatever the order of changes
    assert str(training.place) == "critics=1_exploration=end0.1+start0.2_target_rate=0.02/seed3"
    assert training.name.startswith("carosac-path.steps=20_")
    assert training.name.endswith("-critics=1_exploration=end0.1+start0.2_target_rate=0.02")


def test_what_is_not_finite_is_left_out(tmp_path, monkeypatch):
    last = dict.fromkeys(training_study.CURVE_COLUMNS, 1.0) | {"rmse_m": np.nan}
    monkeypatch.setattr(training_study, "train", lambda *_: None)
    monkeypatch.setattr(training_study, "read_curve", lambda _: [last])
    row = train_case(some_trainings((0,))[0].case(), tmp_path)
    assert row["no_sag_rmse_m"] is None
    assert row["no_sag_p95_error_m"] == 1.0


def test_another_study_gets_another_folder(studied, tmp_path):
    base = tmp_path / "a"
    first = free_study(base, some_trainings())
    assert first.folder == base
    one_step = [x for x in some_trainings(steps=8)]
    TrainingStudy(trainings=tuple(one_step), folder=base).run(workers=0, progress=False)
    assert free_study(base, some_trainings()).folder == tmp_path / "a-2"
    assert free_study(base, one_step).folder == base


def test_a_study_begins_with_the_first_stage():
    check_stages(["no_sag"], "carosac")
    check_stages(["no_sag", "sag"], "carosac")
    with pytest.raises(InvalidField, match="got sag; allowed: no-sag with it"):
        check_stages(["sag"], "carosac")
