"""Every picture of a calibration's report, held against the list that those of studies meet."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import carosac_toolkit as ct
from calibration import calibrate_lengths, calibrate_motor_angles, calibrate_tachymeter
from calibration.identification.pictures import draw_motion, draw_rests, draw_runs
from calibration.lengths.pictures import draw_poses
from calibration.lengths.planning import SuggestedPoses
from calibration.lengths.report import report_content as lengths_report
from calibration.pictures import draw_residuals
from calibration.self_calibration.report import report_content as angles_report
from calibration.tachymeter.report import report_content as survey_report
from carosac_toolkit.pictures.style import DOUBLE_COLUMN_INCH
from carosac_toolkit.recordings.recording import Recording
from tests.calibration.lengths.scenes import scene as lengths_scene
from tests.calibration.lengths.scenes import with_pulleys
from tests.calibration.self_calibration.scenes import scene as angles_scene
from tests.calibration.tachymeter.scenes import drawn
from tests.pictures.layout import cut_texts, laid_out, overlapping_texts, texts_on_data

ROBOT = ct.load_robot("cogiro")


def identified():
    """A motion and rests as an identification has them, and their recording."""
    time = np.arange(0.0, 20.0, 0.1)
    swing = 0.02 * np.sin(time)[:, None]
    resting = (time % 5.0 > 2.5)[:, None]
    length = 5.0 + np.cumsum(np.where(resting, 0.0, 0.01), axis=0) * np.ones(4)
    rests = SimpleNamespace(
        starts=np.arange(25, 1225, 50), before=np.full(24, 0.02), after=np.full(24, 0.003)
    )
    run = SimpleNamespace(
        name="run.csv", measured=SimpleNamespace(time=time, position=np.zeros((len(time), 3))),
        position_before=3.0 * swing * np.ones(3), errors=swing * np.ones(6), rmse=(0.02, 0.003),
        train=SimpleNamespace(stop=120), test=SimpleNamespace(stop=200), rests=rests,
    )  # fmt: skip
    held = SimpleNamespace(**{**vars(run), "name": "other.csv", "train": None})
    result = SimpleNamespace(robot=ROBOT, runs=(run, held), rests=rests)
    return result, Recording(time=time, unstrained_length=length)


@pytest.fixture(scope="module")
def figures():
    """Pictures of four calibrations: a survey, motor angles with a blunder, lengths and a run."""
    before, _, _, angles = angles_scene(3, blunders={(11, 1): 0.2})
    robot = with_pulleys("carosac")
    lengths = calibrate_lengths(lengths_scene("carosac", 4, samples=100).recording, robot)
    suggested = SuggestedPoses(
        position=robot.home_position + np.array([[0.0], [0.5]]),
        rotation=np.tile(np.eye(3), (2, 1, 1)),
        sigma=np.array([5e-3, 4e-3, 3e-3]), worst=np.array([9e-3, 8e-3, 7e-3]),
    )  # fmt: skip
    survey = calibrate_tachymeter(ROBOT, drawn(3, ROBOT, blunders=0.05).survey)
    contents = {
        "tachymeter": survey_report(survey),
        "motor angles": angles_report(calibrate_motor_angles(angles, before)),
        "lengths": lengths_report(lengths, suggested),
    }
    found = {
        f"{kind} {name}": figure
        for kind, content in contents.items()
        for name, (figure, _) in content.images.items()
    }
    found |= {"lengths alone": draw_poses(lengths, None)}
    result, recording = identified()
    found |= {
        "motion": draw_motion(result, result.runs[0], recording), "rests": draw_rests(result),
        "runs": draw_runs(result),
        "without a blunder": draw_residuals(
            "carosac", np.arange(9.0), 1e-3 * np.eye(9)[:, :4], np.zeros((9, 4), dtype=np.bool_),
            lengths.robot.cable_names, label="time [s]",
        ),
    }  # fmt: skip
    return {name: laid_out(figure) for name, figure in found.items()}


def test_no_text_covers_another_or_data_or_is_cut_off(figures):
    for faults in (overlapping_texts, texts_on_data, cut_texts):
        assert {k: found for k, f in figures.items() if (found := faults(f))} == {}


def test_every_picture_names_its_robot_and_is_as_wide_as_two_columns(figures):
    for name, figure in figures.items():
        robot = figure.get_suptitle().partition(":")[0]
        assert robot in ("cogiro", "hangprinter", "carosac"), name
        assert figure.get_size_inches()[0] == DOUBLE_COLUMN_INCH, name
