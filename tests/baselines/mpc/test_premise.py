"""Robots whose cables sag too much for plans of taut ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from baselines import KinematicSolverController, Mpc, MpcSettings
from baselines.mpc.premise import broken_premise
from carosac_toolkit.loop.values import Belief
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.robot.similar import similar_robot

NAMES = ("carosac", "scampi", "cogiro", "ipanema1", "desktop", "warehouse", "stadium")


def heavy(share: float) -> ct.Robot:
    """The robot with cables whose weight is that share of what each pulls with at home."""
    robot = ct.load_robot("carosac")
    for _ in range(20):  # heavier cables pull harder
        rest = statics.inverse_kinematics(robot, robot.home_position[None])
        weight = robot.weight_per_length * rest.unstrained_length[0]
        factor = share * rest.tension[0].min() / weight.max()
        robot = replace(robot, linear_density=robot.linear_density * factor)
    return robot


@pytest.mark.parametrize("name", NAMES)
def test_cables_of_bundled_robots_are_taut_enough_at_any_size(name):
    for factor in (0.1, 1.0, 10.0):
        assert broken_premise(similar_robot(ct.load_robot(name), factor)) is None


@pytest.mark.parametrize("factor", [0.1, 1.0, 10.0])
def test_cables_that_pull_with_their_own_weight_are_not_taut(factor):
    assert broken_premise(similar_robot(heavy(0.5), factor)) is None
    told = str(broken_premise(similar_robot(heavy(1.0), factor)))
    assert "times its own weight at home" in told and "plans of taut cables need 1.5" in told


def test_mpc_follows_the_kinematic_solver_where_cables_are_not_taut_and_says_so():
    robot = heavy(1.0)
    mpc = Mpc.build(robot, MpcSettings(compiled="never"))
    other = KinematicSolverController.build(robot)
    assert mpc.remark == broken_premise(robot)
    path = ct.trajectories.build("circle", robot)
    belief = Belief(
        time=np.zeros(1), position=path.sample(np.zeros(1)).position, rotation=np.eye(3)[None]
    )
    for controller in (mpc, other):
        controller.reset(belief)
    sent = [c.command(belief, path.window(0.0, mpc.horizon, 0.02)) for c in (mpc, other)]
    np.testing.assert_array_equal(sent[0].unstrained_length, sent[1].unstrained_length)
