"""Cables of particles: rest, swing, winding and snap against what physics says of them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import curve_fit

import carosac_toolkit as ct
from sim_warp import Simulator
from tests import reference as cables
from tests.robots import eight_cable_robot, simple_robot, with_pulleys
from tests.sim_warp import reference
from tests.sim_warp.worlds import ASIDE, KICK, aside, damped, held, undamped

STEPS = (1.0 / 60.0, 1.0 / 120.0, 1.0 / 1000.0)  # [s]
TAUT = np.full(8, 40.0)  # [N]; at 5 N the lower cables of the box sag by 1 % of their span


def taut_eight():
    return eight_cable_robot(tension_min=TAUT)


def settled(robot, length, **options):
    """State after a kick has died out in oil, winches at `length` (1, n)."""
    return settled_simulator(robot, length, **options).state.numpy()


def settled_simulator(robot, length, *, twist=KICK, seconds=20, **options):
    sim = Simulator(damped(robot), cable_drag=3.0, **options)
    sim.reset(robot.home_position[None] + [ASIDE[robot.name]], twist=twist)
    for _ in range(seconds):
        sim.step(length, 1.0)
    return sim


def distance_to_curve(points, curve):
    """Largest distance of points (n, k, 3) from polylines (n, m, 3) [m], shape (n,)."""
    start, step = curve[:, None, :-1], np.diff(curve, axis=1)[:, None]
    offset = points[:, :, None] - start
    share = np.clip((offset * step).sum(-1) / (step**2).sum(-1), 0.0, 1.0)
    gap = np.linalg.norm(offset - share[..., None] * step, axis=-1)
    return gap.min(axis=-1).max(axis=-1)


# --- Rest --------------------------------------------------------------------------------------


@pytest.mark.parametrize("run_length", [0.0, 8.0])
@pytest.mark.parametrize("robot", [simple_robot(), taut_eight()], ids=["simple", "eight"])
def test_reset_is_the_rest_of_the_chain_of_masses(robot, run_length):
    robot = replace(robot, run_length=np.full(robot.n, run_length))
    sim = Simulator(robot, segments=12)
    sim.reset(robot.home_position[None] + [ASIDE[robot.name]])
    state = sim.state.numpy()
    rest = reference.string_equilibrium(robot, state.unstrained_length[0], 12)
    assert state.position[0] == pytest.approx(rest.position, abs=1e-11)
    assert state.rotation[0] == pytest.approx(rest.rotation, abs=1e-11)
    assert state.particles[0] == pytest.approx(rest.nodes[:, 1:-1], abs=1e-11)
    tension = np.linalg.norm(rest.force, axis=1)
    assert state.tension[0] == pytest.approx(tension, abs=1e-7)
    assert not state.twist.any()


@pytest.mark.parametrize("run_length", [0.0, 8.0])
@pytest.mark.parametrize("robot", [simple_robot(), taut_eight()], ids=["simple", "eight"])
def test_dynamics_comes_to_the_rest_of_the_chain_of_masses(robot, run_length):
    """Newton steps end below 1e-7 m, and the next time step starts from there: 1e-9 m is left.

    The box is stiff: 1e-11 m times EA / l = 6e6 N/m makes up to 1e-4 N.
    """
    robot = replace(robot, run_length=np.full(robot.n, run_length))
    length = aside(robot).unstrained_length
    state = settled(robot, length, segments=12)
    rest = reference.string_equilibrium(robot, length[0], 12)
    assert state.position[0] == pytest.approx(rest.position, abs=1e-9)
    assert state.particles[0] == pytest.approx(rest.nodes[:, 1:-1], abs=1e-8)
    near = 1e-7 if robot.n == 4 else 1e-5
    assert state.tension[0] == pytest.approx(np.linalg.norm(rest.force, axis=1), abs=near)


@pytest.mark.parametrize("time_step", STEPS)
@pytest.mark.parametrize(
    "robot",
    [simple_robot(), with_pulleys(simple_robot()), taut_eight(), with_pulleys(taut_eight())],
    ids=["simple", "simple with pulleys", "eight", "eight with pulleys"],
)
def test_sixteen_segments_settle_where_catenaries_hang(robot, time_step):
    rest = aside(robot)
    sim = settled_simulator(robot, rest.unstrained_length, time_step=time_step)
    state = sim.state.numpy()
    assert np.linalg.norm(state.position - rest.position) < 5e-6
    assert np.abs(state.tension - rest.tension).max() < 0.01
    curve = ct.statics.cable_shape(robot, rest, 400)[0]
    assert distance_to_curve(sim.cable_points()[0], curve).max() < 1e-5


@pytest.mark.parametrize("robot", [simple_robot(), with_pulleys(simple_robot())])
def test_a_slack_cable_moves_the_platform_to_where_it_belongs(robot):
    start = aside(robot)
    length = start.unstrained_length + np.array([0.3, 0.0, 0.0, 0.0])
    rest = ct.statics.forward_kinematics(robot, length, guess=start)
    assert rest.slack[0].tolist() == [True, False, False, False]
    state = settled(robot, length)
    assert np.linalg.norm(state.position - rest.position) < 1e-5
    assert np.abs(state.tension - rest.tension).max() < 0.01


@pytest.mark.parametrize("slack", [0.3])
@pytest.mark.parametrize("run_length", [0.0, 8.0])
def test_the_error_of_the_rest_falls_with_the_fourth_power_of_the_segments(run_length, slack):
    """With a slack cable; that of taut ones is lost in the last Newton steps."""
    robot = simple_robot(run_length=np.full(4, run_length))
    start = aside(robot)
    length = start.unstrained_length + np.array([slack, 0.0, 0.0, 0.0])
    rest = ct.statics.forward_kinematics(robot, length, guess=start)
    states = [settled(robot, length, segments=n) for n in (8, 16, 32)]
    for miss in (
        np.array([np.linalg.norm(state.position - rest.position) for state in states]),
        np.array([np.abs(state.tension - rest.tension).max() for state in states]),
    ):
        assert (miss[:-1] / miss[1:] > 12.0).all() and (miss[:-1] / miss[1:] < 30.0).all()


# --- Swing -------------------------------------------------------------------------------------


def sway(robot, speed=0.3, **options):
    """A simulator that starts to swing in its slowest mode [m/s], and that frequency."""
    rest = aside(robot)
    frequency, shapes = reference.linear_modes(robot, rest, cable_mass=True)
    twist = speed * shapes[:, 0] / np.linalg.norm(shapes[:3, 0])
    sim = Simulator(robot, cable_drag=0.0, **options)
    sim.reset(rest.position, twist=twist[None])
    return sim, frequency[0], twist


@pytest.mark.parametrize("robot", [simple_robot(), with_pulleys(simple_robot())])
def test_the_slowest_sway_has_the_frequency_of_the_linearised_statics(robot):
    robot = undamped(robot)
    sim, frequency, twist = sway(robot, 0.03)  # 1 cm: at 10 cm it swings 0.3 % faster
    start, hold = sim.state.position.numpy()[0].copy(), held(sim)
    away = []
    for _ in range(400):
        sim.step(hold, 0.05)
        away.append((sim.state.position.numpy()[0] - start) @ twist[:3])
    time = 0.05 * np.arange(1, 401)
    (found, *_), _ = curve_fit(
        lambda t, f, a, b, c: a * np.sin(2 * np.pi * f * t) + b * np.cos(2 * np.pi * f * t) + c,
        time,
        away,
        p0=[frequency, np.max(away), 0.0, 0.0],
    )
    assert found == pytest.approx(frequency, rel=2e-3)
    assert found == pytest.approx(ct.modes.natural_frequencies(robot, aside(robot))[0, 0], rel=2e-3)


def parts(sim):
    """Masses, places and velocities of nodes and anchors (n, N), and the exits' side of it."""
    robot, state, n = sim.robots[0], sim.state.numpy(), sim.segments
    velocity = sim.save().arrays["cable_velocity"][0]
    arm = robot.anchor_points @ state.rotation[0].T
    anchor = state.position[0] + arm
    speed = state.twist[0, :3] + np.cross(state.twist[0, 3:], arm)
    place = np.concatenate([state.particles[0], anchor[:, None]], axis=1)
    velocity = np.concatenate([velocity, speed[:, None]], axis=1)
    mass = np.repeat((robot.linear_density * state.unstrained_length[0] / n)[:, None], n, axis=1)
    mass[:, -1] /= 2.0
    return mass, place, velocity


