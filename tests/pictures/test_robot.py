from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from carosac_toolkit.inspection.report import report_robot
from carosac_toolkit.pictures.robot import draw_robot


@pytest.mark.parametrize("name", ["carosac", "cogiro"])
def test_axes_have_units_and_names_are_written(name):
    report = report_robot(ct.load_robot(name))
    figure = draw_robot(report)
    space, *planes = figure.axes
    assert [space.get_xlabel(), space.get_ylabel(), space.get_zlabel()] == [
        "x [m]",
        "y [m]",
        "z [m]",
    ]
    assert all(plane.get_xlabel().endswith("[m]") for plane in planes)
    assert len(planes) == 2
    written = ", ".join(text.get_text() for text in space.texts)
    assert written.split(", ") == list(report.robot.cable_names)


def test_everything_drawn_is_inside_the_axes():
    report = report_robot(ct.load_robot("ipanema1"))
    space = draw_robot(report).axes[0]
    for points in (report.robot.exit_points, report.shape.reshape(-1, 3)):
        for axis, (low, high) in enumerate((space.get_xlim(), space.get_ylim(), space.get_zlim())):
            assert low <= points[:, axis].min() and points[:, axis].max() <= high


@pytest.mark.parametrize("anchors", [np.zeros((8, 3)), np.outer(np.arange(8.0), [0.1, 0, 0])])
def test_platforms_without_extent_can_be_drawn(anchors):
    robot = ct.load_robot("cogiro")
    report = report_robot(robot)
    report = replace(report, robot=replace(robot, anchor_points=anchors))
    assert draw_robot(report).axes


def test_a_tilted_platform_is_drawn_where_it_is():
    robot = ct.load_robot("ipanema1")
    turned = Rotation.from_rotvec([0.1, -0.2, 0.1]).as_matrix()
    report = report_robot(replace(robot, home_rotation=turned))
    lines = draw_robot(report).axes[1].lines
    factor = 2  # as the legend says
    anchors = robot.home_position + factor * robot.anchor_points @ turned.T
    drawn = [line.get_xydata() for line in lines if line.get_xydata().shape == (8, 2)]
    assert any(np.allclose(points, anchors[:, :2]) for points in drawn)
