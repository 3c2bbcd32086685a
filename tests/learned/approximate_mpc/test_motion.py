"""The two functions of a command are those of MPC's model, observer, filters and winches."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from baselines.mpc import model
from baselines.mpc.excess_filter import ExcessFilter
from baselines.mpc.geometry import Geometry, geometry_at
from baselines.mpc.length_offsets import LengthOffsets
from baselines.mpc.stage_function import StageFunction
from baselines.mpc.winch_reference import WinchReference
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.rest.modes import mass_matrix
from carosac_toolkit.physics.rest.structure import constrained_motion
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot
from learned.approximate_mpc.motion import FastMotion, Seen

PERIOD, JERK_MAX = 0.02, 500.0


@dataclass(frozen=True, kw_only=True)
class Swaying:
    """A robot away from rest, and what a command begins with."""

    robot: Robot
    rotation: Array
    geometry: Geometry
    state: Array
    offsets: LengthOffsets
    excess: ExcessFilter
    winches: WinchReference
    motion: FastMotion

    def look(self, length: Array, rate: Array, offsets: LengthOffsets) -> Seen:
        """Return what the belief tells beside lengths and rates."""
        return self.motion.look(self.state, self.state[6:], offsets, sent=length, rate=rate)


@pytest.fixture(scope="module", params=["carosac", "scampi"])
def swaying(request):
    robot = ct.load_robot(request.param)
    rng = np.random.default_rng(3)
    position = robot.home_position + rng.normal(size=3) * 0.2
    rotation = Rotation.from_rotvec(rng.normal(size=3) * 0.1).as_matrix() @ robot.home_rotation
    geometry = geometry_at(robot, position, rotation)
    offsets = LengthOffsets(robot.n, period=PERIOD, ratios=Scales(robot).ratios)
    excess = ExcessFilter(robot, PERIOD)
    winches = WinchReference(robot, period=PERIOD, jerk_max=JERK_MAX)
    motion = FastMotion(robot, period=PERIOD, jerk_max=JERK_MAX, offsets=offsets, excess=excess)
    motion.parameters[:] = model.parameters(
        robot, rotation=rotation, length=geometry.free, exits=geometry.exits,
        disturbance=rng.normal(size=6) * 0.1,
    )  # fmt: skip
    excess.take(0.03 * rng.normal(size=robot.n), 0.1 * rng.normal(size=robot.n))
    winches.reset(geometry.length)
    return Swaying(
        robot=robot, rotation=rotation, geometry=geometry, offsets=offsets, excess=excess,
        winches=winches, motion=motion,
        state=np.concatenate([position, np.zeros(3), rng.normal(size=6) * 0.3]),
    )  # fmt: skip


def test_a_believed_state_is_moved_onto_lengths_and_rates(swaying):
    rng, n = np.random.default_rng(4), swaying.robot.n
    sent, rate = swaying.geometry.free + 0.02 * rng.normal(size=n), rng.normal(size=n)
    seen = swaying.look(sent, rate, swaying.offsets)
    turned = model.rotation_of(seen.state[3:6]) @ swaying.rotation
    assert seen.rotation == pytest.approx(turned, abs=1e-12)
    there = geometry_at(swaying.robot, seen.state[:3], seen.rotation)
    wanted = sent - seen.offset[0] - seen.offset[1]
    assert np.abs(wanted - swaying.geometry.free).max() > 0.01
    assert there.free == pytest.approx(wanted, abs=2e-6)
    assert there.jacobian @ seen.state[6:] == pytest.approx(rate, abs=1e-6)


def test_that_move_costs_the_least_energy(swaying):
    robot, geometry, state = swaying.robot, swaying.geometry, swaying.state
    small = 1e-6 * np.arange(1.0, robot.n + 1.0)
    rate = geometry.jacobian @ state[6:]
    moved = swaying.look(geometry.free + small, rate, swaying.offsets)
    kept = small - moved.offset[0] - moved.offset[1]
    mass = mass_matrix(robot, swaying.rotation[None], geometry.free[None])[0]
    step = constrained_motion(mass, geometry.jacobian) @ kept
    assert moved.state[:3] - state[:3] == pytest.approx(step[:3], rel=1e-3, abs=1e-10)
    assert 4.0 * moved.state[3:6] == pytest.approx(step[3:], rel=1e-3, abs=1e-10)


def test_what_a_twist_has_beyond_its_prediction_moves_no_cable(swaying):
    n, state = swaying.robot.n, swaying.state
    predicted = state[6:] - np.array([0.1, 0.2, 0.3, 0.0, -0.1, 0.1])
    seen = swaying.motion.look(
        state, predicted, swaying.offsets, sent=swaying.geometry.free, rate=np.zeros(n)
    )
    assert seen.free == pytest.approx(swaying.geometry.free, abs=1e-12)
    assert swaying.geometry.jacobian @ seen.innovation == pytest.approx(np.zeros(n), abs=1e-12)
    assert np.abs(seen.innovation).max() > 1e-3


def test_only_motion_against_the_winches_has_energy(swaying):
    robot, geometry, twist = swaying.robot, swaying.geometry, swaying.state[6:]
    let_out = geometry.jacobian @ twist
    along = swaying.look(geometry.free, let_out, swaying.offsets)
    assert along.motion_energy == pytest.approx(0.0, abs=1e-12)
    mass = mass_matrix(robot, swaying.rotation[None], geometry.free[None])[0]
    for missing in (0.1 * np.ones(robot.n), np.linspace(-0.2, 0.3, robot.n)):
        motion = constrained_motion(mass, geometry.jacobian) @ missing
        seen = swaying.look(geometry.free, let_out - missing, swaying.offsets)
        assert seen.motion_energy == pytest.approx(0.5 * motion @ mass @ motion, rel=1e-6)


def test_offsets_are_learned_as_mpc_does(swaying):
    n = swaying.robot.n
    offsets = deepcopy(swaying.offsets)
    for missing in (0.02 * np.linspace(-1.0, 1.0, n), np.linspace(0.0, 0.3, n)):
        before = deepcopy(offsets)
        offsets.learn(missing)
        seen = swaying.look(swaying.geometry.free + missing, np.zeros(n), before)
        expected = np.stack([offsets.offset, offsets.slack, offsets.most])
        assert seen.offset == pytest.approx(expected, abs=1e-12)
        assert seen.apart == pytest.approx(missing - before.kept, abs=1e-12)
    assert offsets.slack.any()


def test_commands_of_winches_without_limits_are_not_changed(swaying):
    n = swaying.robot.n
    free = replace(
        swaying.robot, speed_max=np.full(n, 1e3), acceleration_max=np.full(n, 1e6),
        length_min=np.full(n, 0.1), length_max=np.full(n, 1e3),
    )  # fmt: skip
    limits = {"period": PERIOD, "jerk_max": 1e9}
    winches = WinchReference(free, **limits)
    winches.reset(swaying.geometry.length)
    motion = FastMotion(free, offsets=swaying.offsets, excess=swaying.excess, **limits)
    motion.parameters[:] = swaying.motion.parameters
    tension, excess = np.full(n, free.weight / n), swaying.excess.value
    surplus = np.zeros(n)
    found = motion.advance(swaying.state, tension, excess, swaying.excess, surplus, winches.state)
    assert found.tension == pytest.approx(tension, abs=1e-6) and not found.held
    path = stage_of(swaying, found.state, found.tension)[1]
    winches.follow(path[:n] + found.excess[0], path[n : 2 * n])
    assert not winches.held
    assert found.winches.sent == pytest.approx(winches.state.sent, abs=1e-8)
    assert found.winches.length == pytest.approx(path[:n] + found.excess[0], abs=1e-12)


def advanced(swaying, tension, excess, winches):
    return swaying.motion.advance(
        swaying.state, tension, excess, swaying.excess, np.full(swaying.robot.n, 0.01),
        winches.state,
    )  # fmt: skip


def stage_of(swaying, state, tension):
    stage = StageFunction(swaying.robot.n, 1, "never")
    stage.state[0], stage.tension[0], stage.duration[0] = state, tension, PERIOD
    stage.parameters[0] = swaying.motion.parameters
    stage()
    return stage.after[0].copy(), stage.path[0].copy()


def test_what_follows_from_tensions_is_what_mpc_sends(swaying):
    """Its stage, its filter of sag and stretch, and its winches, at rest and in motion."""
    n, winches = swaying.robot.n, deepcopy(swaying.winches)
    share, rng = swaying.robot.weight / n, np.random.default_rng(6)
    for _ in range(5):
        tension, excess = share * rng.uniform(0.8, 1.2, n), 0.05 * rng.normal(size=n)
        found = advanced(swaying, tension, excess, winches)
        after, _ = stage_of(swaying, swaying.state, found.tension)
        assert found.state == pytest.approx(after, abs=1e-12)
        _, path = stage_of(swaying, after, found.tension)
        filtered = deepcopy(swaying.excess)
        filtered.approach(excess)
        assert found.excess == pytest.approx(np.stack([filtered.value, filtered.rate]), abs=1e-12)
        winches.follow(path[:n] + 0.01 + filtered.value, path[n : 2 * n])
        for mine, theirs in zip(found.winches, winches.state, strict=True):
            assert mine == pytest.approx(theirs, abs=1e-8)
        assert found.held and winches.held


def test_tensions_are_those_of_winches_that_cannot_accelerate_more(swaying):
    n = swaying.robot.n
    tension = swaying.robot.weight / n * np.linspace(0.5, 1.5, n)
    allowed = swaying.winches.acceleration_range()
    wanted = stage_of(swaying, swaying.state, tension)[1][2 * n :]
    pull = advanced(swaying, tension, np.zeros(n), swaying.winches).tension
    given = stage_of(swaying, swaying.state, pull)[1][2 * n :]
    assert ((wanted < allowed.low) | (wanted > allowed.high)).any()
    assert given == pytest.approx(np.clip(wanted, allowed.low, allowed.high), abs=1e-9)


def test_machine_code_gives_what_the_interpreter_gives(swaying, tmp_path, monkeypatch):
    monkeypatch.setenv("CAROSAC_CACHE", str(tmp_path))
    n = swaying.robot.n
    motion = FastMotion(
        swaying.robot, period=PERIOD, jerk_max=JERK_MAX, offsets=swaying.offsets,
        excess=swaying.excess, compiled="always",
    )  # fmt: skip
    motion.parameters[:] = swaying.motion.parameters
    assert len(list(tmp_path.glob("*.so"))) == 2
    other = replace(swaying, motion=motion)
    sent, rate = swaying.geometry.free + 0.01, np.linspace(-0.5, 0.5, n)
    for mine, theirs in zip(
        other.look(sent, rate, other.offsets), swaying.look(sent, rate, swaying.offsets),
        strict=True,
    ):  # fmt: skip
        assert mine == pytest.approx(theirs, abs=1e-12)
    tension, excess = np.full(n, swaying.robot.weight / n), np.full(n, 0.01)
    mine, theirs = (advanced(each, tension, excess, swaying.winches) for each in (other, swaying))
    assert mine.state == pytest.approx(theirs.state, abs=1e-12)
    assert mine.winches.sent == pytest.approx(theirs.winches.sent, abs=1e-12)
