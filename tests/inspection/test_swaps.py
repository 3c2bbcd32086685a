from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.inspection.report import report_robot
from tests.robots import simple_robot


def exchanged(robot, field, i, j):
    points = getattr(robot, field).copy()
    points[[i, j]] = points[[j, i]]
    return replace(robot, **{field: points})


@pytest.mark.parametrize("field", ["exit_points", "anchor_points"])
@pytest.mark.parametrize(("i", "j"), [(1, 2), (0, 3)])
def test_two_swapped_cables_that_touch_are_asked_for(field, i, j):
    *touching, question = report_robot(exchanged(simple_robot(), field, i, j)).problems
    assert touching and all("touch at home" in text for text in touching)
    assert f"With those of cable{i + 1} and cable{j + 1} exchanged" in question


@pytest.mark.parametrize(
    ("order", "reason"), [([1, 0, 3, 2], "is not stable"), ([2, 1, 0, 3], "touch at home")]
)
def test_swapped_diagonals_of_an_unstable_robot_are_asked_for(order, reason):
    robot = ct.load_robot("stadium")
    problems = report_robot(replace(robot, anchor_points=robot.anchor_points[order])).problems
    assert reason in problems[0]
    assert "of south_west and north_east" in problems[-1] and "exchanged" in problems[-1]


def test_nothing_is_asked_where_no_exchange_helps():
    heavy = report_robot(simple_robot(mass=3000.0))
    assert heavy.problems and not any("swapped" in text for text in heavy.problems)
    high = report_robot(simple_robot(home_position=np.array([0.4, -1.8, 9.0])))
    assert high.problems and not any("swapped" in text for text in high.problems)


def test_nothing_is_asked_where_an_exchange_turns_the_platform_over():
    robot = ct.load_robot("desktop")
    high = replace(robot, center_of_mass=robot.center_of_mass + np.array([0.0, 0.0, 0.1]))
    problems = report_robot(high).problems
    assert problems and not any("swapped" in text for text in problems)
