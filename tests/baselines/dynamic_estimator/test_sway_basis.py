from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from baselines.dynamic_estimator.sway_basis import count_ways, sway_at
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.physics.rest.modes import mass_matrix, natural_modes

POSITION = np.array([0.9, -2.2, 2.0])
TURN = Rotation.from_rotvec([0.2, -0.15, 0.1]).as_matrix()


def sway_of(robot):
    home = ct.statics.inverse_kinematics(robot, robot.home_position[None])
    return sway_at(
        robot, POSITION, TURN, home.unstrained_length[0], home.tension[0], max(0, 6 - robot.n)
    )


def lengths(robot, pose):
    turn = Rotation.from_rotvec(pose[3:]).as_matrix() @ TURN
    return straight_length(robot, (POSITION + pose[:3])[None], turn[None]).length[0]


def change(robot, pose):
    """Central difference of straight lengths along a pose error."""
    step = 1e-6
    return (lengths(robot, step * pose) - lengths(robot, -step * pose)) / (2.0 * step)


def test_a_sway_leaves_all_lengths_as_they_are():
    robot = ct.load_robot("carosac")
    ways = sway_of(robot).ways
    assert ways.shape == (6, 2)
    for way in ways.T:
        assert change(robot, way) == pytest.approx(0.0, abs=1e-6)


def test_a_slaved_pose_takes_up_the_shortening_of_one_cable():
    robot = ct.load_robot("carosac")
    slaved = sway_of(robot).slaved
    moved = np.stack([change(robot, column) for column in slaved.T], axis=1)
    assert moved == pytest.approx(-np.eye(4), abs=1e-6)


def test_sway_and_slaved_pose_have_no_momentum_in_common():
    robot = ct.load_robot("carosac")
    sway = sway_of(robot)
    home = ct.statics.inverse_kinematics(robot, robot.home_position[None])
    mass = mass_matrix(robot, TURN[None], home.unstrained_length)[0]
    assert sway.ways.T @ mass @ sway.ways == pytest.approx(np.eye(2), abs=1e-9)
    assert sway.momentum @ sway.slaved == pytest.approx(np.zeros((2, 4)), abs=1e-9)


def near_a_face():
    """Equilibrium of scampi where its third mode has 3 Hz, on cables that sag."""
    robot = ct.load_robot("scampi")
    return robot, ct.statics.inverse_kinematics(robot, [[-0.39, -4.63, 1.81]])


def sway_near_a_face(count):
    robot, rest = near_a_face()
    return sway_at(
        robot, rest.position[0], rest.rotation[0], rest.unstrained_length[0], rest.tension[0],
        count,
    )  # fmt: skip


@pytest.mark.parametrize("count", [3, 4, 6])
def test_slow_motions_on_sagging_cables_are_ways_to_sway(count):
    """The ways hold the slowest modes of the platform, whose stiffness is that of statics."""
    robot, rest = near_a_face()
    sway = sway_near_a_face(count)
    modes = natural_modes(robot, rest)
    slow = modes.shape[0][:, :count]
    inside = np.linalg.norm(sway.momentum @ slow, axis=0)  # share of each that they hold
    assert inside == pytest.approx(1.0, abs=0.02)
    squares = np.linalg.eigvalsh(sway.ways.T @ rest.stiffness[0] @ sway.ways)
    frequency = np.sqrt(squares) / (2.0 * np.pi)
    assert frequency == pytest.approx(modes.frequency[0, :count], rel=0.05)


def test_a_robot_of_stiff_cables_has_no_more_ways_than_cables_leave():
    robot = ct.load_robot("carosac")
    stiff = replace(
        robot, axial_stiffness=1e3 * robot.axial_stiffness,
        linear_density=1e-3 * robot.linear_density,
    )  # fmt: skip
    assert count_ways(stiff) == 2 < count_ways(robot)


def test_eight_cables_leave_no_way_to_sway():
    robot = ct.load_robot("cogiro")
    sway = sway_of(robot)
    assert sway.ways.shape == (6, 0)
    pose = np.array([0.1, -0.2, 0.3, 0.05, 0.02, -0.01])
    assert sway.slaved @ -change(robot, pose) == pytest.approx(pose, abs=1e-6)
