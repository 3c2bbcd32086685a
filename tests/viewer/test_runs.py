"""Runs to replay: recordings, runs of `carosac run`, and cases of a study, as they really went."""

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.loop.values import Belief, Measurement, Stamped
from carosac_toolkit.recordings.crash_safe import CrashSafeRecorder
from carosac_toolkit.recordings.metadata import RecordingMetadata
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.studies.run.case import Case
from carosac_toolkit.studies.run.folder import opened
from carosac_toolkit.studies.run.run_case import run_case
from carosac_toolkit.viewer.runs import load_runs


@pytest.fixture(scope="module")
def way():
    """A robot let down by 1 m in 2 s, always at rest."""
    robot = ct.load_robot("carosac")
    time = np.linspace(0.0, 2.0, 21)
    position = robot.home_position + np.stack([0 * time, 0 * time, -0.5 * time], axis=1)
    return robot, time, ct.statics.inverse_kinematics(robot, position)


def test_lengths_alone_are_played_as_poses_of_rest_with_their_tensions(way, tmp_path):
    _, time, rest = way
    metadata = RecordingMetadata(robot="carosac")
    file = tmp_path / "lengths.csv"
    recording = Recording(
        time=time + 5.0, unstrained_length=rest.unstrained_length, metadata=metadata,
        command=Stamped(time=time[:-5] + 5.0, value=rest.unstrained_length[5:]),
    )  # fmt: skip
    ct.save_recording(recording, file)
    (run,) = load_runs(str(file))
    assert run.time == pytest.approx(time)
    assert run.position == pytest.approx(rest.position, abs=1e-6)
    assert run.tension == pytest.approx(rest.tension, rel=1e-5)
    assert run.target[:16] == pytest.approx(rest.position[5:], abs=1e-6)
    assert run.error[0] == pytest.approx(0.25, abs=1e-6)  # commands are half a second ahead
    picture = run.picture(run.index(1.06))
    assert picture.time == pytest.approx(1.0) and not picture.straight.any()


def test_the_file_of_a_run_is_played_as_its_estimator_believed(way, tmp_path):
    _, time, rest = way
    file = tmp_path / "run.jsonl"
    recorder = CrashSafeRecorder(file, robot="carosac")
    moved = rest.position + np.array([0.03, 0.0, 0.0])
    for k, now in enumerate(time):
        row = slice(k, k + 1)
        when = np.array([now])
        recorder.measured(Measurement(time=when, unstrained_length=rest.unstrained_length[row]))
        recorder.believed(Belief(time=when, position=moved[row], rotation=rest.rotation[row]))
    recorder.close()
    (run,) = load_runs(str(file))
    assert run.position == pytest.approx(moved)
    assert run.rotation == pytest.approx(rest.rotation, abs=1e-6)
    assert "as estimated" in run.source


def test_cases_of_a_study_are_played_as_the_plant_moved(tmp_path):
    fields = {
        "robot": "carosac", "sensors": "lengths", "estimator": "kinematic_solver",
        "trajectory": "line", "perturbation": "nominal-1",
        "settings": {"driver": "quasi_static", "speed_max": 3.0, "acceleration_max": 6.0},
    }  # fmt: skip
    cases = [
        Case(controller=name, seed=seed, **fields)
        for name in ("straight_line", "kinematic_solver")
        for seed in (0, 1)
    ]
    with opened(tmp_path, cases, "carosac_toolkit.studies.run.run_case.run_case") as folder:
        went = run_case(cases[0])
        unkept = {"series": None}
        folder.append([row_of(x) | went | (unkept if x.seed else {}) for x in cases])
    runs = load_runs(str(tmp_path))
    assert len(runs) == 2  # seed 1 has kept no course
    names = [run.name.partition(" with ")[0] for run in runs]
    assert names == ["straight_line", "kinematic_solver"]
    run = runs[0]
    assert run.tension.sum(axis=1).min() > run.robot.weight  # inclined cables carry it
    turned = run.rotation.swapaxes(1, 2) @ run.rotation
    assert turned == pytest.approx(np.broadcast_to(np.eye(3), turned.shape), abs=1e-9)
    assert np.nanmax(run.error) < 1.0 and run.error[-1] > 0.1  # straight cables stay off
    assert load_runs(f"{tmp_path}:1")[0].name == runs[1].name
    with pytest.raises(InvalidField, match=r"0 to 1"):
        load_runs(f"{tmp_path}:2")


def row_of(case):
    """What stands in a row beside the scores."""
    names = ("robot", "sensors", "controller", "estimator", "trajectory", "perturbation", "seed")
    return {"case": case.identity, "status": "ok"} | {x: getattr(case, x) for x in names}


def test_what_cannot_be_played_is_refused(tmp_path, way):
    _, time, rest = way
    with pytest.raises(CarosacError, match="no folder of a study"):
        load_runs(str(tmp_path))
    file = tmp_path / "relative.csv"
    metadata = RecordingMetadata(robot="carosac", length_kind="relative")
    lengths = rest.unstrained_length - 5.0
    recording = Recording(time=time, unstrained_length=lengths, metadata=metadata)
    ct.save_recording(recording, file)
    with pytest.raises(CarosacError, match="neither poses nor absolute lengths"):
        load_runs(str(file))