def energy(sim):
    """Of platform, nodes and springs [J], from their places and velocities alone."""
    robot, state = sim.robots[0], sim.state.numpy()
    rotation, twist = state.rotation[0], state.twist[0]
    mass, place, velocity = parts(sim)
    piece = np.outer(
        state.unstrained_length[0] / sim.segments, reference.segment_shares(sim.segments)
    )
    soft = piece.copy()
    soft[:, 0] += robot.run_length
    chain = np.concatenate([robot.exit_points[:, None], place], axis=1)
    stretch = np.maximum(np.linalg.norm(np.diff(chain, axis=1), axis=2) - piece, 0.0)
    moving = (
        twist @ cables.mass_matrix(robot, rotation) @ twist + (mass[..., None] * velocity**2).sum()
    )
    center = state.position[0] + rotation @ robot.center_of_mass
    high = robot.weight * center[2] + robot.gravity * (mass * place[..., 2]).sum()
    return moving / 2.0 + high + (robot.axial_stiffness[:, None] * stretch**2 / soft).sum() / 2.0


@pytest.mark.parametrize("time_step", [1.0 / 60.0, 1.0 / 120.0, 1.0 / 240.0])
def test_a_free_swing_never_gains_energy_and_hardly_loses_any(time_step):
    robot = undamped(simple_robot(run_length=np.zeros(4)))
    sim, _, _ = sway(robot, time_step=time_step)
    hold, swing = held(sim), [energy(sim)]
    rest = Simulator(robot)
    rest.reset(aside(robot).position)
    floor = energy(rest)
    per_second = round(1.0 / time_step)
    for _ in range(8 * per_second):
        sim.step(hold, time_step)
        swing.append(energy(sim))
    share = (np.array(swing) - floor) / (swing[0] - floor)
    # Means over a second, of which the first is the start-up of waves in the cables; single
    # values flutter by 1e-5 at 1/60 s with the tensions of waves that the step cannot follow.
    means = share[1:].reshape(8, per_second).mean(axis=1)
    assert (np.diff(means[1:]) < 1e-6 * per_second).all()
    assert means[-1] < means[1]
    assert means[-1] > 1.0 - 5e-3  # impacts in the first second cost some


