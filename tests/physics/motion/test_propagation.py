"""Motion from any state: what the filters build on."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from carosac_toolkit.physics.motion.propagation import Motions, Propagation
from carosac_toolkit.physics.rest.modes import natural_modes
from sim_warp import Simulator

POINT = np.array([[0.6, -1.2, 2.6]])


@pytest.fixture(scope="module")
def robot():
    return ct.load_robot("carosac")


@pytest.fixture(scope="module")
def rest(robot):
    return ct.statics.inverse_kinematics(robot, POINT)


def let_go(rest, twist, force=(0.0, 0.0, 0.0)):
    twist = np.atleast_2d(twist)
    size = len(twist)
    return Motions(
        position=np.repeat(rest.position, size, axis=0),
        rotation=np.repeat(rest.rotation, size, axis=0),
        twist=twist,
        force=np.tile(np.asarray(force), (size, 1)),
    )


def test_a_platform_at_rest_stays_there(robot, rest):
    length = rest.unstrained_length
    end = Propagation(robot, 1).run(let_go(rest, np.zeros(6)), length, length, 1.0)
    assert end.position == pytest.approx(rest.position, abs=1e-6)
    assert end.tension == pytest.approx(rest.tension, rel=1e-5)
    assert np.abs(end.acceleration).max() < 1e-4


def test_first_acceleration_is_force_over_mass(robot, rest):
    """A sudden push through the centre of mass; cables have had no time to answer."""
    light = replace(robot, linear_density=robot.linear_density * 1e-3)
    calm = ct.statics.inverse_kinematics(light, POINT)
    push = np.array([3.0, -2.0, 0.0])
    length = calm.unstrained_length
    end = Propagation(light, 1).run(let_go(calm, np.zeros(6), push), length, length, 1e-5)
    arm = calm.rotation[0] @ light.center_of_mass
    center = end.acceleration[0, :3] + np.cross(end.acceleration[0, 3:], arm)
    assert center == pytest.approx(push / light.mass, rel=1e-3, abs=1e-5)


def test_pieces_of_a_motion_are_the_whole(robot, rest):
    """Nothing is remembered from call to call, and still it is of second order."""
    pace = np.array([[0.3, -0.2, 0.1, 0.05, 0.2, 0.1]])
    sim = Simulator(robot, cables="catenary", time_step=5e-4)
    sim.reset(POINT, twist=pace)
    pieces = Propagation(robot, 1)
    now, length = let_go(rest, pace), rest.unstrained_length
    for _ in range(100):
        longer = length + 0.001 * np.array([1.0, -1.0, 0.5, 0.2])
        now = pieces.run(now, length, longer, 0.01)
        sim.follow(longer, 0.01)
        length = longer
    state = sim.state.numpy()
    assert now.position == pytest.approx(state.position, abs=3e-3)
    assert now.twist[:, :3] == pytest.approx(state.twist[:, :3], abs=0.05)


def test_pieces_of_a_motion_with_dry_friction_are_the_whole(robot, rest):
    """Bristles are handed on: a platform that turns back rubs as one that was never let go anew."""
    dry = replace(robot, exit_friction=np.full(4, 0.05), anchor_friction=np.full(4, 0.01))
    kick = 0.2 * natural_modes(dry, rest).shape[0, :, 0][None]
    length = rest.unstrained_length
    sims = [Simulator(each, cables="catenary", time_step=2e-3) for each in (dry, robot)]
    pieces = Propagation(dry, 1)
    now = forgetful = let_go(rest, kick)
    for sim in sims:
        sim.reset(POINT, twist=kick)
    away = {"handed on": 0.0, "forgotten": 0.0, "none": 0.0}
    for _ in range(100):
        now = pieces.run(now, length, length, 0.05)
        forgetful = pieces.run(replace(forgetful, bristles=None), length, length, 0.05)
        for sim in sims:
            sim.follow(length, 0.05)
        there = [sim.state.numpy().position for sim in sims]
        for name, here in zip(away, (now.position, forgetful.position, there[1]), strict=True):
            away[name] = max(away[name], float(np.abs(here - there[0]).max()))
    assert away["handed on"] < 0.1 * away["none"]
    assert away["handed on"] < 0.3 * away["forgotten"]


def bounces(robot):
    """Return a robot that slips over its pulleys as it bounces, at rest, and a kick."""
    slipping = replace(
        robot, run_length=np.full(4, 6.0), axial_stiffness=np.full(4, 2e4),
        axial_damping=np.zeros(4), capstan_friction=np.full(4, 0.2),
    )  # fmt: skip
    rest = ct.statics.inverse_kinematics(slipping, POINT)
    return slipping, rest, np.array([[0.0, 0.0, 0.2, 0.0, 0.0, 0.0]])


def test_pieces_of_a_bounce_slip_over_pulleys_as_the_whole(robot):
    slipping, rest, kick = bounces(robot)
    length = rest.unstrained_length
    sims = [
        Simulator(each, cables="catenary", time_step=1e-3)
        for each in (slipping, replace(slipping, capstan_friction=np.zeros(4)))
    ]
    pieces, now = Propagation(slipping, 1), let_go(rest, kick)
    for sim in sims:
        sim.reset(POINT, twist=kick)
    away = np.zeros(2)
    for _ in range(60):
        now = pieces.run(now, length, length, 0.02)
        for k, sim in enumerate(sims):
            sim.follow(length, 0.02)
            here = sim.state.numpy().position
            away[k] = max(away[k], float(np.abs(now.position - here).max()))
    assert away[0] < 0.1 * away[1]


def test_a_length_that_is_corrected_is_no_slip_over_a_pulley(robot):
    """As an estimator corrects the zero of an encoder, and where the platform is by that."""
    slipping, rest, _ = bounces(robot)
    pieces = Propagation(slipping, 1)
    now = pieces.run(let_go(rest, np.zeros((1, 6))), *[rest.unstrained_length] * 2, 0.05)
    other = rest.unstrained_length + 1e-3
    moved = ct.statics.forward_kinematics(slipping, other, guess=rest)
    now = replace(now, position=moved.position, rotation=moved.rotation)
    after = pieces.run(now, other, other, 0.1)
    assert np.abs(after.position - moved.position).max() < 1e-6


def test_sway_has_the_natural_frequency(robot, rest):
    modes = natural_modes(robot, rest)
    period = 1.0 / modes.frequency[0, 0]
    kick = 0.02 * modes.shape[0, :, 0]
    pieces = Propagation(robot, 1, cable_drag=0.0)
    now, length = let_go(rest, kick), rest.unstrained_length
    along = modes.shape[0, :, 0] / np.linalg.norm(modes.shape[0, :, 0])
    twists = []
    for _ in range(round(2.0 * period / 0.01)):
        now = pieces.run(now, length, length, 0.01)
        twists.append(now.twist[0] @ along)
    crossings = np.flatnonzero(np.diff(np.sign(twists)) != 0) * 0.01
    assert np.diff(crossings).mean() == pytest.approx(0.5 * period, rel=0.02)


def test_derivatives_hold_at_a_turned_pose(robot, rest):
    """A step is smooth: half the difference is half the change."""
    turn = Rotation.from_rotvec([0.05, -0.08, 0.1]).as_matrix()
    start = let_go(rest, np.zeros((3, 6)))
    start = replace(start, rotation=turn @ start.rotation)
    start = replace(start, twist=start.twist + np.array([[0.0], [1e-3], [2e-3]]))
    length = np.repeat(rest.unstrained_length, 3, axis=0)
    end = Propagation(robot, 3).run(start, length, length, 0.02)
    change = end.position[1:] - end.position[0]
    assert change[1] == pytest.approx(2.0 * change[0], rel=1e-3, abs=1e-9)


def test_neighbours_stay_neighbours_through_a_jerk(robot, rest):
    """Filters difference motions side by side, also where a tension falls by half in a step."""
    up = np.linspace(0.0, 2.0, 201)
    kick = np.zeros((201, 6))
    kick[:, 2] = up
    length = np.repeat(rest.unstrained_length, 201, axis=0)
    end = Propagation(robot, 201).run(let_go(rest, kick), length, length, 0.05)
    assert end.tension.min() < 0.05 * rest.tension.min()
    assert np.abs(np.diff(end.position, 2, axis=0)).max() < 5e-5
    assert np.abs(np.diff(end.twist, 2, axis=0)).max() < 5e-3


def test_mass_and_centre_of_mass_can_be_changed(robot, rest):
    heavy = replace(robot, mass=1.1 * robot.mass, center_of_mass=np.array([0.01, 0.0, -0.1]))
    hung = ct.statics.forward_kinematics(heavy, rest.unstrained_length)
    loaded = Propagation(robot, 1)
    loaded.load(heavy.mass, heavy.center_of_mass)
    start = Motions(
        position=hung.position, rotation=hung.rotation, twist=np.zeros((1, 6)),
        force=np.zeros((1, 3)),
    )  # fmt: skip
    end = loaded.run(start, rest.unstrained_length, rest.unstrained_length, 0.5)
    assert end.position == pytest.approx(hung.position, abs=1e-5)
