"""Tensions of plans come back to those of rest, by pulls that add no force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from baselines.mpc import MpcSettings
from baselines.mpc.geometry import excess_at, geometry_at
from baselines.mpc.length_offsets import OFFSET_TIME
from baselines.mpc.target_reader import TargetReader
from carosac_toolkit import trajectories
from carosac_toolkit.loop.values import Belief, Reference
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.similar import similar_robot
from learned.approximate_mpc.controller import ApproximateMpc, PlanFollower
from learned.approximate_mpc.networks import network_for
from learned.approximate_mpc.plan_inputs import PlanInputs
from learned.approximate_mpc.resting_attitude import (
    GAIN,
    HELD_CYCLES,
    MISSED_MAX,
    RestingAttitude,
)
from learned.approximate_mpc.taut_cables import TautCables
from tests.learned.approximate_mpc.test_controller import drive
from tests.robots import with_pulleys

PERIOD, SHARE, GRID = 0.02, 0.04, np.linspace(0.0, 2.0, 21)


@pytest.fixture
def robot():
    return with_pulleys(ct.load_robot("carosac"))


def rest_at(robot):
    return statics.inverse_kinematics(robot, robot.home_position[None])


def null_of(robot, rest):
    """Return the tensions (n,) that add no force at a rest, of length 1."""
    direction = geometry_at(robot, rest.position[0], rest.rotation[0]).direction
    return np.linalg.svd(direction.T)[2][3]


def inputs_of(robot, rest, usual):
    place = robot.home_position
    return PlanInputs(
        position=place, rotation=rest.rotation[0], twist=np.zeros(6),
        target=place + np.zeros((len(GRID), 3)), target_velocity=np.zeros((len(GRID), 3)),
        center=np.zeros(3), acceleration=np.zeros(6), usual_tension=usual, usual_place=np.zeros(3),
    )  # fmt: skip


def attitude_of(robot):
    rest = TargetReader(robot, GRID).rest_at
    return RestingAttitude(robot, rest, TautCables(robot).wanted, SHARE, GRID, PERIOD)


def test_usual_tensions_of_rest_are_left_alone(robot):
    rest = rest_at(robot)
    plan, excess = rest.tension[0] + 5.0, np.zeros(4)
    inputs = inputs_of(robot, rest, rest.tension[0])
    more, told = attitude_of(robot).pull(inputs, plan, excess)
    assert more == pytest.approx(plan, abs=1e-6) and told == pytest.approx(excess, abs=1e-9)


def test_what_usual_tensions_miss_is_added_where_no_force_comes_of_it(robot):
    rest = rest_at(robot)
    pose = robot, rest.position[0], rest.rotation[0]
    geometry, null = geometry_at(*pose), null_of(robot, rest)
    plan = rest.tension[0]
    push = geometry.direction @ np.array([3.0, -2.0, 4.0])  # a load pulls so
    inputs = inputs_of(robot, rest, plan - 6.0 * null + push)
    more, told = attitude_of(robot).pull(inputs, plan, excess_at(*pose, plan, geometry))
    assert more - plan == pytest.approx(GAIN * 6.0 * null, rel=1e-4, abs=1e-4)
    assert np.abs(geometry.direction.T @ (more - plan)).max() < 1e-9
    assert told == pytest.approx(excess_at(*pose, more, geometry), abs=1e-9)


def test_it_never_adds_much(robot):
    rest = rest_at(robot)
    plan = rest.tension[0]
    inputs = inputs_of(robot, rest, plan - 200.0 * null_of(robot, rest))
    more, _ = attitude_of(robot).pull(inputs, plan, np.zeros(4))
    most = MISSED_MAX * robot.weight / robot.n
    assert np.abs(more - plan).max() == pytest.approx(GAIN * most)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_plan_near_a_limit_is_led_just_to_it(robot, side):
    rest, plan = rest_at(robot), rest_at(robot).tension[0]
    null = null_of(robot, rest)
    inputs = inputs_of(robot, rest, plan - 6.0 * null)
    near = int(np.argmax(side * null))
    limit = (robot.tension_max if side > 0.0 else robot.tension_min)[near]
    for inside in (0.1, 0.0, -0.1):
        plan[near] = limit - side * inside
        more, _ = attitude_of(robot).pull(inputs, plan, np.zeros(4))
        assert more - plan == pytest.approx(null * side * max(inside, 0.0) / null[near])


def test_it_makes_no_cable_weak(robot):
    """Where a cable of a rest is weak, a pull to that rest fades before the cable is."""
    rest = rest_at(robot)
    null = null_of(robot, rest)
    falls = int(np.argmin(null))
    wanted = TautCables(robot).wanted
    for above in (0.3, 0.1, 0.0, -1.0):
        usual = rest.tension[0] - 60.0 * null
        usual[falls] = wanted[falls] + above
        more, _ = attitude_of(robot).pull(inputs_of(robot, rest, usual), usual, np.zeros(4))
        assert usual[falls] - more[falls] == pytest.approx(max(above, 0.0), abs=1e-9)


def test_where_there_is_no_rest_it_does_not_pull(robot):
    rest = rest_at(robot)
    usual = rest.tension[0] - 6.0 * null_of(robot, rest)
    attitude = RestingAttitude(
        robot, lambda place: None, TautCables(robot).wanted, SHARE, GRID, PERIOD
    )
    for _ in range(HELD_CYCLES + 1):
        more, _ = attitude.pull(inputs_of(robot, rest, usual), usual, np.zeros(4))
        assert (more == usual).all()
    below = robot.exit_points[:, 2].max() + 1.0  # the cables cannot push
    assert TargetReader(robot, GRID).rest_at(np.array([0.0, 0.0, below])) is None


def test_tensions_of_rest_become_usual_along_the_way_as_those_of_plans_do(robot):
    """A plan of tensions of rest is not changed, however fast these change."""
    targets, place = TargetReader(robot, GRID), robot.home_position
    attitude, usual = attitude_of(robot), targets.at(place)
    start, most = usual, 0.0
    for k in range(60):
        way = place + np.array([0.6, 0.0, 0.0]) * (k * PERIOD + GRID[:, None])  # [m/s]
        rest = statics.inverse_kinematics(robot, way[:1])
        inputs = replace(inputs_of(robot, rest, usual), position=way[0], target=way)
        plan = targets.at(way[0])
        more, _ = attitude.pull(inputs, plan, np.zeros(4))
        most = max(most, float(np.abs(more - plan).max()))
        usual = usual + SHARE * (plan - usual)
    assert most < 0.02 * np.abs(plan - start).max()


def test_a_pull_is_held_for_some_cycles(robot):
    rest, attitude = rest_at(robot), attitude_of(robot)
    plan, null, none = rest.tension[0], null_of(robot, rest), np.zeros(4)
    first, _ = attitude.pull(inputs_of(robot, rest, plan - 6.0 * null), plan, none)
    home = inputs_of(robot, rest, plan)
    for _ in range(HELD_CYCLES - 1):
        assert attitude.pull(home, plan, none)[0] == pytest.approx(first)
    assert attitude.pull(home, plan, none)[0] == pytest.approx(plan, abs=1e-6)
    attitude.pull(inputs_of(robot, rest, plan - 6.0 * null), plan, none)
    attitude.reset()
    assert attitude.pull(home, plan, none)[0] == pytest.approx(plan, abs=1e-6)


@pytest.mark.parametrize("size", [0.1, 1.0])
def test_errors_of_plans_no_longer_add_up(size):
    """An error that lasts leads no farther than to what the pull makes up for."""
    robot = similar_robot(ct.load_robot("carosac"), size)
    rest = rest_at(robot)
    null, weight = null_of(robot, rest), robot.weight / robot.n
    wrong = 0.001 * weight * null
    time = OFFSET_TIME.of(Scales(robot).ratios)
    away = {}
    for turns_back in (False, True):
        follower = PlanFollower(robot, MpcSettings(), turns_back=turns_back)
        belief = Belief(
            time=np.zeros(1), position=rest.position, rotation=rest.rotation,
            twist=np.zeros((1, 6)), tension=rest.tension,
        )  # fmt: skip
        follower.reset(belief)
        rows = round(follower.horizon / follower.period) + 1
        place = np.broadcast_to(rest.position[0], (1, rows, 3))
        still = Reference(
            time=follower.period * np.arange(rows)[None], position=place,
            velocity=np.zeros_like(place), acceleration=np.zeros_like(place),
        )  # fmt: skip
        for _ in range(round(3.0 / GAIN * time / follower.period)):
            inputs, reason = follower.look(belief, still)
            assert not reason
            plan = inputs.usual_tension + wrong
            pose = robot, inputs.position, inputs.rotation
            follower.follow(inputs, plan, excess_at(*pose, plan, geometry_at(*pose)))
        away[turns_back] = float((inputs.usual_tension - rest.tension[0]) @ null)
    assert away[True] == pytest.approx(0.001 * weight / GAIN, rel=0.1)
    assert away[False] > 2.5 * away[True]


class Erring:
    """A network whose plans are wrong by tensions that add no force."""

    def __init__(self, network, wrong):
        self._network, self._wrong = network, wrong

    def __getattr__(self, name):
        return getattr(self._network, name)

    def planner(self, robot):
        plan = self._network.planner(robot)
        return lambda inputs: (plan(inputs)[0] + self._wrong, plan(inputs)[1])


def test_a_platform_that_errors_turn_is_turned_back():
    robot = ct.load_robot("carosac")
    rest = rest_at(robot)
    wrong = 0.01 * robot.weight / robot.n * null_of(robot, rest)
    turned = {}
    for turns_back in (False, True):
        network = Erring(network_for(robot), wrong)
        network.turns_back = turns_back
        controller = ApproximateMpc(robot, network)
        end = robot.home_position + np.array([0.0, 0.0, 0.2])
        path = trajectories.line(robot.home_position, end, speed_max=0.01, acceleration_max=1.0)
        log = drive(robot, controller, path)
        change = Rotation.from_matrix(log.rotation[[0, -1], 0])
        turned[turns_back] = float((change[1] * change[0].inv()).magnitude())
    assert turned[True] < 0.5 * turned[False]
