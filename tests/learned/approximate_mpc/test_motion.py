"""The few functions of a command are those of MPC's model and observer."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from baselines.mpc import model
from baselines.mpc.geometry import geometry_at
from baselines.mpc.stage_function import StageFunction
from carosac_toolkit.physics.rest.modes import mass_matrix
from carosac_toolkit.physics.rest.structure import constrained_motion
from learned.approximate_mpc.motion import FastMotion


@pytest.fixture(scope="module", params=["carosac", "scampi"])
def robot(request):
    return ct.load_robot(request.param)


@pytest.fixture(scope="module")
def swaying(robot):
    """A pose and twist away from rest, and the motion at it."""
    rng = np.random.default_rng(3)
    position = robot.home_position + rng.normal(size=3) * 0.2
    rotation = Rotation.from_rotvec(rng.normal(size=3) * 0.1).as_matrix() @ robot.home_rotation
    geometry = geometry_at(robot, position, rotation)
    motion = FastMotion(robot.n)
    motion.parameters[:] = model.parameters(
        robot, rotation=rotation, length=geometry.free, exits=geometry.exits,
        disturbance=rng.normal(size=6) * 0.1,
    )  # fmt: skip
    state = np.concatenate([position, np.zeros(3), rng.normal(size=6) * 0.3])
    return motion, state, rotation, geometry


def test_a_believed_state_is_moved_onto_lengths_and_rates(robot, swaying):
    motion, state, rotation, geometry = swaying
    rng = np.random.default_rng(4)
    length, rate = geometry.length + 0.02 * rng.normal(size=robot.n), rng.normal(size=robot.n)
    moved, turned = motion.project(state, length, rate)
    assert turned == pytest.approx(model.rotation_of(moved[3:6]) @ rotation, abs=1e-12)
    there = geometry_at(robot, moved[:3], turned)
    assert there.length == pytest.approx(length, abs=2e-6)  # from 2 cm
    assert there.jacobian @ moved[6:] == pytest.approx(rate, abs=1e-6)


def test_that_move_costs_the_least_energy(robot, swaying):
    motion, state, rotation, geometry = swaying
    small = 1e-6 * np.arange(1.0, robot.n + 1.0)
    rate = geometry.jacobian @ state[6:]
    moved, _ = motion.project(state, geometry.length + small, rate)
    mass = mass_matrix(robot, rotation[None], geometry.free[None])[0]
    step = constrained_motion(mass, geometry.jacobian) @ small
    assert moved[:3] - state[:3] == pytest.approx(step[:3], rel=1e-3, abs=1e-10)
    assert 4.0 * moved[3:6] == pytest.approx(step[3:], rel=1e-3, abs=1e-10)


def test_what_a_twist_has_innovation_moves_no_cable(robot, swaying):
    motion, state, _, geometry = swaying
    lengths, innovation = motion.look(state, state[6:] - np.array([0.1, 0.2, 0.3, 0.0, -0.1, 0.1]))
    assert lengths == pytest.approx(geometry.free, abs=1e-12)
    assert geometry.jacobian @ innovation == pytest.approx(np.zeros(robot.n), abs=1e-12)
    assert np.abs(innovation).max() > 1e-3


def test_a_stage_is_that_of_the_plan(robot, swaying):
    motion, state, *_ = swaying
    stage = StageFunction(robot.n, 1, "never")
    tension = robot.weight / robot.n * np.linspace(0.8, 1.2, robot.n)
    stage.state[0], stage.tension[0], stage.duration[0] = state, tension, 0.02
    stage.parameters[0] = motion.parameters
    stage()
    free = np.full(robot.n, 1e3)
    after, length, rate, pull = motion.advance(state, tension, 0.02, -free, free)
    assert pull == pytest.approx(tension, abs=1e-9)
    assert after == pytest.approx(stage.after[0], abs=1e-12)
    stage.state[0] = after
    stage()
    assert np.concatenate([length, rate]) == pytest.approx(stage.path[0, : 2 * robot.n], abs=1e-12)


def test_tensions_are_those_of_winches_that_cannot_accelerate_more(robot, swaying):
    motion, state, *_ = swaying
    stage = StageFunction(robot.n, 1, "never")
    tension = robot.weight / robot.n * np.linspace(0.5, 1.5, robot.n)
    low, high = np.full(robot.n, -0.2), np.full(robot.n, 0.3)
    pull = motion.advance(state, tension, 0.02, low, high)[3]
    stage.state[0], stage.parameters[0], stage.duration[0] = state, motion.parameters, 0.02
    stage.tension[0] = tension
    stage()
    wanted = stage.path[0, 2 * robot.n :].copy()
    stage.tension[0] = pull
    stage()
    assert ((wanted < low) | (wanted > high)).any()
    assert stage.path[0, 2 * robot.n :] == pytest.approx(np.clip(wanted, low, high), abs=1e-9)
