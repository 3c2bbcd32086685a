import re
from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.inspection.report import report_robot
from carosac_toolkit.robot.file import parse_file, robot_text
from tests.robots import eight_cable_robot, hanging, simple_robot, with_pulleys


def text_report(text):
    robot, file = parse_file(text)
    return report_robot(robot, file)


@pytest.mark.parametrize("name", ct.list_robots())
def test_bundled_robots_have_no_findings(name):
    report = text_report(robot_text(name))
    assert report.problems == () and report.warnings == ()


def test_lengths_that_a_winch_cannot_wind_are_named_with_the_exact_need():
    robot = simple_robot()
    need = report_robot(robot).equilibrium.unstrained_length[0]
    limit = robot.length_max.copy()
    limit[2] = need[2] - 1e-4
    report = report_robot(replace(robot, length_max=limit))
    (problem,) = report.problems
    assert problem == (
        f"cable cable3 needs {need[2]:.4f} m of unstrained length at home; its winch has "
        f"length_min to length_max = 0.1 to {limit[2]:g} m"
    )
    assert not report.feasible
    limit[2] = need[2] + 1e-4
    assert report_robot(replace(robot, length_max=limit)).feasible


def test_the_arc_on_a_pulley_counts_as_needed_length():
    robot = with_pulleys(simple_robot(), 0.3)
    need = report_robot(robot).equilibrium.unstrained_length[0]
    short = need - report_robot(simple_robot()).equilibrium.unstrained_length[0]
    assert (short > 0.3).all()  # most of 0.3 m times the wrap
    report = report_robot(replace(robot, length_max=need - 0.1))
    assert len(report.problems) == 4
    assert f"cable cable1 needs {need[0]:.4f} m" in report.problems[0]


def test_tensions_that_would_be_needed_are_named_with_their_limits():
    robot = simple_robot()
    need = report_robot(robot).equilibrium.tension[0]
    low = report_robot(replace(robot, tension_max=np.full(4, 30.0)))
    high = report_robot(replace(robot, tension_min=np.full(4, 110.0)))
    for report, limit in ((low, "maximum is 30 N"), (high, "minimum is 110 N")):
        assert report.problems == (
            "no tensions within the limits found",
            *(
                f"cable cable{i + 1} would need {need[i]:.1f} N at home, its {limit}"
                for i in range(4)
            ),
        )


def test_a_home_that_no_cable_pulls_to_is_said_to_be_outside():
    robot = simple_robot(home_position=[6.0, -1.8, 2.0])
    problems = " ".join(report_robot(robot).problems)
    assert "m outside the exit points as seen from above" in problems
    robot = simple_robot(home_position=[0.4, -1.8, 9.0])
    assert "home is above all exit points" in " ".join(report_robot(robot).problems)


def test_anchor_points_that_coincide_show_as_rank():
    report = report_robot(eight_cable_robot(anchor_points=np.zeros((8, 3))))
    (warning,) = [text for text in report.warnings if "rank" in text]
    assert "has rank 3 of 6: anchor points coincide" in warning
    line = np.outer(np.linspace(-0.2, 0.2, 8), [1.0, 0.0, 0.0])
    report = report_robot(eight_cable_robot(anchor_points=line))
    assert "has rank 5 of 6: anchor points lie on one line" in " ".join(report.warnings)


def test_an_unstable_home_is_explained():
    report = report_robot(eight_cable_robot(center_of_mass=[0.0, 0.0, 30.0]))
    assert report.equilibrium.converged[0] and not report.feasible
    assert "negative natural frequency grows instead of oscillating" in report.problems[0]
    assert report.data()["home"]["stable"] is False


def test_without_an_equilibrium_nothing_is_said_to_be_stable():
    report = report_robot(eight_cable_robot(tension_max=np.full(8, 6.0)))
    home = report.data()["home"]
    assert home["feasible"] is False and home["converged"] is False and home["stable"] is None


