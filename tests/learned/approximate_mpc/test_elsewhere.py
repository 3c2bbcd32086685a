"""States that are carried to other places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from baselines.mpc.settings import MpcSettings
from carosac_toolkit.physics.rest import statics
from learned.approximate_mpc.elsewhere import elsewhere
from learned.approximate_mpc.plan_inputs import PlanInputs
from learned.approximate_mpc.teacher import Teacher

pytest.importorskip("casadi")
SPREAD = 0.01  # of the centre of mass [m]
STAGES = 20


@pytest.fixture(scope="module")
def robot():
    return ct.load_robot("carosac")


@pytest.fixture(scope="module")
def teacher(robot):
    return Teacher(robot, MpcSettings())


@pytest.fixture(scope="module")
def resting(robot):
    """Return a state of rest at home."""
    home = robot.home_position
    rest = statics.inverse_kinematics(robot, home[None])
    return PlanInputs(
        position=home,
        rotation=rest.rotation[0],
        twist=np.zeros(6),
        target=np.tile(home, (STAGES + 1, 1)),
        target_velocity=np.zeros((STAGES + 1, 3)),
        center=np.zeros(3),
        acceleration=np.zeros(6),
        usual_tension=rest.tension[0],
        usual_place=np.zeros(3),
    )


@pytest.fixture(scope="module")
def moving(robot, resting, teacher):
    """Return a state on a way of 1 m along x, at 0.5 m/s, 2 cm behind."""
    way = np.zeros((STAGES + 1, 3))
    way[:, 0] = np.minimum(0.5 * teacher.grid, 1.0)
    velocity = np.zeros((STAGES + 1, 3))
    velocity[:, 0] = 0.5
    return replace(
        resting,
        position=resting.position - [0.02, 0.0, 0.0],
        twist=np.array([0.5, 0.0, 0.0, 0.0, 0.1, 0.0]),
        target=resting.position + way,
        target_velocity=velocity,
        acceleration=np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0]),
    )


def _carried(robot, teacher, met, count):
    rng = np.random.default_rng(3)
    return list(elsewhere(robot, met, count, SPREAD, teacher.grid, rng))


def test_who_rests_is_carried_to_where_it_rests(robot, teacher, resting):
    """MPC wants no other tensions there: it is a rest, with another centre of mass."""
    found = _carried(robot, teacher, [resting] * 12, 12)
    assert len(found) > 8
    for it in found:
        plan = teacher.ask_anew(it.inputs, it.rest, it.habit, it.surplus)
        loaded = replace(robot, center_of_mass=robot.center_of_mass + it.inputs.center)
        rest = statics.inverse_kinematics(loaded, it.inputs.target[:1])
        assert it.inputs.usual_tension == pytest.approx(rest.tension[0], abs=1e-6)
        assert it.inputs.rotation == pytest.approx(rest.rotation[0], abs=1e-6)
        assert plan.tension[0] == pytest.approx(rest.tension[0], abs=1.0)
        assert np.abs(it.inputs.center).max() < 2.0 * SPREAD


def test_a_way_keeps_its_form_and_stays_in_the_box(robot, teacher, moving):
    found = _carried(robot, teacher, [moving] * 12, 12)
    assert len(found) > 8
    for it in found:
        way = it.inputs.target - it.inputs.target[0]
        assert (it.inputs.target >= robot.workspace_min).all()
        assert (it.inputs.target <= robot.workspace_max).all()
        assert np.linalg.norm(way, axis=1) == pytest.approx(
            moving.target[:, 0] - moving.target[0, 0]
        )
        assert way[:, 2] == pytest.approx(0.0)
        ahead = it.inputs.twist[:3] / 0.5
        assert it.inputs.position == pytest.approx(it.inputs.target[0] - 0.02 * ahead)
        assert it.inputs.target_velocity[0] == pytest.approx(it.inputs.twist[:3])
        assert it.inputs.acceleration[:3] == pytest.approx(0.1 * ahead)
        assert it.inputs.twist[3:] @ ahead == pytest.approx(0.0)  # the spin is about y of the way


def test_ways_that_are_longer_than_the_box_stay_where_they_are(robot, teacher, moving):
    middle = robot.home_position
    small = replace(robot, workspace_min=middle - 0.3, workspace_max=middle + 0.3)
    assert not _carried(small, teacher, [moving] * 3, 3)


def test_a_teacher_goes_on_from_its_own_plan(teacher, resting):
    """What it was asked anew is no plan that the next one begins with."""
    rest = np.tile(resting.usual_tension, (STAGES, 1))
    habit, surplus = np.zeros(4), np.zeros(4)
    ahead = replace(resting, acceleration=np.array([0.2, 0.1, 0.0, 0.0, 0.0, 0.0]))
    told = []
    for disturbed in (False, True):
        teacher.reset()
        teacher.ask(ahead, rest, habit, surplus, 0.0)
        if disturbed:
            teacher.ask_anew(resting, rest, habit, surplus)
        told.append(teacher.ask(ahead, rest, habit, surplus, 0.02).tension)
    assert told[0] == pytest.approx(told[1], abs=1e-12)
