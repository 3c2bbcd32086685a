"""Bundled robots of other sizes move as fast as their files promise."""

import numpy as np
import pytest
from scipy.optimize import linprog

import carosac_toolkit as ct
from carosac_toolkit.base.scaled import resolved
from carosac_toolkit.drivers.sensors import SensorSettings
from carosac_toolkit.physics.rest import structure
from carosac_toolkit.physics.scales import Scales

ACCELERATION = {"desktop": 3.0, "stadium": 3.0, "warehouse": 2.0}  # [m/s^2], in the provenance


def corners(robot):
    sides = np.stack([robot.workspace_min, robot.workspace_max])
    return np.array([[sides[i, 0], sides[j, 1], sides[k, 2]] for i, j, k in np.ndindex(2, 2, 2)])


@pytest.mark.parametrize("name", ACCELERATION)
def test_robots_of_other_sizes_rest_within_their_limits_all_over_the_box(name):
    robot = ct.load_robot(name)
    rng = np.random.default_rng(0)
    inside = rng.uniform(robot.workspace_min, robot.workspace_max, (60, 3))
    position = np.concatenate([inside, corners(robot)])
    rest = ct.statics.inverse_kinematics(robot, position)
    assert rest.converged.all() and rest.stable.all() and rest.in_winch_range.all()
    assert not rest.slack.any() and (rest.tension <= robot.tension_max).all()
    back = ct.statics.forward_kinematics(robot, rest.unstrained_length)
    assert back.position == pytest.approx(position, abs=1e-7 * robot.exit_points[:, 2].max())


@pytest.mark.parametrize("name", ACCELERATION)
def test_robots_of_other_sizes_can_accelerate_as_promised_at_every_corner(name):
    robot = ct.load_robot(name)
    rows = 3 if robot.n < 6 else 6  # fewer than six cables: the attitude follows the force
    rest = ct.statics.inverse_kinematics(robot, corners(robot))
    matrices = structure.structure_matrix(robot, rest.position, rest.rotation)
    limits = list(zip(robot.tension_min, robot.tension_max, strict=True))
    for matrix, rotation in zip(matrices, rest.rotation, strict=True):
        for direction in np.concatenate([np.eye(3), -np.eye(3)]):
            force = robot.mass * (ACCELERATION[name] * direction + [0.0, 0.0, robot.gravity])
            moment = np.cross(rotation @ robot.center_of_mass, force)
            wrench = np.concatenate([force, moment])[:rows]
            answer = linprog(np.zeros(robot.n), A_eq=matrix[:rows], b_eq=wrench, bounds=limits)
            assert answer.status == 0


def test_the_plate_of_desktop_turns_instead_of_slackening_a_cable_by_errors_of_encoders():
    robot, rng = ct.load_robot("desktop"), np.random.default_rng(0)
    position = rng.uniform(robot.workspace_min, robot.workspace_max, (300, 3))
    length = ct.statics.inverse_kinematics(robot, position).unstrained_length
    error = resolved(SensorSettings(), Scales(robot).ratios).encoder_bias
    erring = length + error * rng.standard_normal(length.shape)
    rest = ct.statics.forward_kinematics(robot, erring)
    assert rest.converged.all() and not rest.slack.any()


def test_warehouse_is_the_robot_with_pulleys():
    with_pulleys = [n for n in ct.list_robots() if (ct.load_robot(n).pulley_radius > 0.0).any()]
    assert with_pulleys == ["warehouse"]
