"""Statics at its edges: bad guesses, tension limits of zero, large batches, true answers."""

from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics import device
from carosac_toolkit.physics.rest import statics
from tests import reference
from tests.robots import simple_robot


@pytest.mark.parametrize("rotation", [2.0 * np.eye(3), -np.eye(3), np.zeros((3, 3))])
def test_a_guess_that_is_no_rotation_is_refused(rotation):
    with pytest.raises(InvalidField, match=r"rotation\[0\]: got not a rotation matrix"):
        Pose(position=np.zeros((1, 3)), rotation=rotation[None])


def test_a_guess_that_is_not_finite_is_refused():
    robot = simple_robot()
    equilibrium = statics.inverse_kinematics(robot, robot.home_position[None])
    broken = replace(equilibrium, position=np.full((1, 3), np.nan))
    with pytest.raises(InvalidField, match="guess: got numbers that are not finite"):
        statics.forward_kinematics(robot, equilibrium.unstrained_length, guess=broken)


@pytest.mark.parametrize("name", ["carosac", "ipanema1"])
def test_wider_tension_limits_never_lose_a_pose(name):
    robot = ct.load_robot(name)
    rng = np.random.default_rng(0)
    where = rng.uniform(robot.workspace_min, robot.workspace_max, (500, 3))
    before = np.zeros(500, dtype=bool)
    for lowest in (20.0, 5.0, 0.1, 1e-3, 0.0):
        wider = replace(robot, tension_min=np.full(robot.n, lowest))
        equilibrium = statics.inverse_kinematics(wider, where)
        assert not (before & ~equilibrium.converged).any()
        before = equilibrium.converged
    assert before.all()


def test_a_top_heavy_platform_is_held_where_it_can_be():
    robot = ct.load_robot("carosac")
    heavy = replace(robot, center_of_mass=np.array([0.0, 0.0, 0.1]))
    rng = np.random.default_rng(0)
    where = rng.uniform(robot.workspace_min, robot.workspace_max, (2000, 3))
    equilibrium = statics.inverse_kinematics(heavy, where)
    assert equilibrium.converged.mean() > 0.999
    assert equilibrium.stable[equilibrium.converged].all()


@pytest.mark.parametrize("name", ["carosac", "cogiro", "ipanema1"])
def test_what_is_called_an_equilibrium_is_one_by_independent_equations(name):
    """Cables solved anew by the reference at the pose found: their wrench carries the weight."""
    robot = ct.load_robot(name)
    rng = np.random.default_rng(7)
    where = rng.uniform(robot.workspace_min, robot.workspace_max, (40, 3))
    there = statics.inverse_kinematics(robot, where)
    good = there.converged
    back = statics.forward_kinematics(robot, there.unstrained_length[good])
    for result in (there, back):
        for k in np.flatnonzero(result.converged)[:25]:
            wrench = reference.cable_wrench(
                robot,
                result.unstrained_length[k],
                result.position[k],
                result.rotation[k],
                result.exit_tension[k],
            )
            assert np.abs(wrench).max() < 1e-7 * robot.weight


def test_a_pose_guess_at_a_rest_pose_stays_there():
    robot = ct.load_robot("cogiro")
    rng = np.random.default_rng(3)
    where = rng.uniform(robot.workspace_min, robot.workspace_max, (500, 3))
    there = statics.inverse_kinematics(robot, where)
    pose = Pose(position=there.position, rotation=there.rotation)
    back = statics.forward_kinematics(robot, there.unstrained_length, guess=pose)
    assert back.converged.all()
    assert np.linalg.norm(back.position - where, axis=1).max() < 1e-6


def test_large_batches_keep_no_buffers():
    robot = simple_robot()
    where = np.tile(robot.home_position, (device.KEPT_BATCH_MAX + 1, 1))
    statics.inverse_kinematics(robot, where)
    assert len(device._buffers.get(robot, {})) == 0


def test_a_robot_300_times_as_large_converges_as_well():
    small = simple_robot()
    large = replace(
        small,
        **{
            name: 300.0 * getattr(small, name)
            for name in (
                "exit_points", "anchor_points", "center_of_mass", "run_length", "length_max",
                "workspace_min", "workspace_max", "home_position",
            )
        },
        linear_density=small.linear_density / 300.0,
    )  # fmt: skip
    rng = np.random.default_rng(1)
    where = rng.uniform(large.workspace_min, large.workspace_max, (300, 3))
    equilibrium = statics.inverse_kinematics(large, where)
    back = statics.forward_kinematics(large, equilibrium.unstrained_length[equilibrium.converged])
    assert back.converged.all()
