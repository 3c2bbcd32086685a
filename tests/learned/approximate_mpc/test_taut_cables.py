"""Weak cables pull more, by tensions that add no force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from baselines.mpc import MpcSettings
from baselines.mpc.geometry import excess_at, geometry_at
from baselines.mpc.length_offsets import OFFSET_TIME
from carosac_toolkit.loop.values import Belief, Reference
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.similar import similar_robot
from learned.approximate_mpc.controller import PlanFollower
from learned.approximate_mpc.plan_inputs import PlanInputs
from learned.approximate_mpc.taut_cables import GAIN, MARGIN, TautCables
from tests.robots import PER_CABLE, hanging, with_pulleys

TILT = Rotation.from_euler("zyx", [20.0, 10.0, -5.0], degrees=True).as_matrix()


@pytest.fixture
def robot():
    """Return `carosac` with pulleys and least tensions that differ."""
    robot = with_pulleys(ct.load_robot("carosac"))
    return replace(robot, tension_min=robot.tension_min * [1.0, 1.5, 1.0, 2.0])


def five_cables(robot):
    def more(rows):
        return np.concatenate([rows, rows[:1]])

    return replace(
        robot, cable_names=(*robot.cable_names, "fifth"),
        exit_points=np.vstack([robot.exit_points, [0.0, 0.0, robot.exit_points[:, 2].max()]]),
        anchor_points=np.vstack([robot.anchor_points, robot.anchor_points.mean(axis=0)]),
        **{name: more(getattr(robot, name)) for name in PER_CABLE},
    )  # fmt: skip


class Pulled:
    """What is added at a tilted pose to a plan of some tensions, and to sag less stretch."""

    def __init__(self, robot, reserve, planned=None):
        place, none = robot.home_position, np.zeros(3)
        rotation = TILT @ robot.home_rotation
        geometry = geometry_at(robot, place, rotation)
        usual = robot.tension_min + MARGIN * robot.weight / robot.n + reserve
        plan = usual if planned is None else planned
        inputs = PlanInputs(
            position=place, rotation=rotation, twist=np.zeros(6), target=place + np.zeros((2, 3)),
            target_velocity=np.zeros((2, 3)), center=none, acceleration=np.zeros(6),
            usual_tension=usual, usual_place=none,
        )  # fmt: skip
        excess = excess_at(robot, place, rotation, plan, geometry)
        self.tension, told = TautCables(robot).pull(inputs, plan, excess)
        self.added = self.tension - plan
        self.force = geometry.direction.T @ self.added
        self.excess_error = told - excess_at(robot, place, rotation, self.tension, geometry)


def test_taut_cables_are_left_alone(robot):
    pulled = Pulled(robot, np.array([0.1, 20.0, 30.0, 40.0]))
    assert (pulled.added == 0.0).all()


@pytest.mark.parametrize("weak", range(4))
def test_a_weak_cable_gains_and_no_force_is_added(robot, weak):
    reserve = np.full(4, 30.0)
    reserve[weak] = -3.0
    pulled = Pulled(robot, reserve)
    assert pulled.added[weak] == pytest.approx(3.0 * GAIN)
    assert np.abs(pulled.force).max() < 1e-9
    assert np.abs(pulled.excess_error).max() < 1e-9


def test_no_other_cable_becomes_weak(robot):
    reserve = np.array([-3.0, 0.5, 0.5, 0.5])
    left = reserve + Pulled(robot, reserve).added
    assert left[0] > reserve[0]
    assert left[1:].min() == pytest.approx(0.0, abs=1e-9)


def test_limits_of_tensions_are_kept_without_adding_a_force(robot):
    reserve = np.full(4, 30.0)
    reserve[0] = -3.0
    gains = Pulled(robot, reserve).added > 0.0
    for some, limit, off in ((~gains, robot.tension_min, 0.1), (gains, robot.tension_max, -0.2)):
        planned = np.where(some, limit + off, 100.0)
        pulled = Pulled(robot, reserve, planned)
        assert np.abs(pulled.added).max() > 0.0
        assert (pulled.tension >= robot.tension_min - 1e-9).all()
        assert (pulled.tension <= robot.tension_max + 1e-9).all()
        assert np.abs(pulled.force).max() < 1e-9


def test_a_cable_is_not_helped_at_the_cost_of_another_weak_one(robot):
    reserve = np.full(4, 30.0)
    reserve[0] = -3.0
    added = Pulled(robot, reserve).added
    reserve[int(np.argmin(added))] = -1.0
    assert (Pulled(robot, reserve).added == 0.0).all()


def test_no_cable_gains_more_than_it_misses(robot):
    null = np.linalg.svd(geometry_at(
        robot, robot.home_position, TILT @ robot.home_rotation
    ).direction.T)[2][3]  # fmt: skip
    alike = np.flatnonzero(null * null[0] > 0.0)
    for missing in (0.01, 0.1, 1.0):
        reserve = np.full(4, 30.0)
        reserve[alike] = -3.0, -missing
        added = Pulled(robot, reserve).added[alike]
        assert (added > 0.0).all()
        assert (added <= GAIN * -reserve[alike] + 1e-9).all()


def test_three_cables_hold_a_place_in_one_way():
    pulled = Pulled(hanging(3), np.array([-3.0, 30.0, 30.0]))
    assert (pulled.added == 0.0).all()


@pytest.mark.parametrize("other", [30.0, -0.3])
def test_of_five_cables_two_may_be_weak(robot, other):
    pulled = Pulled(five_cables(robot), np.array([-3.0, other, 30.0, 30.0, 30.0]))
    assert pulled.added[0] > 0.0
    assert pulled.added[1] >= (0.0 if other < 0.0 else -other)
    assert np.abs(pulled.force).max() < 1e-9


@pytest.mark.parametrize("size", [0.1, 1.0, 10.0])
def test_usual_tensions_follow_what_is_added(size):
    """A plan that changes nothing lets a weak cable gain at the rate that is stated."""
    robot = similar_robot(ct.load_robot("carosac"), size)
    wanted = robot.tension_min + MARGIN * robot.weight / robot.n
    corner = np.linspace(0.0, 1.0, 41)[:, None] * (robot.workspace_max - robot.home_position)
    rest = statics.inverse_kinematics(robot, robot.home_position + corner)
    reserve = rest.tension - wanted
    k = int(np.argmax(rest.converged & (reserve.min(axis=1) < -0.1 * wanted.min())))
    weak = int(np.argmin(reserve[k]))
    assert -0.9 * wanted[weak] < reserve[k, weak] < 0.0
    follower = PlanFollower(robot, MpcSettings())
    belief = Belief(
        time=np.zeros(1), position=rest.position[[k]], rotation=rest.rotation[[k]],
        twist=np.zeros((1, 6)), tension=rest.tension[[k]],
    )  # fmt: skip
    follower.reset(belief)
    rows = round(follower.horizon / follower.period) + 1
    place = np.broadcast_to(rest.position[k], (1, rows, 3))
    still = Reference(
        time=follower.period * np.arange(rows)[None], position=place,
        velocity=np.zeros_like(place), acceleration=np.zeros_like(place),
    )  # fmt: skip
    geometry = geometry_at(robot, rest.position[k], rest.rotation[k])
    time, left = OFFSET_TIME.of(Scales(robot).ratios) / GAIN, []
    for _ in range(round(time / follower.period)):
        inputs, reason = follower.look(belief, still)
        assert not reason
        left.append(inputs.usual_tension[weak] - wanted[weak])
        plan = inputs.usual_tension
        excess = excess_at(robot, inputs.position, inputs.rotation, plan, geometry)
        follower.follow(inputs, plan, excess)
    assert left[-1] / left[0] == pytest.approx(np.exp(-1.0), abs=0.05)
