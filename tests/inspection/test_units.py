import numpy as np
import pytest

from carosac_toolkit.inspection.report import report_robot
from carosac_toolkit.inspection.units import doubtful_units
from tests.robots import eight_cable_robot, hanging, simple_robot


def doubts(robot):
    return doubtful_units(report_robot(robot))


def in_millimetres(points, *chosen):
    factor = np.ones((len(points), 1))
    factor[list(chosen) or slice(None)] = 1e3
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
        ("axial_stiffness", 950.0, "under 84.5 N at home; cables of robots stretch by less than 5 "
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


def test_points_in_millimetres_are_named_however_many_they_are():
    robot = simple_robot()
    exits, anchors = robot.exit_points, robot.anchor_points
    for chosen, count in (((1,), 1), ((0, 1), 2), ((0, 1, 2), 3), ((), 1)):
        far = doubts(simple_robot(exit_points=in_millimetres(exits, *chosen)))
        assert len(far) == count and all("exit point" in text for text in far)
        far = doubts(simple_robot(anchor_points=in_millimetres(anchors, *chosen)))
        assert len(far) == count and all("in mm? A bare number is in metres" in x for x in far)


def test_exit_points_and_home_in_different_units_ask_for_the_one_in_millimetres():
    robot = simple_robot()
    (text,) = doubts(simple_robot(exit_points=in_millimetres(robot.exit_points)))
    assert "the longest cable is 40 m: are they in mm?" in text
    (text,) = doubts(simple_robot(home_position=1e3 * robot.home_position))
    assert "the longest cable is 40 m: is home in mm?" in text
