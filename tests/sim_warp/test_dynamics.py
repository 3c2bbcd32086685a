"""Catenaries and straight cables on a rigid platform: against pin, statics and each other."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import curve_fit
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from carosac_toolkit.physics.rest.modes import mass_matrix, natural_modes
from sim_warp import Simulator
from tests import reference as cable_reference
from tests.robots import eight_cable_robot, simple_robot, with_pulleys
from tests.sim_warp import reference
from tests.sim_warp.test_reference import lopsided
from tests.sim_warp.worlds import KICK, aside, damped, held, undamped

TUMBLE = np.array([[0.3, -0.2, 0.5, 2.0, -3.0, 1.5]])


def cut_loose(sim, length=60.0):
    """Pay out so much cable at once that none pulls; returns the command that leaves it so."""
    snapshot = sim.save()
    snapshot.arrays["winch"]["length"][...] = length
    snapshot.arrays["winch"]["wound"][...] = length
    sim.restore(snapshot)
    return np.full((sim.size, sim.fleet.n), length)


def motion_after(robot, time_step, duration, twist, cables="catenary", every=None, **options):
    """Lengths held, and states every so often after a start at home with a twist."""
    sim = Simulator(robot, cables=cables, time_step=time_step, **options)
    sim.reset(twist=twist)
    hold, states = held(sim), []
    for _ in range(1 if every is None else round(duration / every)):
        sim.step(hold, every or duration)
        states.append(sim.state.numpy())
    return states


# --- A free body -------------------------------------------------------------------------------


def test_without_cables_the_platform_tumbles_as_pin_says_to_second_order():
    robot = undamped(lopsided(simple_robot()))
    turns, speeds = [], []
    for time_step in (1.0 / 50.0, 1.0 / 100.0, 1.0 / 200.0):
        sim = Simulator(robot, cables="straight", time_step=time_step)
        sim.reset(twist=TUMBLE)
        loose = cut_loose(sim)
        sim.step(loose, 0.2)  # the jump of the force as the cables vanish is over
        start = sim.state.numpy()
        sim.step(loose, 0.6)
        end = sim.state.numpy()
        flight = reference.free_flight(
            robot, start.position[0], start.rotation[0], start.twist[0], 0.6
        )
        assert not end.tension.any()
        centers = [m.position[0] + m.rotation[0] @ robot.center_of_mass for m in (end, flight)]
        assert centers[0] == pytest.approx(centers[1], abs=1e-5)  # parabolas are exact
        turns.append(np.abs(end.rotation - flight.rotation).max())
        speeds.append(np.abs(end.twist - flight.twist).max())
    assert turns[-1] < 2e-4
    for miss in (np.array(turns), np.array(speeds)):
        assert miss[:-1] / miss[1:] == pytest.approx(4.0, abs=0.5)


def test_it_falls_no_faster_than_its_drag_allows():
    robot = simple_robot(drag=100.0, angular_drag=5.0, center_of_mass=np.zeros(3))
    sim = Simulator(robot, cables="straight", time_step=1.0 / 240.0)
    loose = cut_loose(sim, 80.0)
    limit, time = robot.weight / robot.drag, robot.mass / robot.drag
    for _ in range(6):
        sim.step(loose, 0.25)
        seconds = sim.state.time.numpy()[0]
        # Weight acts at once: the scheme takes half a time step to notice.
        speed = -limit * (1.0 - np.exp(-seconds / time))
        assert sim.state.twist.numpy()[0, 2] == pytest.approx(speed, abs=0.01 * limit)
    sim.step(loose, 3.0)
    assert sim.state.twist.numpy()[0] == pytest.approx([0, 0, -limit, 0, 0, 0], abs=1e-4)


def test_reported_acceleration_is_the_rate_of_the_twist():
    robot = lopsided(simple_robot())
    h = 1.0 / 2000.0
    states = motion_after(robot, h, 0.2, TUMBLE / 4.0, every=h)
    twist = np.array([state.twist[0] for state in states])
    rate = (twist[2:] - twist[:-2]) / (2.0 * h)
    # The scheme counts forces alpha h = 0.18 h late or early; that is all that differs.
    near = 2.0 * np.abs(np.diff(rate[300:], axis=0)).max(axis=0) + 1e-3
    given = np.array([state.acceleration[0] for state in states])[1:-1]
    assert (np.abs(given - rate)[300:] < near).all()


@pytest.mark.parametrize("cables", ["straight", "xpbd"])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_air_takes_spin_about_each_axis_by_its_own_factor(cables, axis):
    """About a principal axis spin falls by exp(-t d / I); steps of ``xpbd`` are of first order."""
    factors, inertia = np.array([0.5, 1.0, 3.0]), np.array([0.5, 0.6, 0.7])
    robot = replace(
        simple_robot(inertia=np.diag(inertia), center_of_mass=np.zeros(3)),
        drag=0.0, angular_drag=1.0, angular_drag_axes=factors,
        linear_density=np.full(4, 1e-9), cable_drag=0.0,
    )  # fmt: skip
    sim = Simulator(robot, cables=cables, time_step=1e-3)
    about = sim.state.rotation.numpy()[:, :, axis]
    sim.reset(twist=np.hstack([np.zeros((1, 3)), about]))
    loose = cut_loose(sim)
    sim.step(loose, 0.1)
    before = sim.state.twist.numpy()[0, 3:] @ about[0]
    sim.step(loose, 0.3)
    share = sim.state.twist.numpy()[0, 3:] @ about[0] / before
    assert share == pytest.approx(np.exp(-0.3 * factors[axis] / inertia[axis]), rel=4e-3)


@pytest.mark.parametrize("cables", ["catenary", "particles", "xpbd"])
def test_each_robot_has_the_cable_drag_of_its_file(cables):
    plain = simple_robot()
    robots = [replace(plain, cable_drag=drag) for drag in (0.0, 3.0)]
    options = {"cables": cables, "time_step": 1.0 / 240.0}
    together = motion_after(robots, 1.0 / 240.0, 0.5, np.repeat(KICK, 2, axis=0), cables)[0]
    for k, robot in enumerate(robots):
        alone = motion_after(robot, duration=0.5, twist=KICK, **options)[0]
        asked = motion_after(plain, duration=0.5, twist=KICK, **options, cable_drag=3.0 * k)[0]
        for name in ("position", "twist", "tension"):
            assert np.array_equal(getattr(alone, name), getattr(asked, name))
            assert np.array_equal(getattr(alone, name)[0], getattr(together, name)[k])
    assert np.abs(together.twist[0] - together.twist[1]).max() > 1e-3


# --- Catenaries --------------------------------------------------------------------------------


def test_on_catenaries_the_platform_moves_as_pin_says_to_second_order():
    """Soft cables, so that steps of 1/100 s resolve the fastest mode; air about each axis."""
    robot = replace(
        undamped(lopsided(simple_robot(axial_stiffness=np.full(4, 2e4)))), drag=8.0,
        angular_drag=2.0, angular_drag_axes=np.array([0.2, 1.0, 2.5]),
    )  # fmt: skip
    steps = (1.0 / 100.0, 1.0 / 200.0, 1.0 / 400.0, 1.0 / 1000.0)
    ends = [motion_after(robot, h, 0.6, KICK, cable_drag=0.0)[0] for h in steps]
    start = Simulator(robot, cables="catenary").state.numpy()
    exact = reference.dynamics_oracle(
        robot, start.unstrained_length[0], start.position[0], start.rotation[0], KICK[0], 0.6,
        cable_mass=True, rtol=1e-7,
    )  # fmt: skip
    for name, near in (("position", 5e-6), ("rotation", 2e-5), ("twist", 5e-4), ("tension", 2e-2)):
        miss = np.array([np.abs(getattr(e, name) - getattr(exact, name)).max() for e in ends])
        assert miss[3] < near, name
        assert miss[1] / miss[2] == pytest.approx(4.0, abs=0.6), name
        assert miss[0] > miss[1], name


def test_catenaries_swing_as_chains_of_masses_do():
    """A sway of 0.15 m over 6 s; the waves in the cables are all that catenaries leave out."""
    robot = simple_robot()
    _, shapes = reference.linear_modes(robot, aside(robot), cable_mass=True)
    twist = 0.5 * shapes[:, :1].T / np.linalg.norm(shapes[:3, 0])
    path = [
        np.array([s.position[0] for s in motion_after(robot, h, 6.0, twist, cables, every=0.05)])
        for cables, h in (("catenary", 1.0 / 100.0), ("particles", 1.0 / 240.0))
    ]
    assert np.ptp(path[0], axis=0).max() > 0.25
    assert np.sqrt(((path[0] - path[1]) ** 2).sum(axis=1).mean()) < 1.5e-3


@pytest.mark.parametrize("cables", ["catenary", "straight"])
@pytest.mark.parametrize("robot", [simple_robot(), with_pulleys(simple_robot())])
def test_slow_and_fast_modes_have_the_frequencies_of_the_linearised_statics(robot, cables):
    """Swings of 0.1 mm, so that cables stay taut; steps of 1/100 of a period shift it by 3e-4."""
    robot = undamped(robot)
    if cables == "straight":
        robot = replace(robot, linear_density=np.full(4, 1e-7))
    rest = aside(robot)
    frequency, shapes = reference.linear_modes(robot, rest, cable_mass=True)
    for mode in (0, 2, 5):
        f, shape = frequency[mode], shapes[:, mode]
        sim = Simulator(robot, cables=cables, time_step=0.01 / f, cable_drag=0.0)
        twist = 2.0 * np.pi * f * 1e-4 * shape / np.linalg.norm(shape)
        sim.reset(rest.position, twist=twist[None])
        hold, along, speed = held(sim), cable_reference.mass_matrix(robot, rest.rotation[0]), []
        for _ in range(160):
            sim.step(hold, 0.05 / f)
            speed.append(sim.state.twist.numpy()[0] @ along @ shape)
        time = 0.05 / f * np.arange(1, 161)
        (found, *_), _ = curve_fit(
            lambda t, f, a, b: a * np.cos(2 * np.pi * f * t) + b * np.sin(2 * np.pi * f * t),
            time,
            speed,
            p0=[f, speed[0], 0.0],
        )
        assert found == pytest.approx(f, rel=2e-3), mode


@pytest.mark.parametrize("cables", ["catenary", "straight", "particles"])
def test_a_platform_released_away_from_equilibrium_swings_in_its_linear_mode(cables):
    """From 1 mm aside the motion is a cosine of the mode's frequency, and gains no energy."""
    robot = undamped(with_pulleys(simple_robot()))
    if cables == "straight":
        robot = replace(robot, linear_density=np.full(4, 1e-7))
    rest = aside(robot)
    modes = natural_modes(robot, rest)
    f, shape = modes.frequency[0, 0], modes.shape[0, :, 0]
    amplitude = 1e-3 / np.linalg.norm(shape)
    sim = Simulator(robot, cables=cables, time_step=0.004 / f, cable_drag=0.0)
    turn = Rotation.from_rotvec(amplitude * shape[3:]).as_matrix() @ rest.rotation[0]
    place = rest.position + amplitude * shape[:3]
    sim.reset(place, turn[None], unstrained_length=rest.unstrained_length)
    start = sim.state.numpy()
    assert start.position == pytest.approx(place, abs=1e-12)
    assert start.rotation[0] == pytest.approx(turn, abs=1e-12)
    assert np.array_equal(start.unstrained_length, rest.unstrained_length)
    mass = mass_matrix(robot, rest.rotation, rest.unstrained_length)[0]
    time, share, energy = 0.05 / f * np.arange(1, 61), [], []
    for _ in time:
        sim.step(rest.unstrained_length, 0.05 / f)
        state = sim.state.numpy()
        share.append((state.position[0] - rest.position[0]) @ shape[:3] / (shape[:3] @ shape[:3]))
        energy.append(0.5 * state.twist[0] @ mass @ state.twist[0])
    share = np.array(share) / amplitude
    (found, height), _ = curve_fit(
        lambda t, f, a: a * np.cos(2.0 * np.pi * f * t), time, share, p0=[f, 1.0]
    )
    assert found == pytest.approx(f, rel=2e-3)
    assert height == pytest.approx(1.0, abs=0.02)
    assert max(energy) == pytest.approx(0.5 * (2.0 * np.pi * f * amplitude) ** 2, rel=0.05)


