from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.robot.parameter_names import check_names, unit_of
from carosac_toolkit.robot.parameters import values_of, with_values
from tests.robots import simple_robot

NAMES = (
    "exit_points[cable2].y", "anchor_points[cable4].z", "length_offset[cable1]",
    "length_scale[cable3]", "drum_radius[cable2]", "drum_buildup[cable3]",
    "axial_stiffness[cable1]", "linear_density[cable2]", "axial_damping[cable4]",
    "run_length[cable3]", "length_delay", "pose_tilt.x", "pose_tilt.y", "mass", "drag",
    "angular_drag", "center_of_mass.x", "inertia.xx", "inertia.xy", "inertia.yz",
    "angular_drag_axes.y", "cable_drag", "exit_friction[cable1]", "anchor_friction[cable2]",
    "capstan_friction", "length_hysteresis[cable3]",
)  # fmt: skip
TURN = Rotation.from_euler("zyx", [70.0, 3.0, -2.0], degrees=True).as_matrix()


def calibrated_robot(**changes):
    """A robot with drums and calibrated sensors, whose measured poses are turned and tilted."""
    known = {
        "drum_radius": [0.1] * 4,
        "drum_buildup": [1e-4] * 4,
        "drum_gear": [10.0] * 4,
        "length_offset": [0.1, -0.2, 0.3, 0.0],
        "length_scale": [1.0, 1.001, 0.999, 1.002],
        "length_delay": 0.03,
        "cable_drag": 0.4,
        "pose_rotation": TURN,
        "inertia": [[0.6, 0.01, 0.02], [0.01, 0.7, 0.03], [0.02, 0.03, 0.8]],
    }
    return simple_robot(**(known | changes))


def fields_that_differ(a, b):
    known = {name: (getattr(a, name), getattr(b, name)) for name in vars(a)}
    return {
        name
        for name, (x, y) in known.items()
        if (x is None) != (y is None)
        or (x is not None and not (np.allclose(x, y, atol=1e-14) if name in NUMBERS else x == y))
    }


NUMBERS = {name for name, value in vars(calibrated_robot()).items() if not isinstance(value, str)}
NUMBERS -= {"cable_names", "provenance", "calibrated", "calibration_covariance"}


def test_writing_back_what_was_read_changes_nothing():
    robot = calibrated_robot()
    again = with_values(robot, NAMES, values_of(robot, NAMES))
    assert fields_that_differ(robot, again) == set()


@pytest.mark.parametrize("name", NAMES)
def test_a_parameter_that_was_written_is_read_back_and_moves_its_own_field_alone(name):
    robot = calibrated_robot()
    wanted = values_of(robot, [name]) * 1.01 + 1e-3
    moved = with_values(robot, [name], wanted)
    assert values_of(moved, [name]) == pytest.approx(wanted, rel=1e-12)
    field = "pose_rotation" if name.startswith("pose_tilt") else name.split("[")[0].split(".")[0]
    assert fields_that_differ(robot, moved) == {field}
    others = [other for other in NAMES if other != name]
    assert values_of(moved, others) == pytest.approx(values_of(robot, others), rel=1e-12)


def test_products_of_inertia_stay_symmetric():
    moved = with_values(calibrated_robot(), ["inertia.xz"], np.array([0.04]))
    assert moved.inertia[0, 2] == moved.inertia[2, 0] == 0.04


@pytest.mark.parametrize("tilt", [[0.0, 0.0], [4e-3, -7e-3], [0.6, 1.1]])
def test_a_tilt_is_a_rotation_vector_in_the_horizontal_plane(tilt):
    robot = with_values(simple_robot(), ["pose_tilt.x", "pose_tilt.y"], np.array(tilt))
    expected = Rotation.from_rotvec([*tilt, 0.0]).as_matrix()
    assert robot.pose_rotation == pytest.approx(expected, abs=1e-14)
    assert values_of(robot, ["pose_tilt.x", "pose_tilt.y"]) == pytest.approx(tilt, abs=1e-14)


def test_a_small_tilt_leans_the_vertical_by_itself():
    tilt = np.array([3e-4, -5e-4])
    robot = with_values(simple_robot(), ["pose_tilt.x", "pose_tilt.y"], tilt)
    assert robot.pose_rotation[:, 2] == pytest.approx([tilt[1], -tilt[0], 1.0], abs=1e-6)


