"""States that are carried to other places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from baselines.mpc.geometry import geometry_at
from baselines.mpc.settings import MpcSettings
from baselines.mpc.target_reader import TargetReader
from carosac_toolkit.physics.rest import statics
from learned.approximate_mpc.elsewhere import elsewhere
from learned.approximate_mpc.plan_inputs import PlanInputs
from learned.approximate_mpc.teacher import Teacher
from tests.robots import hanging

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
    return _resting(home, rest.rotation[0], rest.tension[0])


def _resting(place, rotation, tension):
    return PlanInputs(
        position=place,
        rotation=rotation,
        twist=np.zeros(6),
        target=np.tile(place, (STAGES + 1, 1)),
        target_velocity=np.zeros((STAGES + 1, 3)),
        center=np.zeros(3),
        acceleration=np.zeros(6),
        usual_tension=tension,
        usual_place=np.zeros(3),
    )


@pytest.fixture(scope="module")
def moving(robot, resting, teacher):
    """Return a state on a way of 1 m along x, at 0.5 m/s, 2 cm behind; it has been pulled there.

    It is tilted by 20 mrad, and its centre of mass is told 5 mm off that of the robot file.
    """
    way = np.zeros((STAGES + 1, 3))
    way[:, 0] = np.minimum(0.5 * teacher.grid, 1.0)
    velocity = np.zeros((STAGES + 1, 3))
    velocity[:, 0] = 0.5
    return replace(
        resting,
        position=resting.position - [0.02, 0.0, 0.0],
        rotation=Rotation.from_rotvec([0.02, 0.0, 0.0]).as_matrix() @ resting.rotation,
        twist=np.array([0.5, 0.0, 0.0, 0.0, 0.1, 0.0]),
        target=resting.position + way,
        target_velocity=velocity,
        acceleration=np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0]),
        center=np.array([0.005, 0.0, 0.0]),
        usual_tension=1.1 * resting.usual_tension,
        usual_place=np.array([-0.2, 0.0, 0.0]),
    )


def _carried(robot, teacher, met, count, seed=3):
    rng = np.random.default_rng(seed)
    return list(elsewhere(robot, met, count, SPREAD, teacher.grid, rng))


def _force(robot, inputs, tension):
    """Return by what cables of some tensions pull [N], shape (3,)."""
    return -geometry_at(robot, inputs.position, inputs.rotation).direction.T @ tension


def _rest(robot, center, place):
    loaded = replace(robot, center_of_mass=robot.center_of_mass + center)
    return statics.inverse_kinematics(loaded, place[None])


def test_who_rests_is_carried_to_where_it_rests(robot, teacher, resting):
    """MPC wants no other tensions there: it is a rest, with another centre of mass."""
    found = _carried(robot, teacher, [resting] * 12, 12)
    assert len(found) > 8
    for it in found:
        plan = teacher.ask_anew(it.inputs, it.rest, it.habit, it.surplus)
        rest = _rest(robot, it.inputs.center, it.inputs.target[0])
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
        assert it.inputs.usual_place == pytest.approx(-0.2 * ahead)
        before = it.inputs.target[0] + it.inputs.usual_place
        assert (before >= robot.workspace_min).all() and (before <= robot.workspace_max).all()


def test_a_platform_is_pulled_and_tilted_as_it_was(robot, teacher, moving):
    """Beside its rest, and turned with its way."""
    here = moving.target[0] + moving.usual_place
    old = _rest(robot, moving.center, here)
    pull = _force(robot, moving, moving.usual_tension - old.tension[0])
    found = _carried(robot, teacher, [moving] * 12, 12)
    for it in found:
        ahead = it.inputs.twist[:3] / 0.5
        left = np.cross([0.0, 0.0, 1.0], ahead)
        now = _rest(robot, it.inputs.center, it.inputs.target[0] + it.inputs.usual_place)
        carried = _force(robot, it.inputs, it.inputs.usual_tension - now.tension[0])
        assert [ahead @ carried, left @ carried, carried[2]] == pytest.approx(pull, abs=1e-6)
        rest = _rest(robot, it.inputs.center, it.inputs.target[0]).rotation[0]
        tilt = Rotation.from_matrix(it.inputs.rotation @ rest.T).as_rotvec()
        assert [ahead @ tilt, left @ tilt, tilt[2]] == pytest.approx(
            _tilt_from_rest(robot, moving), abs=1e-9
        )


def _tilt_from_rest(robot, inputs):
    rest = _rest(robot, inputs.center, inputs.target[0]).rotation[0]
    return Rotation.from_matrix(inputs.rotation @ rest.T).as_rotvec()


def test_rests_and_habit_are_what_mpc_would_have(robot, teacher, moving):
    reader = TargetReader(robot, teacher.grid)
    for it in _carried(robot, teacher, [moving] * 6, 6):
        reader.reset()
        target = it.inputs.target
        ends = [reader.at(target[0]), reader.at(target[-1])]
        share = (teacher.grid[:-1] / teacher.grid[-1])[:, None]
        wanted = (1.0 - share) * ends[0] + share * ends[1]
        assert it.rest == pytest.approx(wanted, abs=1e-6)
        before = reader.at(target[0] + it.inputs.usual_place)
        assert it.habit == pytest.approx(it.inputs.usual_tension - before, abs=1e-6)


def test_the_same_draws_give_the_same_questions(robot, teacher, moving):
    first, again, other = (
        _carried(robot, teacher, [moving] * 4, 4, seed)[0].inputs for seed in (3, 3, 4)
    )
    assert (first.position == again.position).all()
    assert (first.usual_tension == again.usual_tension).all()
    assert (first.position != other.position).all()


def test_a_robot_of_three_cables_rests_elsewhere_too():
    robot = hanging(3)
    teacher = Teacher(robot, MpcSettings())
    home = robot.home_position
    rest = statics.inverse_kinematics(robot, home[None])
    state = _resting(home, rest.rotation[0], rest.tension[0])
    found = list(elsewhere(robot, [state] * 8, 8, 1e-3, teacher.grid, np.random.default_rng(0)))
    assert found
    for it in found:
        plan = teacher.ask_anew(it.inputs, it.rest, it.habit, it.surplus)
        assert plan.tension[0] == pytest.approx(it.inputs.usual_tension, rel=0.05)


def test_a_plan_that_was_found_no_longer_changes(robot, teacher, moving):
    for it in _carried(robot, teacher, [moving] * 4, 4):
        told = (it.inputs, it.rest, it.habit, it.surplus)
        teacher.reset()
        many = teacher.ask_aside(*told, 0.0, iterations=15).tension[0]
        assert teacher.ask_anew(*told).tension[0] == pytest.approx(many, abs=0.1)


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