@pytest.mark.parametrize("cables", ["catenary", "straight", "particles"])
def test_a_platform_released_at_its_equilibrium_stays_there(cables):
    robot = with_pulleys(simple_robot())
    sim = Simulator(robot, cables=cables)
    sim.reset(aside(robot).position)
    rest = sim.state.numpy()
    sim.reset(rest.position, rest.rotation, unstrained_length=rest.unstrained_length)
    sim.step(rest.unstrained_length, 1.0)
    assert sim.state.numpy().position == pytest.approx(rest.position, abs=1e-8)


@pytest.mark.parametrize("robot", [simple_robot(), with_pulleys(eight_cable_robot())])
def test_catenaries_rest_where_statics_says(robot):
    rest = aside(robot)
    sim = Simulator(damped(robot), cables="catenary")
    sim.reset(rest.position, twist=KICK)
    for _ in range(20):
        sim.step(rest.unstrained_length, 1.0)
    state = sim.state.numpy()
    assert state.position == pytest.approx(rest.position, abs=1e-9)
    assert state.rotation == pytest.approx(rest.rotation, abs=1e-9)
    assert state.tension == pytest.approx(rest.tension, abs=1e-4)


# --- Straight cables ---------------------------------------------------------------------------


@pytest.mark.parametrize("robot", [simple_robot(), with_pulleys(eight_cable_robot())])
def test_straight_cables_rest_where_weightless_ones_hang(robot):
    light = replace(robot, linear_density=np.full(robot.n, 1e-9))
    rest = aside(light)
    sim = Simulator(damped(robot), cables="straight")
    sim.reset(rest.position, twist=KICK)
    for _ in range(20):
        sim.step(rest.unstrained_length, 1.0)
    state = sim.state.numpy()
    assert state.position == pytest.approx(rest.position, abs=1e-8)
    assert state.tension == pytest.approx(rest.tension, abs=2e-3)
    there = state.position[0] + robot.anchor_points @ state.rotation[0].T
    if not robot.pulley_radius.any():
        span = np.linalg.norm(there - robot.exit_points, axis=1)
        length = rest.unstrained_length[0]
        pull = robot.axial_stiffness * (span - length) / (length + robot.run_length)
        assert state.tension[0] == pytest.approx(pull, abs=1e-5)