def momentum(sim):
    """Linear, and angular about the origin of W, of platform and cables, shape (6,)."""
    robot, state = sim.robots[0], sim.state.numpy()
    mass, place, velocity = parts(sim)
    body = cables.mass_matrix(robot, state.rotation[0]) @ state.twist[0]
    linear = mass[..., None] * velocity
    total = body[:3] + linear.sum(axis=(0, 1))
    spin = body[3:] + np.cross(state.position[0], body[:3])
    return np.append(total, spin + np.cross(place, linear).sum(axis=(0, 1)))


def load(sim):
    """Wrench of gravity and of the exits on platform and cables, about the origin of W."""
    robot, state = sim.robots[0], sim.state.numpy()
    mass, place, _ = parts(sim)
    first = robot.exit_points - place[:, 0]
    tension = sim.save().arrays["cable_predicted"][0, :, 0]
    pull = tension[:, None] * first / np.linalg.norm(first, axis=1)[:, None]
    fall = -robot.gravity * reference.UP
    center = state.position[0] + state.rotation[0] @ robot.center_of_mass
    force = pull.sum(axis=0) + fall * (robot.mass + mass.sum())
    moment = np.cross(robot.exit_points, pull).sum(axis=0) + np.cross(center, robot.mass * fall)
    return np.append(force, moment + np.cross(place, mass[..., None] * fall).sum(axis=(0, 1)))


