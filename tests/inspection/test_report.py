from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.inspection.report import is_suspended, report_robot


@pytest.mark.parametrize(
    ("name", "constraint", "suspended"),
    [
        ("carosac", "under-constrained", True),
        ("scampi", "under-constrained", True),
        ("cogiro", "over-constrained", True),
        ("ipanema1", "over-constrained", False),
    ],
)
def test_bundled_robots_hang_at_home_and_are_of_their_kind(name, constraint, suspended):
    report = report_robot(ct.load_robot(name))
    assert report.feasible
    assert report.constraint == constraint
    assert report.suspended is suspended
    assert (report.frequencies > 0.1).all()
    assert (report.sag > 0.0).all()


def test_cables_carry_the_weight_of_the_platform_at_home():
    report = report_robot(ct.load_robot("carosac"))
    end = report.shape[:, -2] - report.shape[:, -1]  # along the cable, away from the platform
    up = end[:, 2] / np.linalg.norm(end, axis=1) * report.equilibrium.tension[0]
    assert up.sum() == pytest.approx(report.robot.weight, rel=2e-3)  # chord of the last piece


def test_cables_end_at_their_points():
    report = report_robot(ct.load_robot("cogiro"))
    robot = report.robot
    assert report.shape[:, 0] == pytest.approx(robot.exit_points, abs=1e-9)
    anchors = robot.home_position + robot.anchor_points @ report.equilibrium.rotation[0].T
    assert report.shape[:, -1] == pytest.approx(anchors, abs=1e-9)


def test_a_robot_that_cannot_hang_at_home_is_said_to_be_so():
    robot = ct.load_robot("carosac")
    report = report_robot(replace(robot, tension_max=np.full(4, 30.0)))
    assert not report.feasible
    data = report.data()
    assert data["home"]["feasible"] is False
    assert np.isnan(data["cables"][0]["home_tension_N"])


def test_suspended_means_that_every_cable_pulls_up():
    robot = ct.load_robot("carosac")
    upright = np.eye(3)[None]
    assert is_suspended(robot, robot.home_position[None], upright)
    assert not is_suspended(robot, np.array([[0.4, -1.8, 8.4]]), upright)
