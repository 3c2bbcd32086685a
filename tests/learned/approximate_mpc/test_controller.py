"""A network in place of MPC's planner: as good where it was trained, and handed over where not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from baselines.mpc import MpcSettings, NoStart
from carosac_toolkit import trajectories
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.loop import run
from carosac_toolkit.loop.values import Belief, Reference
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.studies.run.run_case import Truth
from learned.approximate_mpc.controller import (
    ApproximateMpc,
    ApproximateMpcSettings,
    PlanFollower,
)
from learned.approximate_mpc.networks import list_networks
from sim_warp.driver import SimDriver, SimDriverSettings
from tests.robots import eight_cable_robot, hanging

MOVING = np.array([[0.0, 0.0, 0.5, 0.0, 0.0, 0.0]])  # with more energy than the cables hold


@pytest.fixture(scope="module", params=["carosac", "scampi"])
def robot(request):
    return ct.load_robot(request.param)


def drive(robot, controller, path):
    """Drive the nominal robot with perfect sensors; return the log."""
    start = tuple(float(x) for x in path.sample(np.zeros(1)).position[0])
    settings = SimDriverSettings(period=controller.period, start_position=start)
    driver = SimDriver.build(robot, settings)
    return run(driver, Truth(driver), controller, path, duration=path.duration + 1.0)


def move_of(robot):
    middle, half = robot.home_position, 0.5 * (robot.workspace_max - robot.workspace_min)
    return trajectories.line(
        middle - 0.3 * half * [1, 1, 0], middle + 0.3 * half * [1, 1, 0.5],
        speed_max=2.0, acceleration_max=2.0,
    )  # fmt: skip


def test_it_follows_a_fast_move_as_mpc_does(robot):
    path, errors = move_of(robot), []
    for name in ("approximate_mpc", "mpc"):
        controller = plugins.load("controllers", name).build(robot)
        log = drive(robot, controller, path)
        errors.append(float(np.sqrt(((log.position - log.reference) ** 2).sum(axis=2).mean())))
        assert not controller.fallbacks
        assert (log.tension[10:] > 0.0).all()
    assert errors[0] < 1.5 * errors[1] + 2e-3


def at_home(robot):
    """Return a controller that was reset at rest at home, the belief there, and the rest."""
    rest = statics.inverse_kinematics(robot, robot.home_position[None])
    controller = ApproximateMpc.build(robot)
    belief = Belief(
        time=np.zeros(1), position=rest.position, rotation=rest.rotation, twist=np.zeros((1, 6)),
        tension=rest.tension,
    )  # fmt: skip
    controller.reset(belief)
    return controller, belief, rest


def test_a_reset_builds_nothing_that_takes_longer_than_a_cycle(robot, monkeypatch):
    _, belief, _ = at_home(robot)
    controller = ApproximateMpc.build(ct.load_robot(robot.name))

    def built(*_):
        raise AssertionError("it was built with the controller")

    monkeypatch.setattr("learned.approximate_mpc.packed_function.PackedFunction.__init__", built)
    controller.reset(belief)


def test_the_platform_stays_where_it_is(robot):
    controller, belief, rest = at_home(robot)
    first = controller.command(belief, still(controller, robot.home_position)).unstrained_length
    assert first == pytest.approx(rest.unstrained_length, abs=3e-3)


def still(controller, position, cycle=0):
    rows = round(controller.horizon / controller.period) + 1
    place = np.broadcast_to(position, (1, rows, 3))
    return Reference(
        time=controller.period * (cycle + np.arange(rows))[None], position=place,
        velocity=np.zeros_like(place), acceleration=np.zeros_like(place),
    )  # fmt: skip


def test_it_hands_over_where_it_was_not_trained_and_takes_over_again():
    robot = ct.load_robot("carosac")
    controller, belief, _ = at_home(robot)
    lost = replace(belief, position=belief.position + np.array([0.0, 0.0, 0.8]))
    sent = []
    for k in range(150):
        seen = replace(lost if 20 <= k < 25 else belief, time=np.array([k * controller.period]))
        command = controller.command(seen, still(controller, robot.home_position, k))
        sent.append(command.unstrained_length[0])
    counts = controller.fallbacks
    assert counts["lengths apart from the belief"] == 5
    assert counts["calming down"] == pytest.approx(1.0 / controller.period, abs=2)
    acceleration = np.diff(sent, 2, axis=0) / controller.period**2
    assert np.abs(acceleration).max() < 3.0  # nothing jumps, though the belief does


def test_it_hands_over_where_no_network_can_read_the_state():
    robot = ct.load_robot("carosac")
    controller, belief, _ = at_home(robot)
    calm = still(controller, robot.home_position)
    mad = np.zeros_like(calm.velocity)
    mad[0, -2] = 1e9  # at the end of the plan alone, at which input shaping does not look
    controller.command(belief, replace(calm, velocity=mad))
    assert controller.fallbacks == {"a state that no network can read": 1}


def test_a_platform_that_bounces_is_handed_over_for_longer_each_time():
    """Its energy is in motion, then in tensions that no plan has asked for, for four cycles."""
    robot = ct.load_robot("carosac")
    controller, calm, _ = at_home(robot)
    moving = replace(calm, twist=MOVING)
    stretched = replace(calm, tension=1.9 * calm.tension)
    told = {20: moving, 22: stretched, 180: moving, 182: stretched}
    waited = []
    for k in range(420):
        before = sum(controller.fallbacks.values())
        command_at(controller, told.get(k, calm), robot, k)
        if k in (20, 180):
            waited.append(0)
        elif waited:
            waited[-1] += sum(controller.fallbacks.values()) - before
    assert controller.fallbacks["bouncing on its cables"] == 2 * 4
    periods = np.array([2.0, 4.0]) / controller.period
    assert waited == pytest.approx(periods + 3, abs=1)


@pytest.mark.parametrize("only", ["moving", "stretched", "always stretched"])
def test_what_is_believed_of_motion_or_stretch_alone_is_no_bounce(only):
    """A bounce is in both by turns; tensions that always differ are of the plant."""
    robot = ct.load_robot("carosac")
    controller, calm, _ = at_home(robot)
    stretched = replace(calm, tension=1.9 * calm.tension)
    if only == "always stretched":
        calm = stretched
    other = stretched if only == "stretched" else replace(calm, twist=MOVING)
    for k in range(60):
        command_at(controller, other if k == 20 else calm, robot, k)
    assert not controller.fallbacks


@pytest.mark.parametrize("tension", ["none", "not finite"])
def test_without_tensions_a_bounce_is_told_by_its_motion(tension):
    """It counts as long as it lasts."""
    robot = ct.load_robot("carosac")
    controller, calm, _ = at_home(robot)
    told = None if tension == "none" else np.full_like(calm.tension, np.nan)
    moving = replace(calm, twist=MOVING, tension=told)
    for k in range(30):
        command_at(controller, moving if k in (20, 21) else calm, robot, k)
    assert controller.fallbacks["bouncing on its cables"] == 2


def test_tensions_that_were_not_finite_hide_no_later_bounce():
    robot = ct.load_robot("carosac")
    controller, calm, _ = at_home(robot)
    told = {
        5: replace(calm, tension=np.full_like(calm.tension, np.nan)),
        20: replace(calm, twist=MOVING), 22: replace(calm, tension=1.9 * calm.tension),
    }  # fmt: skip
    for k in range(30):
        command_at(controller, told.get(k, calm), robot, k)
    assert controller.fallbacks["bouncing on its cables"] == 4


def command_at(controller, belief, robot, k):
    """Let it command at the k-th period."""
    belief = replace(belief, time=np.array([k * controller.period]))
    controller.command(belief, still(controller, robot.home_position, k))


@pytest.mark.parametrize("speed", [0.0, 0.5])
def test_commands_keep_the_limits_of_the_winches_where_control_changes_hands(speed):
    """The belief jumps for a moment while the platform moves; the lengths sent do not."""
    robot = ct.load_robot("carosac")
    middle, way = robot.home_position, np.array([0.0, 1.5, 0.0])
    path = trajectories.line(
        middle - way, middle + way, speed_max=max(speed, 0.05), acceleration_max=1.0
    )
    controller = ApproximateMpc.build(robot)
    start = tuple(float(x) for x in path.sample(np.zeros(1)).position[0])
    driver = SimDriver.build(
        robot, SimDriverSettings(period=controller.period, start_position=start)
    )
    log = run(driver, Dazed(driver), controller, path, duration=4.0)
    assert controller.fallbacks["lengths apart from the belief"] == 2
    acceleration = np.diff(log.command[:, 0], 2, axis=0) / controller.period**2
    assert np.abs(acceleration[25:]).max() < robot.acceleration_max.max()  # it starts with a jolt
    away = np.linalg.norm(log.position - log.reference, axis=2)[:, 0]
    assert away.max() < 0.25 and away[-25:].max() < 0.05


class Dazed(Truth):
    """The truth, but for two moments in which it is 0.8 m off."""

    def reset(self, measurement):
        belief = super().reset(measurement)
        if 1.0 < belief.time[0] < 1.045:
            belief = replace(belief, position=belief.position + np.array([0.0, 0.0, 0.8]))
        return belief


def test_beliefs_without_a_twist_are_enough():
    """Poses alone tell the velocity, if later."""
    robot = ct.load_robot("carosac")
    path = move_of(robot)
    controller = ApproximateMpc.build(robot)
    start = tuple(float(x) for x in path.sample(np.zeros(1)).position[0])
    settings = SimDriverSettings(period=controller.period, start_position=start)
    driver = SimDriver.build(robot, settings)
    log = run(driver, Posed(driver), controller, path, duration=path.duration + 1.0)
    away = np.linalg.norm(log.position - log.reference, axis=2)
    assert not controller.fallbacks
    assert np.sqrt((away**2).mean()) < 0.05


class Posed(Truth):
    """The true pose."""

    def reset(self, measurement):
        return replace(super().reset(measurement), twist=None)


def test_a_cable_that_cannot_hang_as_planned_comes_to_rest(robot):
    """Its sag less stretch is NaN, as of a slack one; nothing else may become so."""
    follower = PlanFollower(robot, MpcSettings())
    rest = statics.inverse_kinematics(robot, robot.home_position[None])
    belief = Belief(
        time=np.zeros(1), position=rest.position, rotation=rest.rotation, twist=np.zeros((1, 6))
    )
    follower.reset(belief)
    reference = still(follower, robot.home_position)
    excess = np.zeros(robot.n)
    excess[1] = np.nan
    for _ in range(3):
        inputs, reason = follower.look(belief, reference)
        assert not reason and np.isfinite(inputs.position).all()
        sent = follower.follow(inputs, np.full(robot.n, robot.weight / robot.n), excess)
        assert np.isfinite(sent).all() and np.isfinite(follower.surplus).all()


def test_a_start_out_of_reach_is_refused():
    robot = ct.load_robot("carosac")
    controller = ApproximateMpc.build(robot)
    far = Belief(time=np.zeros(1), position=np.array([[50.0, 0, 0]]), rotation=np.eye(3)[None])
    with pytest.raises(NoStart, match="approximate_mpc: position"):
        controller.reset(far)


def test_it_is_refused_for_robots_that_it_does_not_know():
    with pytest.raises(InvalidField, match="3 to 5"):
        PlanFollower(eight_cable_robot(), MpcSettings())
    with pytest.raises(InvalidField, match="carosac distill"):
        ApproximateMpc.build(hanging(3))
    with pytest.raises(InvalidField, match="other values of mass"):
        ApproximateMpc.build(replace(ct.load_robot("carosac"), mass=1.0))
    with pytest.raises(InvalidField, match="one of"):
        ApproximateMpc.check_settings(ApproximateMpcSettings(policy="carosac-mcp"))
    assert list_networks() == ("carosac-mpc", "scampi-mpc", "suspended-4")


def test_a_reference_that_ends_too_soon_is_refused():
    robot = ct.load_robot("carosac")
    rest = statics.inverse_kinematics(robot, robot.home_position[None])
    controller = ApproximateMpc.build(robot)
    belief = Belief(time=np.zeros(1), position=rest.position, rotation=rest.rotation)
    short = still(controller, robot.home_position)
    short = Reference(
        **{n: getattr(short, n)[:, :5] for n in ("time", "position", "velocity", "acceleration")}
    )
    with pytest.raises(InvalidField, match="reset"):
        controller.command(belief, short)
    controller.reset(belief)
    with pytest.raises(InvalidField, match="those of the horizon"):
        controller.command(belief, short)