def test_momentum_changes_by_gravity_and_by_the_pull_at_the_exits_alone():
    """Trapezoids over the wrench, once waves have died: inner forces cancel exactly."""
    h = 1.0 / 2000.0
    sim, _, _ = sway(undamped(simple_robot(run_length=np.zeros(4))), time_step=h)
    hold = held(sim)
    sim.step(hold, 0.5)
    before, loads = momentum(sim), [load(sim)]
    for _ in range(800):
        sim.step(hold, h)
        loads.append(load(sim))
    gain = h * (np.sum(loads, axis=0) - (loads[0] + loads[-1]) / 2.0)
    change = momentum(sim) - before
    assert np.abs(change[:3]).max() > 1.0  # of a swing with 7 N s
    # Nodal tensions flutter within a step: 1 N over h, times 8 m of lever for the moment.
    assert gain[:3] == pytest.approx(change[:3], abs=1e-2)
    assert gain[3:] == pytest.approx(change[3:], abs=8e-2)


# --- Winding -----------------------------------------------------------------------------------


def wide(robot):
    """The box in a frame of 20 x 15 x 10 m, pulled taut."""
    return replace(
        robot,
        exit_points=5.0 * robot.exit_points,
        home_position=np.array([0.0, 0.0, 5.0]),
        tension_min=np.full(8, 60.0),
        workspace_min=np.array([-6.0, -4.0, 2.0]),
        workspace_max=np.array([6.0, 4.0, 8.0]),
        drag=0.0,
    )


def high(robot):
    """The suspended robot in a hall of 12 m."""
    return replace(robot, exit_points=robot.exit_points + np.array([0.0, 0.0, 4.0]), drag=0.0)


def eased(time, ramp, speed):
    """Way [m] of a motion that takes up speed smoothly within `ramp` [s]."""
    u = np.clip(time / ramp, 0.0, 1.0)
    way = ramp * (2.5 * u**4 - 3.0 * u**5 + u**6) + np.clip(time - ramp, 0.0, None)
    return speed * way


@pytest.mark.parametrize(
    ("robot", "start", "direction"),
    [
        (wide(eight_cable_robot()), [-4.5, -0.5, 4.0], [1.0, 0.1, 0.15]),
        (wide(with_pulleys(eight_cable_robot())), [-4.5, -0.5, 4.0], [1.0, 0.1, 0.15]),
        (high(simple_robot()), [0.4, -1.8, 1.5], [0.0, 0.0, 1.0]),
        (high(simple_robot()), [0.4, -1.8, 5.0], [0.0, 0.0, -1.0]),
    ],
    ids=["in and out", "over pulleys", "in", "out"],
)
def test_winding_at_a_metre_per_second_pulls_as_it_would_at_rest(robot, start, direction):
    """A straight path at constant speed: nothing accelerates but the cables, a little."""
    dt, ramp = 1.0 / 120.0, 1.5
    time = np.arange(0.0, 3.0, dt)
    unit = np.array(direction) / np.linalg.norm(direction)
    path = np.array(start) + eased(time, ramp, 1.4)[:, None] * unit
    rest = ct.statics.inverse_kinematics(robot, path)
    assert rest.converged.all()
    rate = np.diff(rest.unstrained_length, axis=0) / dt
    assert np.abs(rate[time[1:] > ramp]).max(axis=1).min() > 0.9
    sim = Simulator(robot)
    sim.reset(path[:1])
    tension = []
    for length in rest.unstrained_length[1:]:
        sim.follow(length[None], dt)
        tension.append(sim.state.tension.numpy()[0].copy())
    steady = time[1:] > ramp + 0.7
    assert np.array(tension)[steady] == pytest.approx(rest.tension[1:][steady], rel=0.02)
    assert not sim.state.numpy().capped.any()