def test_a_straight_cable_that_is_too_long_does_not_push():
    robot = simple_robot()
    sim = Simulator(damped(robot), cables="straight")
    length = held(sim) + np.array([0.3, 0.0, 0.0, 0.0])
    for _ in range(20):
        sim.step(length, 1.0)
    tension = sim.state.tension.numpy()[0]
    assert tension[0] == 0.0
    assert (tension[1:] > 5.0).all()


# --- Damping, drag and wind --------------------------------------------------------------------


@pytest.mark.parametrize("cables", ["catenary", "straight"])
def test_damping_of_the_cables_takes_their_stretching_away(cables):
    """Damping in proportion to stiffness: a mode decays by omega * time / 2 of critical, 5 %."""
    robot = undamped(simple_robot(run_length=np.zeros(4)))
    if cables == "straight":
        robot = replace(robot, linear_density=np.full(4, 1e-7))
    rest = aside(robot)
    frequency, shapes = reference.linear_modes(robot, rest, cable_mass=True)
    bounce = 5
    omega = 2.0 * np.pi * frequency[bounce]
    time = 0.1 / omega
    wet = replace(robot, axial_damping=time * robot.axial_stiffness)
    twist = 1e-4 * omega * shapes[:, bounce] / np.linalg.norm(shapes[:, bounce])
    sim = Simulator(wet, cables=cables, time_step=0.002 / frequency[bounce], cable_drag=0.0)
    sim.reset(rest.position, twist=twist[None])
    hold, speed = held(sim), []
    mass = cable_reference.mass_matrix(robot, rest.rotation[0])
    for _ in range(6):
        sim.step(hold, 1.0 / frequency[bounce])
        speed.append(sim.state.twist.numpy()[0] @ mass @ twist)
    ratio = np.array(speed[1:]) / speed[:-1]
    assert ratio == pytest.approx(np.exp(-np.pi * omega * time), rel=0.03)


