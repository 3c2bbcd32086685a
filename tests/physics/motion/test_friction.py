"""Dry friction at the ends of cables, against the pendulum and against energy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.physics.motion.friction_kernels import PRESLIDING_ANGLE
from sim_warp import Simulator
from tests.robots import hanging

LENGTH = 4.0  # [m] of the pendulum
CORNERS = 0.5 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
PERIOD_S = 0.01  # between samples


def pendulum(**friction):
    """A platform on four parallel cables without damping: it swings and never turns."""
    robot = ct.load_robot("carosac")
    return replace(
        robot,
        exit_points=np.column_stack([CORNERS, np.full(4, LENGTH + 1.0)]),
        anchor_points=np.column_stack([CORNERS, np.zeros(4)]),
        center_of_mass=np.zeros(3), mass=10.0, inertia=np.diag([2.0, 2.0, 2.0]),
        run_length=np.zeros(4), linear_density=np.full(4, 1e-4), axial_damping=np.zeros(4),
        drag=0.0, angular_drag=0.0, workspace_min=np.array([-1.0, -1.0, 0.5]),
        workspace_max=np.array([1.0, 1.0, 2.0]), home_position=np.array([0.0, 0.0, 1.0]),
        **{name: np.full(4, value) for name, value in friction.items()},
    )  # fmt: skip


def swing(robot, twist, duration, cables="catenary", time_step=None):
    """Kick a platform at home, winches locked; return positions, rotations and twists in time."""
    rest = ct.statics.inverse_kinematics(robot, robot.home_position[None])
    options = {} if time_step is None else {"time_step": time_step}
    simulator = Simulator(robot, cables=cables, **options)
    simulator.reset(unstrained_length=rest.unstrained_length, twist=np.array([twist], float))
    states = []
    for _ in range(round(duration / PERIOD_S)):
        simulator.follow(rest.unstrained_length, PERIOD_S)
        states.append(simulator.state.numpy())
    return [np.array([getattr(s, k)[0] for s in states]) for k in ("position", "rotation", "twist")]


def turning_angles(position):
    """Angles of the pendulum where it turns round [rad], in time."""
    x = position[:, 0]
    peak = np.flatnonzero((np.diff(np.abs(x[1:])) <= 0.0) & (np.diff(np.abs(x[:-1])) > 0.0)) + 1
    before, here, after = np.abs(x[peak - 1]), np.abs(x[peak]), np.abs(x[peak + 1])
    top = here + (after - before) ** 2 / (8.0 * (2.0 * here - after - before))
    return np.arcsin(top / LENGTH)


@pytest.mark.parametrize("cables", ["catenary", "straight", "particles"])
@pytest.mark.parametrize("where", ["exit_friction", "anchor_friction"])
def test_a_pendulum_loses_the_dry_moment_times_its_way(cables, where):
    """Half a swing costs M (way - 2 s), s being the presliding angle (Dahl's law, integrated)."""
    moment = 0.4  # [N m] of each cable
    robot = pendulum(**{where: moment})
    position, rotation, _ = swing(robot, [0.9, 0, 0, 0, 0, 0], 14.0, cables)
    angle = turning_angles(position)
    assert len(angle) >= 6
    way = angle[:-1] + angle[1:]
    lost = robot.weight * LENGTH * (np.cos(angle[1:]) - np.cos(angle[:-1]))
    expected = 4.0 * moment * (way - 2.0 * float(PRESLIDING_ANGLE))
    assert lost == pytest.approx(expected, rel=0.02)
    assert np.abs(rotation - np.eye(3)).max() < 2e-3


@pytest.mark.parametrize("cables", ["catenary", "particles"])
def test_what_was_bent_before_pushes_back_a_platform_that_starts_at_rest(cables):
    moment, duration = 0.4, 0.02
    robot = pendulum(anchor_friction=moment)
    rest = ct.statics.inverse_kinematics(robot, robot.home_position[None])
    speeds = []
    for last in ([200.0, 0, 0, 0, 0, 0], [0.0, -200.0, 0, 0, 0, 0], [0.0] * 6):
        simulator = Simulator(robot, cables=cables, time_step=0.002)
        simulator.reset(
            unstrained_length=rest.unstrained_length, twist=np.zeros((1, 6)),
            sliding=np.array([last]),
        )  # fmt: skip
        simulator.follow(rest.unstrained_length, duration)
        speeds.append(simulator.state.numpy().twist[0, :2])
    gained = 4.0 * moment / LENGTH / robot.mass * duration  # as all bristles slide at first
    assert speeds[0] == pytest.approx([-gained, 0.0], abs=0.05 * gained)
    assert speeds[1] == pytest.approx([0.0, gained], abs=0.05 * gained)
    assert speeds[2] == pytest.approx([0.0, 0.0], abs=1e-3 * gained)


def test_without_friction_nothing_is_lost():
    angle = turning_angles(swing(pendulum(), [0.9, 0, 0, 0, 0, 0], 14.0)[0])
    assert angle == pytest.approx(angle[0], rel=1e-3)


def test_a_swivel_resists_turning_about_its_axis_alone():
    """Cables that come in along y: swings along y turn the pulleys, swings along x the swivels."""
    across = pendulum(exit_friction=0.4)
    pulleys = replace(
        across, pulley_radius=np.full(4, 0.05),
        exit_points=across.exit_points - np.array([0.0, 0.05, 0.0]),
        swivel_axis=np.tile([0.0, 1.0, 0.0], (4, 1)),
    )  # fmt: skip
    free = replace(pulleys, exit_friction=np.zeros(4))
    kick = [0.0, 0.5, 0.0, 0.0, 0.0, 0.0]
    with_friction, without = (swing(robot, kick, 6.0)[0][:, 1] for robot in (pulleys, free))
    assert np.abs(with_friction - without).max() < 2e-3 * np.abs(without).max()
    kick = [0.5, 0.0, 0.0, 0.0, 0.0, 0.0]
    with_friction, without = (swing(robot, kick, 6.0)[0][:, 0] for robot in (pulleys, free))
    assert np.abs(with_friction[-150:]).max() < 0.9 * np.abs(without[-150:]).max()


RUN, COEFFICIENT = 6.0, 0.2  # [m] to the winch, and friction there


def with_runs(radius, **friction):
    """A pendulum whose cables come in along y, over pulleys or eyelets, from winches far away."""
    robot = pendulum(**friction)
    return replace(
        robot, pulley_radius=np.full(4, radius), run_length=np.full(4, RUN),
        exit_points=robot.exit_points - np.array([0.0, radius, 0.0]),
        swivel_axis=np.tile([0.0, 1.0, 0.0], (4, 1)), axial_stiffness=np.full(4, 5e3),
        axial_damping=np.full(4, 1e3),
    )  # fmt: skip


@pytest.mark.parametrize("cables", ["catenary", "straight", "particles"])
@pytest.mark.parametrize(("radius", "wrap"), [(0.0, 1.0), (0.05, 0.5 * np.pi)])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_tensions_over_a_pulley_have_the_ratio_of_a_capstan(cables, radius, wrap, way):
    """Where a winch turns slowly, what the run stretches less lifts the platform (Eytelwein)."""
    robot = with_runs(radius, capstan_friction=COEFFICIENT)
    rest = ct.statics.inverse_kinematics(robot, robot.home_position[None])
    simulator = Simulator(robot, cables=cables)
    simulator.reset(unstrained_length=rest.unstrained_length)
    for k in range(40):
        simulator.follow(rest.unstrained_length + 1e-3 * way * (k + 1), 0.5)
    state = simulator.state.numpy()
    free = ct.statics.forward_kinematics(robot, state.unstrained_length)
    tension = robot.weight / 4.0
    strain = tension / robot.axial_stiffness[0]
    less = (state.position[0, 2] - free.position[0, 2]) / (RUN * strain)
    assert tension / (tension * (1.0 - less)) == pytest.approx(
        np.exp(way * COEFFICIENT * wrap), rel=0.01
    )


BOUNCE = [0.0, 0.0, 0.2, 0.0, 0.0, 0.0]


def bouncing(coefficient, cables, time_step, duration):
    """Return heights and speeds of a platform that bounces on cables without damping."""
    robot = with_runs(0.05, capstan_friction=coefficient)
    robot = replace(robot, axial_damping=np.zeros(4), linear_density=np.full(4, 1e-3))
    position, _, twist = swing(robot, BOUNCE, duration, cables, time_step)
    return position[:, 2], twist[:, 2]


@pytest.mark.parametrize("cables", ["catenary", "straight", "particles"])
def test_a_cable_that_creeps_over_its_pulley_brakes_bounces(cables):
    """Their energy falls from one stretch to the next, and stays without friction."""
    free, braked = (
        (bouncing(coefficient, cables, 0.002, 6.0)[1] ** 2).reshape(6, -1).max(axis=1)
        for coefficient in (0.0, COEFFICIENT)
    )
    assert free == pytest.approx(free[0], rel=0.05)
    assert (np.diff(braked) < 0.0).all() and braked[-1] < 0.3 * braked[0]


@pytest.mark.parametrize("cables", ["catenary", "particles"])
def test_models_of_cables_creep_alike_over_pulleys_by_any_time_step(cables):
    straight, fine, coarse = (
        bouncing(COEFFICIENT, *model, 2.0)[0]
        for model in (("straight", 0.001), (cables, 0.001), (cables, 0.002))
    )
    assert np.abs(fine - straight).max() < 0.01 * np.ptp(straight)
    assert np.abs(coarse - fine).max() < 0.01 * np.ptp(straight)


@pytest.mark.parametrize("robot", [ct.load_robot("carosac"), hanging(2), hanging(3)])
def test_friction_never_gives_energy(robot):
    """Sway of any kind fades, from one stretch to the next."""
    share = robot.weight / robot.n
    rubbing = replace(
        robot, drag=0.0, angular_drag=0.0, axial_damping=np.zeros(robot.n),
        exit_friction=np.full(robot.n, 0.02 * share),
        anchor_friction=np.full(robot.n, 0.01 * share), capstan_friction=np.full(robot.n, 0.1),
    )  # fmt: skip
    _, rotation, twist = swing(rubbing, [0.4, -0.2, 0.0, 0.3, 0.4, -0.5], 15.0)
    speed = twist[:, :3] + np.cross(twist[:, 3:], rotation @ robot.center_of_mass)
    turning = np.einsum("kji,kj->ki", rotation, twist[:, 3:])
    energy = 0.5 * robot.mass * (speed**2).sum(axis=1)
    energy += 0.5 * np.einsum("ki,ij,kj->k", turning, robot.inertia, turning)
    peaks = energy.reshape(5, -1).max(axis=1)
    assert (np.diff(peaks) < 0.0).all()
    assert peaks[-1] < 0.5 * peaks[0]


def test_friction_does_not_depend_on_the_time_step():
    robot = pendulum(exit_friction=0.3, anchor_friction=0.3)
    coarse, fine = (
        turning_angles(swing(robot, [0.9, 0, 0, 0, 0, 0], 8.0, time_step=step)[0])
        for step in (0.01, 0.002)
    )
    assert coarse == pytest.approx(fine, rel=5e-3)