# --- Slack and snap ----------------------------------------------------------------------------


@pytest.mark.parametrize("time_step", STEPS)
def test_a_platform_thrown_up_falls_back_into_cables_that_do_not_pull_too_hard(time_step):
    """One cable that stops it alone and straight on takes EA x^2 / (2 L) = m (v^2 / 2 + g x)."""
    robot, speed = damped(simple_robot()), 1.5
    sim = Simulator(robot, cable_drag=3.0, time_step=time_step)
    home, hold = sim.state.position.numpy().copy(), held(sim)
    sim.reset(twist=[[0.0, 0.0, speed, 0.0, 0.0, 0.0]])
    most, least = 0.0, np.inf
    for _ in range(120):
        sim.step(hold, 1.0 / 120.0)
        tension = sim.state.tension.numpy()[0]
        most, least = max(most, tension.max()), min(least, tension.min())
    stiffness = (robot.axial_stiffness / (hold[0] + robot.run_length)).max()
    snap = robot.weight + np.sqrt(robot.weight**2 + stiffness * robot.mass * speed**2)
    assert least < 0.5  # they have been slack
    assert robot.weight < most < snap
    for _ in range(20):
        sim.step(hold, 1.0)
    assert sim.state.position.numpy() == pytest.approx(home, abs=1e-9)
    assert not sim.state.failed.numpy().any()


@pytest.mark.parametrize("time_step", [1.0 / 60.0, 1.0 / 120.0, 1.0 / 240.0])
def test_random_winch_steps_lose_no_world_and_all_come_home(time_step):
    robot = damped(simple_robot())
    sim = Simulator(robot, worlds=8, time_step=time_step, cable_drag=3.0)
    home, rest = held(sim), sim.state.position.numpy().copy()
    rng = np.random.default_rng(0)
    slack = 0
    for _ in range(12):
        command = home + rng.uniform(-0.3, 0.3, home.shape)
        for _ in range(5):
            sim.step(command, 0.1)
            state = sim.state.numpy()
            assert np.isfinite(state.position).all() and np.isfinite(state.tension).all()
            slack += (state.tension < 1.0).sum()
    assert slack > 20
    for _ in range(25):
        sim.step(home, 1.0)
    state = sim.state.numpy()
    assert not state.failed.any()
    assert state.position == pytest.approx(rest, abs=1e-6)


def test_every_change_of_the_active_set_is_seen():
    """Also one that leaves a weighted sum over the slack segments as it was."""
    segments, time_step = 4, 1.0 / 120.0
    sim = Simulator(simple_robot(), worlds=16, segments=segments, time_step=time_step)
    home, rng = held(sim), np.random.default_rng(7)
    slack, rough, last = [], [], []
    for k in range(240):
        if k % 30 == 0:
            command = home + rng.uniform(-0.2, 0.2, home.shape)
        sim.step(command, time_step)
        arrays = sim.save().arrays
        slack.append(~(arrays["cable_predicted"] > 0.0))
        rough.append(arrays["rough"])
        last.append(arrays["last"])
    changed = np.diff(slack, axis=0).any(axis=(2, 3))
    k, i = np.arange(segments), np.arange(4)[:, None]
    weighted = (np.array(slack) * (1.0 + k + i * segments + 0.5 * k**2)).sum(axis=(2, 3))
    assert (changed & (np.diff(weighted, axis=0) == 0.0)).any()
    restarted = np.array(rough) == np.max(rough)  # the count of rough steps to go starts anew
    whole = np.isclose(last, time_step)  # time steps taken in parts end with one of these
    assert whole.mean() > 0.9
    assert np.array_equal(restarted[1:][whole[1:]], changed[whole[1:]])
