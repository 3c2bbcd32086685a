"""Cables that touch, or run through the platform, on robots whose anchors were swapped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.inspection.report import report_robot
from carosac_toolkit.workspace import compute
from carosac_toolkit.workspace.grid import box_grid


def swapped(name, i, j):
    robot = ct.load_robot(name)
    anchors = np.array(robot.anchor_points)
    anchors[[i, j]] = anchors[[j, i]]
    return replace(robot, anchor_points=anchors)


def test_two_cables_that_cross_at_home_are_a_problem_and_are_named():
    report = report_robot(swapped("ipanema1", 0, 1))
    (problem,) = [text for text in report.problems if "touch" in text]
    assert problem.startswith(
        "cables top_1 and top_2 touch at home: their middles are 0.0 mm apart"
    )
    assert not report.feasible


def test_a_cable_to_the_far_side_of_the_platform_runs_through_it():
    (warning,) = [text for text in report_robot(swapped("cogiro", 0, 2)).warnings if "hull" in text]
    assert warning.startswith("cable cable_3 runs through the hull of the anchor points at home")


@pytest.mark.parametrize("name", ct.list_robots())
def test_no_bundled_robot_has_contacts_at_home(name):
    report = report_robot(ct.load_robot(name))
    assert not [x for x in (*report.problems, *report.warnings) if "touch" in x]


def test_a_workspace_names_the_pair_that_comes_too_near():
    robot = swapped("ipanema1", 0, 1)
    home = robot.home_position
    half = np.array([0.2, 0.001, 0.2])
    region = compute(robot, box_grid(home - half, home + half, 9))
    assert region.colliding()[0][:2] == ("top_1", "top_2")
    assert "cables too near each other, top_1 and top_2" in region.sentence()
    assert region.data()["colliding"][0]["cables"] == ["top_1", "top_2"]
