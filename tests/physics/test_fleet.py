"""A fleet of robots is its robots, one by one."""

from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.rotations import from_rotation_vector
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.physics.fleet import Fleet
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.held_lengths import (
    poses_on_lengths,
    pull_of_held_cables,
    twists_on_rates,
)
from carosac_toolkit.physics.rest.modes import mass_matrix
from carosac_toolkit.physics.rest.statics import Equilibrium
from carosac_toolkit.physics.rest.structure import structure_matrix
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


@KINDS
def test_straight_cables_of_a_fleet_are_those_of_its_robots_bit_for_bit(robot):
    robots = plants(robot)
    rng = np.random.default_rng(2)
    position = robot.home_position + rng.uniform(-0.1, 0.1, (5, 3))
    rotation = from_rotation_vector(rng.uniform(-0.2, 0.2, (5, 3))) @ robot.home_rotation
    found = straight_length(Fleet(robots), position, rotation)
    structures = structure_matrix(Fleet(robots), position, rotation)
    masses = mass_matrix(Fleet(robots), rotation, found.length)
    for k, one in enumerate(robots):
        own = slice(k, k + 1)
        alone = straight_length(one, position[own], rotation[own])
        for name in ("length", "wrap", "direction", "valid"):
            assert np.array_equal(getattr(found, name)[own], getattr(alone, name)), name
        assert np.array_equal(structures[own], structure_matrix(one, position[own], rotation[own]))
        assert np.array_equal(masses[own], mass_matrix(one, rotation[own], found.length[own]))
    assert len(np.unique(found.length[:, 0])) == 5


@pytest.mark.parametrize("robot", [simple_robot(), with_pulleys(simple_robot())])
def test_swinging_platforms_of_a_fleet_are_those_of_its_robots_bit_for_bit(robot):
    """Also where some need more Newton steps than others to find their lengths."""
    robots = plants(robot)
    rng = np.random.default_rng(3)
    reach = np.geomspace(1e-6, 1.0, 5)[:, None]
    position = robot.home_position + reach * rng.uniform(-1.0, 1.0, (5, 3))
    rotation = np.repeat(robot.home_rotation[None], 5, axis=0)
    home = np.repeat(robot.home_position[None], 5, axis=0)
    rate, twist = rng.uniform(-0.1, 0.1, (5, robot.n)), rng.uniform(-0.3, 0.3, (5, 6))

    def swing(robot, own):
        length = straight_length(robot, home[own], rotation[own]).length
        pose = poses_on_lengths(robot, position[own], rotation[own], length)
        moved = twists_on_rates(robot, *pose, length, rate[own], twist[own])
        return *pose, moved, *pull_of_held_cables(robot, *pose, moved)

    together = swing(Fleet(robots), slice(None))
    for k, one in enumerate(robots):
        alone = swing(one, slice(k, k + 1))
        for row, right in zip(together, alone, strict=True):
            assert np.array_equal(row[k : k + 1], right)


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
    fleet = Fleet(robots)
    assert fleet.rows(np.array([2, 0])).robots == (robots[2], robots[0])
    assert fleet.rows(np.arange(4)) is fleet
    lone = Fleet(robots[:1])
    assert lone.rows(np.array([3, 1])) is lone
    assert (len(Fleet(robots)), len(lone)) == (4, 1)


def test_attributes_are_those_of_the_robots_in_their_order():
    robots = plants(eight_cable_robot(), 3)
    fleet = Fleet(robots)
    assert fleet.n == 8
    for name in (
        "mass", "weight", "center_of_mass", "inertia", "anchor_points", "run_length",
        "linear_density", "axial_stiffness", "tension_min", "length_min", "length_max",
        "home_position",
    ):  # fmt: skip
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
    with pytest.raises(InvalidField, match="position: got 3 rows; allowed: 2, one for each robot"):
        straight_length(fleet, np.zeros((3, 3)))
    with pytest.raises(InvalidField, match="unstrained_length: got 3 rows; allowed: 2, one for"):
        statics.forward_kinematics(fleet, np.full((3, 4), 9.0))
    equilibrium = statics.inverse_kinematics(fleet, np.tile(simple_robot().home_position, (2, 1)))
    with pytest.raises(InvalidField, match="guess: got 2 poses; allowed: 1, as the batch"):
        statics.forward_kinematics(simple_robot(), np.full((1, 4), 9.0), guess=equilibrium)
