"""Cables between known poses hang as the statics say, also where the platform is not at rest."""

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics.cable.shapes import hanging_cables
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.robot.file import load_robot


@pytest.mark.parametrize("name", ["scampi", "ipanema1"])
def test_at_rest_shapes_and_tensions_are_those_of_the_equilibrium(name):
    robot = load_robot(name)
    where = robot.home_position[None] + np.array([[0.1, -0.2, 0.1]])
    rest = statics.inverse_kinematics(robot, where)
    hanging = hanging_cables(robot, rest.position, rest.rotation, rest.unstrained_length)
    assert hanging.valid.all()
    assert hanging.tension == pytest.approx(rest.tension, rel=1e-7)
    assert hanging.points == pytest.approx(statics.cable_shape(robot, rest, 24), abs=1e-8)


def test_off_rest_every_cable_still_runs_from_its_exit_to_its_anchor():
    robot = load_robot("scampi")
    rest = statics.inverse_kinematics(robot, robot.home_position[None])
    turn = rest.rotation @ [[0.995, -0.0998334, 0.0], [0.0998334, 0.995, 0.0], [0.0, 0.0, 1.0]]
    turn = np.linalg.svd(turn)[0] @ np.linalg.svd(turn)[2]
    lifted = rest.position + np.array([[0.0, 0.0, 0.3]])  # all cables are too long now
    hanging = hanging_cables(robot, lifted, turn, rest.unstrained_length)
    assert hanging.valid.all()
    assert hanging.points[0, :, 0] == pytest.approx(robot.exit_points, abs=1e-9)
    anchors = lifted[0] + robot.anchor_points @ turn[0].T
    assert hanging.points[0, :, -1] == pytest.approx(anchors, abs=1e-9)
    assert (hanging.tension < rest.tension).all()
    strained = np.linalg.norm(np.diff(hanging.points[0], axis=1), axis=2).sum(axis=1)
    assert strained == pytest.approx(rest.unstrained_length[0], rel=1e-3)


def test_a_cable_without_length_is_reported_and_the_others_stand():
    robot = load_robot("scampi")
    rest = statics.inverse_kinematics(robot, robot.home_position[None])
    length = rest.unstrained_length.copy()
    length[0, 2] = np.nan
    hanging = hanging_cables(robot, rest.position, rest.rotation, length)
    assert hanging.valid.tolist() == [[True, True, False, True]]
    assert np.isnan(hanging.points[0, 2]).all() and np.isfinite(hanging.points[0, 3]).all()


def test_wrong_shapes_are_named():
    robot = load_robot("scampi")
    pose = Pose(position=np.zeros((1, 3)), rotation=np.eye(3)[None])
    with pytest.raises(InvalidField, match=r"rotation and unstrained_length"):
        hanging_cables(robot, pose.position, pose.rotation, np.ones((1, 3)))
