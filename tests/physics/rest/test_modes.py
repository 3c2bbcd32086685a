"""Natural frequencies against pin and against finite differences of the wrench."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from carosac_toolkit.physics.rest import modes, statics
from carosac_toolkit.robot.robot import RigidBody, combine_bodies
from tests import reference
from tests.robots import eight_cable_robot, simple_robot, with_pulleys


def test_mass_matrix_agrees_with_pin_at_rotated_poses():
    robot = simple_robot()
    rotation = Rotation.random(20, rng=np.random.default_rng(0)).as_matrix()
    mass = modes.mass_matrix(robot, rotation)
    for k in range(20):
        assert mass[k] == pytest.approx(reference.mass_matrix(robot, rotation[k]), abs=1e-12)


@pytest.mark.parametrize("robot", [simple_robot(), with_pulleys(simple_robot())])
def test_frequencies_are_those_of_finite_differences_and_pin(robot):
    """K from the wrench of the independent cable equations, M from pin."""
    equilibrium = statics.inverse_kinematics(robot, robot.home_position[None] + [[0.5, -0.7, 0.4]])
    assert equilibrium.converged[0]
    stiffness = difference_of_wrench(robot, equilibrium)
    mass = reference.mass_matrix(robot, equilibrium.rotation[0])
    values = eigh(stiffness, mass, eigvals_only=True)
    expected = np.sqrt(values) / (2.0 * np.pi)
    bare = modes.natural_frequencies(robot, equilibrium, cable_mass=False)[0]
    assert bare == pytest.approx(expected, rel=1e-5)


def test_a_third_of_each_cable_rides_at_its_anchor_point():
    """Point masses there as payloads, of which pin knows nothing but a heavier platform."""
    robot = simple_robot()
    equilibrium = statics.inverse_kinematics(robot, robot.home_position[None] + [[0.5, -0.7, 0.4]])
    length = equilibrium.unstrained_length
    riding = robot.linear_density * length[0] / 3.0
    parts = [RigidBody(robot.mass, robot.center_of_mass, robot.inertia)]
    parts += [
        RigidBody(m, b, np.zeros((3, 3))) for m, b in zip(riding, robot.anchor_points, strict=True)
    ]
    heavy = combine_bodies(parts)
    loaded = replace(
        robot, mass=heavy.mass, center_of_mass=heavy.center_of_mass, inertia=heavy.inertia
    )
    mass = modes.mass_matrix(robot, equilibrium.rotation, length)[0]
    expected = reference.mass_matrix(loaded, equilibrium.rotation[0])
    assert mass == pytest.approx(expected, abs=1e-12)


def difference_of_wrench(robot, result):
    """-d wrench / d pose at constant lengths, cables solved by the independent closure."""
    step = 1e-5
    columns = []
    for k in range(6):
        ends = []
        for sign in (1.0, -1.0):
            twist = np.zeros(6)
            twist[k] = sign * step
            turn = Rotation.from_rotvec(twist[3:]).as_matrix()
            ends.append(
                reference.cable_wrench(
                    robot,
                    result.unstrained_length[0],
                    result.position[0] + twist[:3],
                    turn @ result.rotation[0],
                    result.exit_tension[0],
                )
            )
        columns.append((ends[1] - ends[0]) / (2.0 * step))
    matrix = np.stack(columns, axis=1)
    return 0.5 * (matrix + matrix.T)


def test_frequencies_of_the_bundled_robot_lie_where_others_found_them():
    """Two slow sway modes near 0.45 and 1.56 Hz, four stretching ones above 4 Hz."""
    robot = ct.load_robot("carosac")
    equilibrium = statics.inverse_kinematics(robot, robot.home_position[None])
    frequency = modes.natural_frequencies(robot, equilibrium)[0]
    assert frequency[:2] == pytest.approx([0.45, 1.56], rel=0.02)
    assert (frequency[2:] > 4.0).all()


def test_an_unstable_pose_has_negative_frequencies():
    """A suspended platform with its mass 3 m above the origin, on soft cables, tips over."""
    robot = ct.load_robot("cogiro")
    soft = replace(robot, axial_stiffness=robot.axial_stiffness / 100.0)
    for height, stable in ((0.0, True), (3.0, False)):
        variant = replace(soft, center_of_mass=np.array([0.0, 0.0, height]))
        equilibrium = statics.inverse_kinematics(variant, variant.home_position[None])
        assert equilibrium.converged[0]
        assert equilibrium.stable[0] == stable
        assert (modes.natural_frequencies(variant, equilibrium)[0, 0] > 0.0) == stable


def test_a_pendulum_swings_along_x_and_y_turns_about_z_and_bounces_along_z():
    robot = simple_robot(
        exit_points=[[s, t, 8.0] for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))],
        anchor_points=[[0.5 * s, 0.5 * t, 0] for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))],
        home_position=np.array([0.0, 0.0, 2.0]), workspace_min=np.array([-1.0, -1.0, 1.0]),
        workspace_max=np.array([1.0, 1.0, 4.0]),
    )  # fmt: skip
    rest = statics.inverse_kinematics(robot, robot.home_position[None])
    found = modes.natural_modes(robot, rest)
    (names,) = modes.main_directions(robot, rest.rotation, found.shape)
    assert sorted(names) == sorted(modes.DIRECTION_NAMES)
    bounce = found.frequency[0, names.index("z")]
    stiffness = (robot.axial_stiffness / (rest.unstrained_length[0] + robot.run_length)).sum()
    upright = (6.0 / np.sqrt(6.0**2 + 0.5)) ** 2  # share of the stiffness along z
    expected = np.sqrt(stiffness * upright / robot.mass) / (2.0 * np.pi)
    assert bounce == pytest.approx(expected, rel=0.02)


def test_modes_diagonalise_mass_and_stiffness():
    robot = eight_cable_robot()
    equilibrium = statics.inverse_kinematics(robot, robot.home_position[None])
    result = modes.natural_modes(robot, equilibrium)
    shape = result.shape[0]
    mass = modes.mass_matrix(robot, equilibrium.rotation, equilibrium.unstrained_length)[0]
    assert shape.T @ mass @ shape == pytest.approx(np.eye(6), abs=1e-9)
    squares = (2.0 * np.pi * result.frequency[0]) ** 2
    reduced = shape.T @ equilibrium.stiffness[0] @ shape
    assert reduced == pytest.approx(np.diag(squares), abs=1e-9 * squares.max())
