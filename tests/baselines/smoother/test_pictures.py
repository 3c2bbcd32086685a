"""Pictures of a smoothed recording, held against the list that those of studies meet."""

from __future__ import annotations

import pytest

import carosac_toolkit as ct
from baselines.smoother import SmootherSettings, smooth
from baselines.smoother.output import PICTURES
from carosac_toolkit.pictures.style import DOUBLE_COLUMN_INCH
from tests.baselines.smoother.runs import swing
from tests.pictures.layout import cut_texts, laid_out, overlapping_texts, texts_on_data


@pytest.mark.parametrize("poses", ["half", "used"])
def test_pictures_are_legible_name_robot_and_cables_and_are_as_wide_as_two_columns(poses):
    robot = ct.load_robot("carosac")
    recording = swing(robot, seed=3, wind=1.0, duration=1.0)[0]
    result = smooth(recording, robot, SmootherSettings(poses=poses))
    for name, draw in PICTURES.items():
        figure = laid_out(draw(result))
        for faults in (overlapping_texts, texts_on_data, cut_texts):
            assert faults(figure) == [], name
        assert figure.get_suptitle().startswith("carosac: ")
        assert figure.get_size_inches()[0] == DOUBLE_COLUMN_INCH
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert set(robot.cable_names) < set(labels)
