"""A recording of one robot, compared with another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.recordings.bundled import find_recording
from carosac_toolkit.recordings.files import load_recording
from carosac_toolkit.robot.parameters import turn_between, with_values
from carosac_toolkit.validation import validate
from carosac_toolkit.validation.another_robot import another_robot

RECORDING = load_recording(find_recording("synthetic"))
ROBOT = ct.load_robot("carosac")


def test_the_robot_of_a_recording_is_not_doubted_nor_is_a_calibrated_one():
    assert another_robot(RECORDING, ROBOT) == ()
    near = replace(ROBOT, exit_points=ROBOT.exit_points + 0.03, mass=1.1 * ROBOT.mass)
    assert another_robot(RECORDING, near) == ()


def test_a_robot_whose_pose_frame_was_found_tilted_is_not_another_one():
    turned = with_values(ROBOT, ["pose_tilt.x", "pose_tilt.y"], np.array([0.05, -0.03]))
    turned = replace(turned, exit_points=ROBOT.exit_points @ turn_between(ROBOT, turned).T)
    assert np.abs(turned.exit_points - ROBOT.exit_points).max() > 0.3
    measured = replace(RECORDING, exit_points=ROBOT.exit_points)
    assert another_robot(measured, turned) == ()


def test_a_recording_that_names_another_robot_is_told_with_the_differences():
    result = validate(RECORDING, ct.load_robot("scampi"), ("straight_line",), stop=5)
    assert result.warnings[0].startswith(
        "This is a recording of another robot: it names carosac, and is compared with scampi, "
        "which differs in weight (232.1 N, 43.1"
    )


def test_exit_points_measured_elsewhere_are_told():
    nameless = replace(RECORDING, metadata=replace(RECORDING.metadata, robot=None),
                       exit_points=ROBOT.exit_points + np.array([0.0, 0.0, 0.5]))  # fmt: skip
    assert "lie up to 0.5 m from those of carosac" in another_robot(nameless, ROBOT)[0]


def test_another_number_of_cables_names_the_robots_that_fit():
    with pytest.raises(InvalidField, match=r"another robot than 'cogiro'.*names 'carosac'.*scampi"):
        validate(RECORDING, ct.load_robot("cogiro"), ("straight_line",))
