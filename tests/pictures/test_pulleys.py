from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit.inspection.report import report_robot
from carosac_toolkit.pictures.pulleys import draw_cables
from carosac_toolkit.pictures.robot import draw_robot
from tests.robots import simple_robot, with_pulleys


def legend(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def ends_of(report, times=1.0):
    """Anchor points at home of a platform drawn larger."""
    ends = report.shape[:, -1]
    return ends.mean(axis=0) + times * (ends - ends.mean(axis=0))


@pytest.mark.parametrize(
    ("radius", "smallest", "times"), [(0.3, 0.1, 1.0), (0.05, 0.2, 1.0), (0.3, 0.1, 3.0)]
)
def test_cables_lead_from_their_wheels_at_a_tangent_to_the_drawn_anchors(radius, smallest, times):
    report = report_robot(with_pulleys(simple_robot(), radius))
    larger = ends_of(report, times)
    for i, cable in enumerate(draw_cables(report, smallest, larger)):
        center = 0.5 * (cable.wheel[0] + cable.wheel[36])
        drawn = np.linalg.norm(cable.wheel - center, axis=1)
        assert drawn == pytest.approx(max(radius, smallest))
        assert cable.incoming[1] == pytest.approx(report.robot.exit_points[i])  # the datum
        assert cable.free[0] == pytest.approx(cable.incoming[-1])
        assert cable.free[-1] == pytest.approx(larger[i])
        leaving = cable.free[1] - cable.free[0]
        cosine = leaving @ (cable.free[0] - center)
        cosine /= np.linalg.norm(leaving) * np.linalg.norm(cable.free[0] - center)
        assert abs(cosine) < 0.01  # sag turns it by less
        arriving = cable.incoming[1] - cable.incoming[0]
        assert arriving / np.linalg.norm(arriving) == pytest.approx(report.robot.swivel_axis[i])


def test_pulleys_to_scale_are_drawn_as_they_hang():
    report = report_robot(with_pulleys(simple_robot(), 0.3))
    cables = draw_cables(report, 0.1, ends_of(report))
    assert np.array([cable.free for cable in cables]) == pytest.approx(report.shape, abs=1e-9)


def test_without_pulleys_only_the_cables_are_drawn():
    report = report_robot(simple_robot())
    assert all(len(cable.wheel) == 0 for cable in draw_cables(report, 0.1, ends_of(report)))
    assert not any("pulley" in text for text in legend(draw_robot(report)))


def test_the_legend_says_whether_pulleys_are_to_scale():
    robot = simple_robot()
    assert "pulleys, to scale" in legend(draw_robot(report_robot(with_pulleys(robot, 0.3))))
    small = legend(draw_robot(report_robot(with_pulleys(robot, 0.05))))
    assert any(text.startswith("pulleys, drawn with ") for text in small)


def test_a_robot_with_pulleys_and_no_equilibrium_can_be_drawn():
    robot = replace(with_pulleys(simple_robot(), 0.3), tension_max=np.full(4, 30.0))
    report = report_robot(robot)
    assert not report.equilibrium.converged[0]
    assert draw_robot(report).axes
    inside = report_robot(with_pulleys(simple_robot(), 9.0))
    assert draw_robot(inside).axes