def test_wind_has_the_deviation_and_the_memory_it_was_given_and_only_blows_sideways():
    """64 worlds, 40 s: 2560 correlation times of 1 s along each axis, 2 % of the deviation."""
    options = {"cables": "straight", "worlds": 64, "wind_force": 3.0, "wind_time": 1.0}
    first, second = (
        Simulator(damped(simple_robot()), time_step=0.05, seed=4, **options) for _ in range(2)
    )
    hold, force = held(first), []
    for _ in range(400):
        first.step(hold, 0.1)
        force.append(first.save().arrays["gusts"]["force"])
    force = np.array(force)
    assert not force[..., 2].any()
    side = force[..., :2]
    assert side.mean() == pytest.approx(0.0, abs=0.15)
    assert side.std(axis=(0, 1)) == pytest.approx(3.0, rel=0.05)
    assert side[0].std() == pytest.approx(3.0, rel=0.25)  # at once: 128 numbers
    for lag in (5, 10, 20):
        memory = (side[lag:] * side[:-lag]).mean() / side.var()
        assert memory == pytest.approx(np.exp(-0.1 * lag), abs=0.06)
    across = (side[..., 0] * side[..., 1]).mean() / side.var()
    assert across == pytest.approx(0.0, abs=0.06)
    for k in range(3):
        second.step(hold, 0.1)
        assert np.array_equal(second.save().arrays["gusts"]["force"], force[k])


