"""What MPC reads of a reference."""

from __future__ import annotations

import numpy as np
import pytest

import carosac_toolkit as ct
from baselines.mpc.target_reader import TargetReader
from carosac_toolkit.physics.rest import statics

GRID = np.array([0.0, 0.5, 1.0])


@pytest.fixture(scope="module")
def robot():
    return ct.load_robot("carosac")


def test_beyond_the_wall_where_there_is_no_rest_tensions_are_those_nearby(robot):
    """As a platform may start there, and equal shares of the weight would be far from the truth."""
    place = np.array([robot.workspace_max[0] + 0.3, *robot.home_position[1:]])
    assert not statics.inverse_kinematics(robot, place[None]).converged[0]
    inside = place - np.outer(np.linspace(0.0, 1.0, 201), place - robot.home_position)
    rest = statics.inverse_kinematics(robot, inside)
    nearest = rest.tension[rest.converged.argmax()]
    reader = TargetReader(robot, GRID)
    found = reader.at(place)
    assert reader.no_rest
    assert np.abs(found - nearest).max() < 0.1 * robot.weight / robot.n
    assert found.max() > 3.0 * found.min()  # the near cables carry almost all


def test_after_that_the_last_ones_are_kept(robot):
    reader = TargetReader(robot, GRID)
    last = reader.at(robot.home_position)
    assert reader.at(robot.home_position + np.array([0.0, 0.0, 50.0])) == pytest.approx(last)
    beyond = np.array([robot.workspace_max[0] + 0.3, *robot.home_position[1:]])
    assert reader.at(beyond) == pytest.approx(last)
    reader.reset()
    assert np.abs(reader.at(beyond) - last).max() > 0.5 * robot.weight / robot.n


def test_robots_of_more_cables_get_the_distribution_that_is_asked_for():
    robot = ct.load_robot("cogiro")
    beyond = np.array([*robot.home_position[:2], robot.workspace_max[2] + 2.0])
    assert not statics.inverse_kinematics(robot, beyond[None]).converged[0]
    found = [TargetReader(robot, GRID, kind).at(beyond) for kind in ("least_squares", "centre")]
    assert np.abs(found[0] - found[1]).max() > 0.01 * robot.weight / robot.n
