from __future__ import annotations

import numpy as np
import pytest

from carosac_toolkit.base.errors import CarosacError, InvalidField, InvalidFile
from carosac_toolkit.interchange.caspr import read_caspr
from carosac_toolkit.interchange.completion import complete, form, robot_and_text
from carosac_toolkit.interchange.robots import read_robot
from tests.interchange.models import (
    REST,
    caspr_body,
    caspr_cables,
    cdpyr,
    geometry,
    straight_cables,
    wirex,
    write_caspr,
)


@pytest.fixture
def paths(tmp_path):
    cables = caspr_cables({"original": straight_cables(*geometry("ipanema1"))})
    return write_caspr(tmp_path, caspr_body(), cables)


def test_all_that_is_missing_comes_at_once_and_nothing_is_guessed(paths):
    completed = complete(read_caspr(*paths))
    asked = [".".join(map(str, path)) for path, _ in completed.missing]
    assert asked == [
        "licence", "gravity", "platform.air_drag.linear", "platform.air_drag.angular",
        "cable_types.cable.axial_stiffness", "cable_types.cable.linear_density",
        "cable_types.cable.axial_damping", "cable_types.cable.diameter", "winches.winch.speed_max",
        "winches.winch.acceleration_max", "winches.winch.lag", "winches.winch.length_min",
        "winches.winch.length_max", "winches.winch.run_length", "workspace.min", "workspace.max",
        "home.position", "home.rpy_deg",
    ]  # fmt: skip
    with pytest.raises(CarosacError, match="gravity: an acceleration"):
        robot_and_text(completed)


def test_a_form_asks_for_what_is_missing_and_can_be_filled_in(paths):
    asked = complete(read_caspr(*paths))
    text = form(asked)
    again = complete(read_caspr(*paths), fragment=text, name="form.yaml")
    assert again.missing == asked.missing  # empty fields are no values
    numbers = {"licence": "mine", "mass": "1 kg", "min": "[-1, -1, 0]", "max": "[1, 1, 2]",
               "position": "[0, 0, 1]", "rpy_deg": "[0, 0, 90]", "length_min": "0.1"}  # fmt: skip
    filled = [
        f"{line.partition('  #')[0]} {numbers.get(line.partition(':')[0].strip(), '2')}"
        if ":  # " in line and "provenance" not in line else line
        for line in text.splitlines()
    ]  # fmt: skip
    robot, _ = robot_and_text(
        complete(read_caspr(*paths), fragment="\n".join(filled), name="form.yaml")
    )
    assert robot.gravity == 2.0
    assert robot.home_rotation == pytest.approx(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]))


def test_every_number_has_its_source(paths):
    robot, _ = robot_and_text(complete(read_caspr(*paths), fragment=REST, name="/a/rest.yaml"))
    assert robot.provenance["gravity"] == "given in rest.yaml"
    assert robot.provenance["cable_types"] == "data sheet"
    assert robot.provenance["platform.mass"].endswith("mass of the link")
    assert robot.licence == "Apache-2.0"


def test_what_both_have_is_the_users_and_said(paths):
    given = complete(
        read_caspr(*paths), fragment=REST, name="r", pairs=["platform.mass=30 kg", "name=mine"]
    )
    robot, _ = robot_and_text(given)
    assert (robot.mass, robot.name) == (30.0, "mine")
    assert given.replaced == ("tension_limits.min", "tension_limits.max", "platform.mass")
    assert robot.provenance["platform.mass"] == "given on the command line"


@pytest.mark.parametrize(
    ("fragment", "message"),
    [
        ("gravity: 9.81 kg", "line 1: gravity: got '9.81 kg'; allowed: an acceleration"),
        ("gravety: 9.81", "line 1: gravety: unknown key"),
        ("[1, 2]", "not a mapping"),
        ("gravity: [", "not YAML"),
        ("gravity: 9.81\nprovenance: x", "line 2: provenance: got 'x'; allowed: a mapping"),
    ],
)
def test_faults_of_a_fragment_have_its_line(paths, fragment, message):
    with pytest.raises(InvalidFile) as caught:
        complete(read_caspr(*paths), fragment=fragment, name="rest.yaml")
    assert message in str(caught.value)


@pytest.mark.parametrize("pair", ["gravity", "gravity=", "=3", "a..b=1"])
def test_a_pair_that_is_none_is_refused(paths, pair):
    with pytest.raises(InvalidField, match="--set"):
        complete(read_caspr(*paths), pairs=[pair])


def test_files_are_known_by_what_is_in_them(paths, tmp_path):
    assert read_robot(paths[:1]).source == read_robot(paths[::-1]).source
    (tmp_path / "a.xml").write_text(wirex(*geometry("ipanema1")))
    assert read_robot([tmp_path / "a.xml"]).source.startswith("WireX")
    (tmp_path / "a.yaml").write_text(str(cdpyr(*geometry("ipanema1"))))
    assert read_robot([tmp_path / "a.yaml"]).source.startswith("cdpyr")
    with pytest.raises(InvalidField, match="--cable-set"):
        read_robot([tmp_path / "a.xml"], cable_set="x")
    with pytest.raises(InvalidField, match="FILE"):
        read_robot([tmp_path / "a.xml", paths[0]])
    paths[1].unlink()
    with pytest.raises(CarosacError, match="give both files of the robot"):
        read_robot(paths[:1])