def test_a_point_in_millimetres_is_suspected():
    robot = simple_robot()
    points = robot.exit_points.copy()
    points[1] *= 1000.0
    warning = report_robot(replace(robot, exit_points=points)).warnings[0]
    assert "the exit point of cable cable2" in warning and "is it in mm?" in warning
    anchors = robot.anchor_points.copy()
    anchors[0] *= 1000.0
    warning = report_robot(replace(robot, anchor_points=anchors)).warnings[0]
    assert "the anchor point of cable cable1" in warning


def test_deep_sag_is_suspected():
    report = report_robot(simple_robot(linear_density=np.full(4, 6.0)))
    assert (report.sag > 0.1 * report.equilibrium.unstrained_length[0]).all()
    assert sum("more than a tenth of its" in text for text in report.warnings) == 4


def test_more_than_half_a_turn_on_a_pulley_is_suspected():
    robot = simple_robot()
    away = robot.exit_points - robot.home_position - robot.anchor_points
    away /= np.linalg.norm(away, axis=1)[:, None]
    report = report_robot(
        replace(robot, pulley_radius=np.full(4, 0.1), swivel_axis=away)  # back along the cable
    )
    assert (report.wrap > np.pi).all()
    assert sum("more than half a turn" in text for text in report.warnings) == 4
    assert not report_robot(with_pulleys(robot)).warnings


def test_a_platform_upside_down_is_suspected():
    report = report_robot(simple_robot(center_of_mass=[0.0, 0.0, 2.0]))
    assert report.tilt > np.radians(150.0)
    assert "is center_of_mass right?" in report.warnings[0]


def test_an_anchor_point_inside_its_pulley_is_a_problem():
    report = report_robot(with_pulleys(simple_robot(), 9.0))
    assert "inside its pulley of 9 m radius: is the radius in mm?" in report.problems[0]


def test_parts_that_no_chain_uses_are_named():
    text = robot_text("carosac")
    text = text.replace("platform:\n", "    spare: {position: [0, 0, 8]}\nplatform:\n", 1)
    text = text.replace("  air_drag:", "    hook: [0, 0, 0.1]\n  air_drag:")
    text = re.sub(r"  rope:\n((?:    .*\n)+)", r"  rope:\n\1  wire:\n\1", text)
    text = re.sub(r"  winch:\n((?:    .*\n)+)", r"  winch:\n\1  small:\n\1", text)
    text = text.replace("  cable_types.rope.linear_density:", "  cable_types.wire: none\n"
                        "  winches.small: none\n  cable_types.rope.linear_density:")  # fmt: skip
    assert text_report(text).warnings == tuple(
        f"{name} is used by no chain"
        for name in ("frame.exit_points.spare", "platform.anchor_points.hook", "cable_types.wire",
                     "winches.small")
    )  # fmt: skip


def test_the_wrap_leads_to_the_first_point_of_the_cable():
    robot = with_pulleys(simple_robot(), 0.3)
    report = report_robot(robot)
    anchors = report.shape[:, -1]
    axis = robot.swivel_axis
    outward = anchors - robot.exit_points
    outward -= np.einsum("ni,ni->n", outward, axis)[:, None] * axis
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    cosine, sine = np.cos(report.wrap)[:, None], np.sin(report.wrap)[:, None]
    tangent = robot.exit_points + 0.3 * (outward * (1.0 - cosine) + sine * axis)
    assert report.shape[:, 0] == pytest.approx(tangent, abs=1e-9)
    assert report.wrap == pytest.approx(report.straight.wrap[0], abs=0.02)  # they hang a little


def test_two_cables_with_home_beside_their_plane_get_the_nearest_position_of_rest():
    robot = hanging(2)
    assert report_robot(robot).feasible
    beside = report_robot(replace(robot, home_position=np.array([0.0, 0.3, 2.0])))
    assert not beside.feasible
    (found,) = [text for text in beside.problems if text.startswith("two cables")]
    assert found.endswith("the nearest position of rest is (0, 0, 2) m, 0.3 m from home")


def test_the_motion_that_nothing_restores_is_named():
    robot = hanging(2)
    report = report_robot(replace(robot, anchor_points=np.zeros((2, 3))))
    (problem,) = report.problems
    assert problem.endswith("a natural frequency is zero, so no force restores the pose; the "
                            "platform turns freely about (0, 0, 1)")  # fmt: skip