def test_a_steady_push_moves_the_platform_as_its_stiffness_says():
    """Wind without end: constant for a run, so that the platform leans and stays."""
    robot = damped(simple_robot())
    sim = Simulator(robot, cables="catenary", wind_force=2.0, wind_time=1e9)
    start, hold = sim.state.numpy(), held(sim)
    for _ in range(20):
        sim.step(hold, 1.0)
    state = sim.state.numpy()
    gust = sim.save().arrays["gusts"]["force"][0]
    assert np.abs(gust[:2]).min() > 0.01
    rest = ct.statics.inverse_kinematics(robot, robot.home_position[None])
    lever = rest.rotation[0] @ robot.center_of_mass  # it acts at the centre of mass
    wrench = np.append(gust, np.cross(lever, gust))
    leaning = np.linalg.solve(rest.stiffness[0], wrench)[:3]
    assert state.position[0] - start.position[0] == pytest.approx(leaning, abs=2e-5)
    assert np.linalg.norm(leaning) > 1e-3


def test_time_steps_do_not_change_the_wind():
    forces = []
    for time_step in (1.0 / 75.0, 1.0 / 240.0):
        sim = Simulator(
            simple_robot(), cables="catenary", wind_force=2.0, seed=3, time_step=time_step
        )
        hold, course = held(sim), []
        for _ in range(20):
            sim.step(hold, 0.1)
            course.append(sim.save().arrays["gusts"]["force"][0])
        forces.append(course)
    assert np.array(forces[0]) == pytest.approx(np.array(forces[1]), abs=1e-9)
    assert np.std(forces[0], axis=0)[:2].min() > 0.1


def test_a_robot_that_cannot_rest_at_home_waits_for_a_place_where_it_can():
    robot = simple_robot()
    away = replace(robot, home_position=robot.home_position + np.array([0.0, 0.0, 50.0]))
    sim = Simulator([robot, away], cables="catenary")
    assert sim.state.numpy().failed.tolist() == [False, True]
    sim.reset(np.tile(robot.home_position, (2, 1)))
    assert not sim.state.numpy().failed.any()


@pytest.mark.parametrize("cables", ["particles", "catenary", "straight"])
@pytest.mark.parametrize("short", [4e-3, 1e-4, 1e-6])
def test_calls_of_unequal_length_give_no_energy(cables, short):
    """What a method remembers of a long step must not be taken for the short one's, and back."""
    robot = simple_robot()
    sim = Simulator(robot, cables=cables, time_step=8e-3)
    sim.reset(twist=KICK)
    hold, speed = held(sim), []
    for _ in range(300):
        for duration in (8e-3, short):
            sim.step(hold, duration)
        speed.append(np.linalg.norm(sim.state.twist.numpy()[0]))
    assert max(speed[200:]) < max(speed[:50])
    assert sim.state.tension.numpy().max() < 500.0


@pytest.mark.parametrize("cables", ["catenary", "straight"])
def test_cables_as_stiff_as_steel_that_snap_give_no_energy(cables):
    """Thrown platforms fall into their cables, again and again."""
    base = simple_robot()
    robot = undamped(base, axial_stiffness=10.0 * base.axial_stiffness)
    sim = Simulator(robot, worlds=32, cables=cables)
    rng = np.random.default_rng(0)
    thrown = np.concatenate([rng.normal(0.0, 1.5, (32, 3)), np.zeros((32, 3))], axis=1)
    sim.reset(twist=thrown)
    hold = held(sim)

    def energy():
        state = sim.state.numpy()
        turn = state.rotation
        mass = [cable_reference.mass_matrix(robot, turn[b]) for b in range(32)]
        moving = np.array([state.twist[b] @ mass[b] @ state.twist[b] / 2.0 for b in range(32)])
        return moving + robot.weight * (state.position + turn @ robot.center_of_mass)[:, 2]

    start, most = energy(), np.full(32, -np.inf)
    for _ in range(100):
        sim.step(hold, 0.05)
        most = np.maximum(most, energy())
    assert not sim.state.numpy().failed.any()
    assert (most - start).max() < 5.0  # J, of 80 on average; cables of 0.4 kg hold some of it
