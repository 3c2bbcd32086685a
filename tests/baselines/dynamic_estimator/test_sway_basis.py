import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from baselines.dynamic_estimator.sway_basis import sway_at
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.physics.rest.modes import mass_matrix

POSITION = np.array([0.9, -2.2, 2.0])
TURN = Rotation.from_rotvec([0.2, -0.15, 0.1]).as_matrix()


def sway_of(robot):
    home = ct.statics.inverse_kinematics(robot, robot.home_position[None])
    return sway_at(robot, POSITION, TURN, home.unstrained_length[0])


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


def test_eight_cables_leave_no_way_to_sway():
    robot = ct.load_robot("cogiro")
    sway = sway_of(robot)
    assert sway.ways.shape == (6, 0)
    pose = np.array([0.1, -0.2, 0.3, 0.05, 0.02, -0.01])
    assert sway.slaved @ -change(robot, pose) == pytest.approx(pose, abs=1e-6)
