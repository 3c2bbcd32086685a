from dataclasses import replace

import numpy as np
import pytest
from matplotlib.text import Annotation
from mpl_toolkits.mplot3d.proj3d import proj_transform
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from carosac_toolkit.inspection.report import report_robot
from carosac_toolkit.pictures.point_names import DISTANCES_POINTS
from carosac_toolkit.pictures.robot import draw_robot
from tests.pictures.layout import laid_out, texts_of


@pytest.mark.parametrize("name", ["carosac", "cogiro"])
def test_axes_have_units_and_names_are_written(name):
    report = report_robot(ct.load_robot(name))
    figure = draw_robot(report)
    space, *planes = figure.axes
    upright, *names = [text.get_text() for text in space.texts]
    assert [space.get_xlabel(), space.get_ylabel(), upright] == ["x [m]", "y [m]", "z [m]"]
    assert all(plane.get_xlabel().endswith("[m]") for plane in planes)
    assert len(planes) == 2
    assert ", ".join(names).split(", ") == list(report.robot.cable_names)


@pytest.mark.parametrize("name", ["carosac", "stadium", "ipanema1"])
def test_names_and_the_upright_label_are_near_their_marks_and_cover_nothing(name):
    report = report_robot(ct.load_robot(name))
    figure = laid_out(draw_robot(report))
    space = figure.axes[0]
    texts = {text: box for text, box in texts_of(figure) if isinstance(text, Annotation)}
    assert len(texts) == 1 + report.robot.n
    drawn = space.transData.transform(projected(space, report.shape.reshape(-1, 3)))
    for text, box in texts.items():
        mark = space.transData.transform(text.xy)
        away = np.maximum(box.min - mark, mark - box.max).clip(min=0.0)
        assert np.hypot(*away) < 1.5 * DISTANCES_POINTS[-1] * figure.dpi / 72.0, text.get_text()
        inside = ((drawn > box.min) & (drawn < box.max)).all(axis=1)
        assert not inside.any(), text.get_text()


def projected(axes, points):
    """Points of a view in three dimensions in its plane."""
    return np.column_stack(proj_transform(*points.T, axes.get_proj())[:2])


@pytest.mark.parametrize("name", ["stadium", "ipanema1"])
def test_cables_end_at_the_drawn_anchors_of_a_platform_drawn_larger(name):
    report = report_robot(ct.load_robot(name))
    space = draw_robot(report).axes[0]
    anchors = next(
        np.array(marks._offsets3d).T
        for marks in space.collections
        if str(marks.get_label()).startswith("anchor points")
    )
    points = report.shape.shape[1]
    cables = [line for line in space.lines if len(line.get_data_3d()[0]) == points]
    ends = np.array([[coordinate[-1] for coordinate in line.get_data_3d()] for line in cables])
    assert ends == pytest.approx(anchors)


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
