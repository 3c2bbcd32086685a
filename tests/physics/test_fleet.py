"""A fleet of robots is its robots, one by one."""

from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.fleet import Fleet
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.statics import Equilibrium
from carosac_toolkit.robot.condition_file import find_condition
from carosac_toolkit.robot.perturbations import draw_plant
from tests.robots import eight_cable_robot, simple_robot, with_pulleys

KINDS = pytest.mark.parametrize(
    "robot",
    [simple_robot(), with_pulleys(simple_robot()), eight_cable_robot()],
    ids=["simple", "simple with pulleys", "eight"],
)


def plants(robot, count=5):
    """Robots that differ in everything that a condition names."""
    condition = find_condition("nominal-1")
    return [draw_plant(robot, condition, np.random.default_rng(k)) for k in range(count)]


def assert_rows(together, alone):
    """Row by row, bit for bit."""
    for k, one in enumerate(alone):
        for name in Equilibrium.__dataclass_fields__:
            row = getattr(together, name)[k : k + 1]
            assert np.array_equal(row, getattr(one, name), equal_nan=row.dtype != bool), name


@KINDS
def test_statics_of_a_fleet_is_that_of_its_robots_bit_for_bit(robot):
    robots = plants(robot)
    fleet = Fleet(robots)
    rng = np.random.default_rng(1)
    where = robot.home_position + rng.uniform(-0.1, 0.1, (5, 3))
    there = statics.inverse_kinematics(fleet, where)
    assert there.converged.all()
    alone = [statics.inverse_kinematics(r, where[k : k + 1]) for k, r in enumerate(robots)]
    assert_rows(there, alone)
    length = there.unstrained_length
    back = statics.forward_kinematics(fleet, length)
    assert_rows(
        back, [statics.forward_kinematics(r, length[k : k + 1]) for k, r in enumerate(robots)]
    )
    warm = statics.forward_kinematics(fleet, length, guess=there)
    assert warm.position == pytest.approx(where, abs=1e-9)
    assert len(np.unique(length[:, 0])) == 5


def test_one_robot_serves_a_whole_batch():
    robot = simple_robot()
    where = robot.home_position + np.array([[0.0, 0.0, 0.0], [0.2, 0.1, 0.3], [-0.3, 0.2, 0.1]])
    one = statics.inverse_kinematics(Fleet([robot]), where)
    assert_rows(one, [statics.inverse_kinematics(robot, row[None]) for row in where])


def test_slackness_and_winch_range_are_judged_by_each_robot():
    robot = simple_robot()
    strict = replace(robot, tension_min=np.full(4, 80.0), length_max=np.full(4, 9.0))
    length = statics.inverse_kinematics(robot, robot.home_position[None]).unstrained_length
    equilibrium = statics.forward_kinematics(Fleet([robot, strict]), np.vstack([length, length]))
    assert np.array_equal(equilibrium.tension[0], equilibrium.tension[1])
    assert not equilibrium.slack[0].any()
    assert np.array_equal(equilibrium.slack[1], equilibrium.tension[1] < 80.0)
    assert equilibrium.in_winch_range[0].all()
    assert np.array_equal(equilibrium.in_winch_range[1], length[0] <= 9.0)


def test_rows_are_the_robots_asked_for_and_one_serves_all():
    robots = plants(simple_robot(), 4)
    assert Fleet(robots).rows(np.array([2, 0])).robots == (robots[2], robots[0])
    lone = Fleet(robots[:1])
    assert lone.rows(np.array([3, 1])) is lone
    assert (len(Fleet(robots)), len(lone)) == (4, 1)


def test_attributes_are_those_of_the_robots_in_their_order():
    robots = plants(eight_cable_robot(), 3)
    fleet = Fleet(robots)
    assert fleet.n == 8
    for name in ("mass", "weight", "tension_min", "length_min", "length_max", "home_position"):
        assert np.array_equal(getattr(fleet, name), [getattr(r, name) for r in robots]), name


@pytest.mark.parametrize(
    ("robots", "message"),
    [
        ([], r"robots: got \[\]; allowed: at least one Robot"),
        (
            [simple_robot(), "scampi"],
            r"robots: got \['Robot', 'str'\]; allowed: at least one Robot",
        ),
        ([simple_robot(), eight_cable_robot()], r"robots\[1\]: got 8 cables; allowed: 4, as robot"),
        (
            [simple_robot(), simple_robot(), simple_robot(gravity=1.62)],
            r"robots\[2\].gravity: got 1.62 m/s\^2; allowed: 9.81 m/s\^2, as robots\[0\]",
        ),
    ],
)
def test_robots_that_make_no_fleet_are_refused(robots, message):
    with pytest.raises(InvalidField, match=message):
        Fleet(robots)


def test_a_batch_of_another_size_than_the_fleet_is_refused():
    fleet = Fleet([simple_robot()] * 2)
    with pytest.raises(InvalidField, match="position: got 3 rows; allowed: 2, one for each robot"):
        statics.inverse_kinematics(fleet, np.zeros((3, 3)))
    with pytest.raises(InvalidField, match="unstrained_length: got 3 rows; allowed: 2, one for"):
        statics.forward_kinematics(fleet, np.full((3, 4), 9.0))
    equilibrium = statics.inverse_kinematics(fleet, np.tile(simple_robot().home_position, (2, 1)))
    with pytest.raises(InvalidField, match="guess: got 2 poses; allowed: 1, as the batch"):
        statics.forward_kinematics(simple_robot(), np.full((1, 4), 9.0), guess=equilibrium)
