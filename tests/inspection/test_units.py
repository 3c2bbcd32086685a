import numpy as np
import pytest

from carosac_toolkit.base.numbers import plain
from carosac_toolkit.inspection.report import report_robot
from carosac_toolkit.inspection.units import doubtful_units
from tests.robots import eight_cable_robot, hanging, simple_robot


def doubts(robot):
    return doubtful_units(report_robot(robot))


def scaled(points, unit, *chosen):
    factor = np.ones((len(points), 1))
    factor[list(chosen) or slice(None)] = {"mm": 1e3, "cm": 1e2}[unit]
    return points * factor


@pytest.mark.parametrize("robot", [simple_robot(), eight_cable_robot(), hanging(2), hanging(3)])
def test_plausible_robots_raise_no_question(robot):
    assert doubts(robot) == []


@pytest.mark.parametrize(
    ("name", "value", "question"),
    [
        ("cable_diameter", 3.0, "is diameter in mm?"),
        ("cable_diameter", 0.3, "is diameter in cm?"),
        ("linear_density", 10.55, "is linear_density in g/m?"),
        ("axial_stiffness", 950.0, "under 87.4 N at home; cables of robots stretch by less than 5 "
         "%, even of nylon: is it in kN?"),
    ],
)  # fmt: skip
def test_a_cable_of_no_material_asks_for_the_unit_that_would_mend_it(name, value, question):
    (text,) = doubts(simple_robot(**{name: np.full(4, value)}))
    assert text.startswith("all cables: ") and question in text


def test_cables_of_the_same_fault_are_named_together():
    (text,) = doubts(simple_robot(cable_diameter=[3.0, 0.003, 3.0, 0.003]))
    assert text.startswith("cables cable1, cable3: diameter 3000 mm")


def test_a_platform_far_too_heavy_for_its_cables_asks_for_mass_or_tensions():
    for robot in (
        simple_robot(mass=23655.0),
        simple_robot(tension_min=np.full(4, 5e-3), tension_max=np.full(4, 0.5)),
    ):
        (text,) = doubts(robot)
        assert "is mass in g, or tension_max in kN?" in text
    assert doubts(simple_robot(mass=300.0)) == []  # too heavy, but not by its unit


@pytest.mark.parametrize("unit", ["mm", "cm"])
def test_points_in_another_unit_are_named_however_many_they_are(unit):
    robot = simple_robot()
    exits, anchors = robot.exit_points, robot.anchor_points
    for chosen in ((1,), (0, 1), (0, 1, 2)):
        far = doubts(simple_robot(exit_points=scaled(exits, unit, *chosen)))
        assert len(far) == len(chosen) and all("exit point" in text for text in far)
        assert all(f"is it in {unit}? A bare number is in metres" in text for text in far)
    far = doubts(simple_robot(anchor_points=scaled(anchors, unit, 1)))
    assert len(far) == 1 and f"is it in {unit}? A bare number is in metres" in far[0]
    (text,) = doubts(simple_robot(exit_points=scaled(exits, unit)))
    assert f"the longest cable is 40 m: are they in {unit}?" in text


def test_several_anchor_points_in_millimetres_are_each_named():
    anchors = simple_robot().anchor_points
    for chosen in ((0, 1), (0, 1, 2)):
        far = doubts(simple_robot(anchor_points=scaled(anchors, "mm", *chosen)))
        assert len(far) == len(chosen) and all("is it in mm?" in text for text in far)


def test_a_far_anchor_point_of_a_point_mass_asks_for_no_certain_unit():
    anchors = np.zeros((4, 3))
    anchors[0, 0] = 300.0
    (text,) = [x for x in doubts(simple_robot(anchor_points=anchors)) if "anchor point" in x]
    assert "is its unit right?" in text


@pytest.mark.parametrize(
    ("factor", "question"),
    [(1e3, "are they in mm or cm?"), (1e4, "are they in mm?"), (1e6, "are their units right?")],
)
def test_anchor_points_that_are_all_far_ask_for_the_units_that_fit_the_frame(factor, question):
    (text,) = doubts(simple_robot(anchor_points=factor * simple_robot().anchor_points))
    assert f"{question} A bare number is in metres" in text


@pytest.mark.parametrize(
    ("factor", "length_max", "units"),
    [(1e3, 40.0, "mm"), (1e2, 10.0, "cm"), (1e2, 13.0, "mm or cm")],
)
def test_home_in_another_unit_asks_for_those_that_bring_it_between_the_exit_points(
    factor, length_max, units
):
    home = factor * simple_robot().home_position
    text, *_ = doubts(simple_robot(home_position=home, length_max=np.full(4, length_max)))
    assert f"is home in {units}?" in text


def test_the_largest_strain_of_cables_of_the_same_stiffness_is_told():
    home = simple_robot().home_position + np.array([0.0, -2.0, 0.0])
    robot = simple_robot(axial_stiffness=np.full(4, 200.0), home_position=home)
    report = report_robot(robot)
    tension = report.equilibrium.tension[0]
    assert tension.argmax() != 0
    (text,) = [text for text in doubtful_units(report) if "stretches" in text]
    assert f"stretches by up to {plain(tension.max() / 2.0, 3)} %" in text
    assert f"under {plain(tension.max(), 3)} N" in text
