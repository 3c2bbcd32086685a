from __future__ import annotations

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField, InvalidFile, MissingFile
from carosac_toolkit.robot.condition_file import (
    condition_digest,
    find_condition,
    read_condition,
)
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.robot.perturbations import CONDITIONS_BY_NAME
from carosac_toolkit.robot.sizes import frame_size

HALL = """\
schema: carosac-condition/1
description: our hall, surveyed with a tape
mass: 3 %
inertia: 0.1
exit_points: 5 mm
anchor_points: 0.5 % of platform
drag: factor 1.5
wind_force: 2 % of weight
wind_time: 3 s
"""


def test_a_file_says_what_differs_in_units_shares_and_parts_of_the_robot():
    robot = load_robot("carosac")
    hall = read_condition(HALL, "hall.yaml").of(robot)
    assert (hall.mass, hall.inertia, hall.axial_stiffness) == pytest.approx((0.03, 0.1, 0.0))
    assert hall.exit_points == pytest.approx(5e-3)
    assert hall.anchor_points == pytest.approx(0.005 * np.linalg.norm(robot.anchor_points[0]))
    assert hall.drag == pytest.approx(np.log(1.5))
    assert hall.wind_force == pytest.approx(0.02 * robot.weight)
    assert hall.wind_time == 3.0


def test_a_part_may_do_without_percent():
    text = "schema: carosac-condition/1\nexit_points: 1e-3 of frame\n"
    robot = load_robot("cogiro")
    assert read_condition(text, "x").of(robot).exit_points == pytest.approx(
        1e-3 * frame_size(robot)
    )


@pytest.mark.parametrize(
    ("line", "fault"),
    [
        ("masss: 3 %", r"line 2: masss: got a field; allowed: .* did you mean 'mass'"),
        ("mass: 3 kg", r"line 2: mass: got '3 kg'; allowed: a share >= 0, such as 3 %"),
        ("mass: -1 %", r"line 2: mass: got '-1 %'; allowed: a share >= 0"),
        ("drag: factor 0.5", r"line 2: drag: got 'factor 0.5'; allowed"),
        ("exit_points: 5 N", r"line 2: exit_points: got '5 N'; .* N is a force"),
        ("exit_points: -5 mm", r"line 2: exit_points: got -5 mm; allowed"),
        ("exit_points: 1 % of weight", r"allowed: a part of one of \['frame', 'platform', 'cable'"),
        ("wind_time: 0 s", r"line 2: wind_time: got 0.0 s; allowed: wind_time > 0"),
        ("mass: true", r"line 2: mass: got True; allowed"),
    ],
)
def test_faults_name_line_field_value_and_what_is_allowed(line, fault):
    with pytest.raises(InvalidFile, match=fault):
        read_condition(f"schema: carosac-condition/1\n{line}\n", "hall.yaml")


@pytest.mark.parametrize("text", ["mass: 3 %\n", "schema: carosac-robot/1\n", "- 1\n"])
def test_another_schema_is_refused(text):
    with pytest.raises(InvalidFile, match=r"schema: got .*; allowed: carosac-condition/1"):
        read_condition(text, "hall.yaml")


def test_all_faults_are_in_one_message():
    with pytest.raises(InvalidFile, match="2 faults"):
        read_condition("schema: carosac-condition/1\nmass: x\ndrag: y\n", "hall.yaml")


def test_a_path_is_a_file_and_a_name_is_a_condition(tmp_path):
    file = tmp_path / "hall.yaml"
    file.write_text(HALL)
    assert find_condition(str(file)) == read_condition(HALL, file)
    assert find_condition("none") is CONDITIONS_BY_NAME["none"]
    assert condition_digest("nominal-2") is None
    before = condition_digest(str(file))
    file.write_text(HALL.replace("5 mm", "6 mm"))
    assert condition_digest(str(file)) != before
    with pytest.raises(MissingFile, match=r"no such file; conditions of the toolkit are"):
        find_condition(str(tmp_path / "hal.yaml"))
    with pytest.raises(InvalidField, match="did you mean 'nominal-"):
        find_condition("nominal-3")