def test_another_tilt_keeps_the_turn_about_the_vertical():
    robot = with_values(calibrated_robot(), ["pose_tilt.x", "pose_tilt.y"], np.zeros(2))
    about_z = Rotation.from_matrix(robot.pose_rotation).as_rotvec()
    assert about_z[:2] == pytest.approx([0.0, 0.0], abs=1e-12)
    assert abs(np.degrees(about_z[2]) - 70.0) < 0.2  # but for the order of turn and tilt


def test_one_name_stands_for_all_cables_that_share_a_number():
    robot = with_values(simple_robot(), ["axial_stiffness"], np.array([2e5]))
    assert (robot.axial_stiffness == 2e5).all()
    assert values_of(robot, ["axial_stiffness"]) == pytest.approx([2e5])
    mixed = replace(robot, axial_stiffness=[2e5, 2e5, 3e5, 2e5])
    with pytest.raises(InvalidField, match=r"axial_stiffness\[cable1\]: they differ"):
        values_of(mixed, ["axial_stiffness"])


def test_sensors_that_were_not_calibrated_read_what_is_there():
    names = ["length_offset[cable1]", "length_scale[cable1]", "length_delay", "pose_tilt.x"]
    assert values_of(simple_robot(), names) == pytest.approx([0.0, 1.0, 0.0, 0.0])
    robot = with_values(simple_robot(), ["length_offset[cable2]"], np.array([0.5]))
    assert robot.length_offset.tolist() == [0.0, 0.5, 0.0, 0.0]
    assert robot.length_scale.tolist() == [1.0] * 4 and robot.length_delay == 0.0


def test_other_values_drop_what_was_known_of_the_old_ones():
    robot = calibrated_robot(calibrated=("mass",), calibration_covariance=[[1.0]])
    moved = with_values(robot, ["mass"], np.array([20.0]))
    assert moved.calibrated is None and moved.calibration_covariance is None


def test_units_are_those_of_robot_files():
    assert unit_of("exit_points[any].x") == "m"
    assert unit_of("axial_damping") == "N*s"
    assert unit_of("inertia.yz") == "kg*m^2"
    with pytest.raises(InvalidField, match="parameter: got 'colour'; allowed: a name such as"):
        unit_of("colour")
    with pytest.raises(InvalidField, match=r"parameter: got '\?\?'"):
        unit_of("??")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("exit_points[cable9].x", "a cable of .*cable1"),
        ("colour", "a name such as exit_points"),
        ("exit points", "a name such as exit_points"),
        ("exit_points.x", "listed in carosac_toolkit.robot.parameters"),
        ("exit_points[cable1]", "listed in carosac_toolkit.robot.parameters"),
        ("length_offset", "listed in carosac_toolkit.robot.parameters"),
        ("mass[cable1]", "listed in carosac_toolkit.robot.parameters"),
        ("pose_tilt.z", "listed in carosac_toolkit.robot.parameters"),
        ("inertia.zy", "listed in carosac_toolkit.robot.parameters"),
        ("drum_radius[cable1]", "one that robot 'simple' has"),
    ],
)
def test_what_is_no_parameter_of_the_robot_is_named(name, message):
    with pytest.raises(InvalidField, match=message):
        values_of(simple_robot(), [name])
    with pytest.raises(InvalidField, match=message):
        with_values(simple_robot(), [name], np.array([1.0]))


def test_a_value_that_no_robot_can_have_is_named():
    with pytest.raises(InvalidField, match="mass: got -1"):
        with_values(simple_robot(), ["mass"], np.array([-1.0]))
    with pytest.raises(InvalidField, match=r"length_scale\[2\]: got 0"):
        with_values(simple_robot(), ["length_scale[cable3]"], np.array([0.0]))


def test_parameters_come_once_each():
    with pytest.raises(InvalidField, match=r"parameters\[2\]: got 'mass'; allowed: .* once"):
        check_names(("a",), ["mass", "drag", "mass"])
    check_names(("a.b]",), ["exit_points[a.b]].x"])  # a cable's name may hold anything


def test_an_unknown_drag_of_cables_has_no_value():
    with pytest.raises(InvalidField, match="parameter: got 'cable_drag'; allowed: one that robot"):
        values_of(simple_robot(), ["cable_drag"])
