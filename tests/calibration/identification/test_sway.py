"""Motion at the first sample: along free directions, on cables of constant length."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from calibration.identification.fit import Fitter
from calibration.identification.measured_poses import poses_of
from calibration.identification.runs import FittedRun
from calibration.identification.settings import IdentificationSettings
from calibration.identification.sway import find_sway, swaying_states
from calibration.identification.unknowns import choose_coordinates
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.physics.fleet import Fleet
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.modes import natural_frequencies
from carosac_toolkit.physics.rest.structure import structure_matrix
from tests.calibration.identification.oscillations import free_oscillation
from tests.robots import eight_cable_robot, hanging

ROBOTS = {"carosac": ct.load_robot("carosac"), "three": hanging(3), "two": hanging(2)}
EACH = pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS.keys())


def at_home(robot):
    return statics.inverse_kinematics(robot, robot.home_position[None])


def start(sway, robot, rest, rate, coordinates):
    """Return position, rotation and twist of one robot that starts."""
    pose = Pose(position=rest.position, rotation=rest.rotation)
    states = swaying_states(
        [sway], Fleet([robot]), pose, rest.unstrained_length, rate[None], coordinates[None]
    )
    return [state[0] for state in states]


def at_rest(robot, rest):
    """Sway of a platform that seems to rest."""
    recording, _ = free_oscillation(robot, 0, swing=1e-6, duration=1.0)
    return find_sway(robot, rest, poses_of(recording), moves=False)


@EACH
def test_free_directions_are_the_slow_modes_and_change_no_length(robot):
    rest = at_home(robot)
    sway = at_rest(robot, rest)
    count = 6 - robot.n
    assert sway.shape.shape == (6, count)
    rates = structure_matrix(robot, rest.position, rest.rotation)[0].T @ sway.shape
    assert rates == pytest.approx(np.zeros((robot.n, count)), abs=1e-12)
    slow = natural_frequencies(robot, rest)[0, :count]
    assert sway.frequency / (2.0 * np.pi) == pytest.approx(slow, rel=0.02)


@EACH
def test_a_large_displacement_keeps_the_straight_lengths_and_the_twist_follows_the_winches(robot):
    rest = at_home(robot)
    sway = at_rest(robot, rest)
    coordinates = 0.1 * np.sign(np.sin(np.arange(1, 1 + len(sway.sigma)))) / sway.sigma
    rate = np.linspace(-0.2, 0.3, robot.n)
    position, rotation, twist = start(sway, robot, rest, rate, coordinates)
    tilt = Rotation.from_matrix(rotation @ rest.rotation[0].T).magnitude()
    assert tilt > np.radians(5.0)
    straight = straight_length(robot, position[None], rotation[None]).length
    kept = straight_length(robot, rest.position, rest.rotation).length
    assert straight == pytest.approx(kept, abs=1e-9)
    wound = -structure_matrix(robot, position[None], rotation[None])[0].T @ twist
    assert wound == pytest.approx(rate, abs=1e-9)


def test_eight_cables_leave_nothing_free_and_move_with_their_winches():
    robot = eight_cable_robot()
    rest = at_home(robot)
    sway = find_sway(robot, rest, None, moves=True)
    assert sway.guess.shape == (0,) and sway.names == ()
    motion = np.array([0.2, -0.1, 0.3, 0.1, 0.2, -0.1])
    rate = -structure_matrix(robot, rest.position, rest.rotation)[0].T @ motion
    position, rotation, twist = start(sway, robot, rest, rate, np.zeros(0))
    assert position == pytest.approx(rest.position[0]) and rotation == pytest.approx(
        rest.rotation[0]
    )
    assert twist == pytest.approx(motion, abs=1e-9)


@EACH
def test_the_guess_is_the_first_measured_pose_and_speed(robot):
    recording, (position, rotation) = free_oscillation(robot, 1, swing=0.2, duration=2.0)
    rest = at_home(robot)
    sway = find_sway(robot, rest, poses_of(recording), moves=True)
    found = start(sway, robot, rest, np.zeros(robot.n), sway.guess)
    swing = np.abs(position - rest.position[0]).max()
    assert found[0] == pytest.approx(position[0], abs=0.02 * swing + 2e-3)
    off = Rotation.from_matrix(found[1] @ rotation[0].T).magnitude()
    assert off < 0.02
    speed = np.gradient(position, 0.01, axis=0, edge_order=2)
    assert found[2][:3] == pytest.approx(speed[0], abs=0.05 * np.abs(speed).max() + 0.02)


@EACH
def test_a_start_in_motion_stretches_cables(robot):
    """Elongations are lengths of straight cables, their rates those of a platform that moves."""
    recording, _ = free_oscillation(robot, 1, swing=0.2, duration=2.0)
    rest = at_home(robot)
    sway = find_sway(robot, rest, poses_of(recording), moves=True)
    free, n = 6 - robot.n, robot.n
    assert len(sway.names) == len(sway.guess) == 2 * free + 2 * n
    rng = np.random.default_rng(2)
    coordinates = sway.guess + np.concatenate([
        np.zeros(2 * free), 0.3 * rng.standard_normal(2 * n)
    ])  # fmt: skip
    longer, faster = sway.elongations(coordinates)
    position, rotation, twist = start(sway, robot, rest, np.zeros(n), coordinates)
    pose = position[None], rotation[None]
    straight = (
        straight_length(robot, *pose).length
        - straight_length(robot, rest.position, rest.rotation).length
    )
    assert straight[0] == pytest.approx(longer, abs=1e-9)
    jacobian = -structure_matrix(robot, *pose)[0].T
    assert jacobian @ twist == pytest.approx(faster, abs=1e-9)


@EACH
def test_a_start_before_the_first_pose_is_where_the_sway_came_from(robot):
    """Undamped modes run through whole periods: half a period ago the sway was opposite."""
    recording, _ = free_oscillation(robot, 1, swing=0.02, duration=2.0)
    rest, poses = at_home(robot), poses_of(recording)
    here = find_sway(robot, rest, poses, moves=True)
    half = np.pi / here.frequency[0]
    earlier = find_sway(robot, rest, poses, moves=True, before=half)
    assert earlier.begin == pytest.approx(poses.time[0] - half)
    assert here.begin is None and len(earlier.stretch_sigma) == 0
    now, then = here.values(here.guess), earlier.values(earlier.guess)
    assert then[0][0] == pytest.approx(-now[0][0]) and then[1][0] == pytest.approx(-now[1][0])
    energy = [(here.frequency * away) ** 2 + speed**2 for away, speed in (now, then)]
    assert energy[0] == pytest.approx(energy[1])


def test_what_is_left_for_the_robot_is_the_information_behind_its_covariance():
    """Schur complement: its inverse, with the prior, is the block of the joint inverse."""
    robot = ROBOTS["carosac"]
    unknowns = choose_coordinates(robot, IdentificationSettings())
    run = FittedRun(path=None, poses=None, rate=10.0, sway=at_rest(robot, at_home(robot)))
    fitter = Fitter(unknowns, [run], IdentificationSettings(time_step=0.01))
    count = len(unknowns.prior.names)
    root = np.random.default_rng(0).standard_normal((count + 4, count + 4))
    joint = root @ root.T
    prior = unknowns.prior.information
    left = fitter.cost.marginal(joint)
    block = np.linalg.inv(joint + fitter.cost.precision)[:count, :count]
    assert np.linalg.inv(left + prior) == pytest.approx(block, rel=1e-6, abs=1e-9)
    assert np.linalg.eigvalsh(joint[:count, :count] - left).min() > -1e-9  # it takes, never gives
