"""Robots whose cables are too soft for plans of rigid ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from baselines import KinematicSolverController, Mpc, MpcSettings
from baselines.mpc.premise import broken_premise, slowest_bounce
from carosac_toolkit.loop.values import Belief
from carosac_toolkit.robot.similar import similar_robot, similarity

NAMES = ("carosac", "scampi", "cogiro", "ipanema1", "desktop", "warehouse", "stadium")


@pytest.mark.parametrize("name", NAMES)
def test_bundled_robots_are_stiff_enough_at_any_size(name):
    robot = ct.load_robot(name)
    assert broken_premise(robot) is None
    for factor in (0.1, 10.0):
        other = similar_robot(robot, factor)
        assert slowest_bounce(other) == pytest.approx(
            slowest_bounce(robot) / similarity(factor).time, rel=1e-6
        )
        assert broken_premise(other) is None


def test_a_vertical_spring_bounces_at_its_frequency():
    """Four almost vertical cables of stiffness k carry m: the platform bounces at sqrt(4 k / m)."""
    robot = ct.load_robot("carosac")
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    anchors = np.column_stack([corners, np.zeros(4)])
    soft = replace(
        robot, exit_points=anchors * 1.01 + [0.0, 0.0, 8.0], anchor_points=anchors,
        home_position=np.zeros(3), workspace_min=-np.ones(3), workspace_max=np.ones(3),
        run_length=np.zeros(4), linear_density=np.full(4, 1e-4), axial_stiffness=np.full(4, 2e4),
        center_of_mass=np.array([0.0, 0.0, -0.1]),
    )  # fmt: skip
    frequency = np.sqrt(4.0 * 2e4 / 8.0 / soft.mass) / (2.0 * np.pi)
    assert slowest_bounce(soft) == pytest.approx(frequency, rel=0.02)


def test_mpc_follows_the_kinematic_solver_where_cables_are_soft_and_says_so():
    robot = replace(ct.load_robot("carosac"), axial_stiffness=np.full(4, 500.0))
    assert "bounces on its cables at" in str(broken_premise(robot))
    mpc, other = (
        Mpc.build(robot, MpcSettings(compiled="never")),
        KinematicSolverController.build(robot),
    )
    assert (
        mpc.remark == broken_premise(robot) and Mpc.build(ct.load_robot("carosac")).remark is None
    )
    path = ct.trajectories.build("circle", robot)
    belief = Belief(
        time=np.zeros(1), position=path.sample(np.zeros(1)).position, rotation=np.eye(3)[None]
    )
    for controller in (mpc, other):
        controller.reset(belief)
    sent = [c.command(belief, path.window(0.0, mpc.horizon, 0.02)) for c in (mpc, other)]
    np.testing.assert_array_equal(sent[0].unstrained_length, sent[1].unstrained_length)
