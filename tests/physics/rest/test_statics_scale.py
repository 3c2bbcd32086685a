"""Statics know no size: a robot scaled by Froude's law rests at scaled lengths."""

import numpy as np
import pytest

import carosac_toolkit as ct
from carosac_toolkit.robot.similar import similar_robot

ROBOTS = ("carosac", "scampi", "cogiro", "ipanema1", "desktop", "warehouse", "stadium")
FACTORS = (0.01, 0.1, 3.0, 100.0)


def solved(name, factor, count):
    robot = ct.load_robot(name)
    position = np.random.default_rng(3).uniform(
        robot.workspace_min, robot.workspace_max, (count, 3)
    )
    other = similar_robot(robot, factor)
    here = ct.statics.inverse_kinematics(robot, position)
    there = ct.statics.inverse_kinematics(other, position * factor)
    both = here.converged & there.converged
    error = np.abs(there.unstrained_length / factor / here.unstrained_length - 1.0).max(axis=1)
    return here, there, error[both]


@pytest.mark.parametrize("factor", FACTORS)
@pytest.mark.parametrize("name", ROBOTS)
def test_inverse_kinematics_does_not_depend_on_the_size(name, factor):
    here, there, error = solved(name, factor, 60)
    assert np.array_equal(here.status, there.status)
    assert error.max() < 1e-9


@pytest.mark.parametrize("factor", [4.0, 16.0])
@pytest.mark.parametrize("name", ["carosac", "hangprinter", "warehouse"])
def test_without_rounding_inverse_kinematics_is_the_same_bit_by_bit(name, factor):
    """Scaling by a power of four only changes exponents: what differs is a constant with a unit."""
    here, there, error = solved(name, factor, 200)
    assert np.array_equal(here.status, there.status)
    assert np.array_equal(here.iterations, there.iterations)
    assert error.max() < 1e-15


@pytest.mark.parametrize("factor", FACTORS)
def test_inverse_kinematics_of_a_point_hardly_depends_on_the_size(factor):
    # Its yaw has several equilibria of nearly the same tensions: rounding may pick another one.
    here, there, error = solved("hangprinter", factor, 300)
    assert np.count_nonzero(here.status != there.status) <= 1
    assert np.count_nonzero(error > 1e-9) <= 0.2 * len(error)
    assert here.converged.sum() > 120  # of 131 in which straight lines carry a point


def test_rounding_does_not_decide_whether_a_point_can_rest():
    robot = ct.load_robot("hangprinter")
    near = np.array(  # where searches from one heading fail for some roundings
        [[0.148, -0.731, 0.693], [-0.741, 0.347, 0.834], [0.635, 0.398, 1.169],
         [0.391, 0.233, 1.554], [0.305, 0.207, 1.257]]
    )  # fmt: skip
    shift = 1e-12 * np.random.default_rng(1).standard_normal((40, 1, 3))
    rest = ct.statics.inverse_kinematics(robot, (near + shift).reshape(-1, 3))
    assert rest.converged.all() and rest.stable.all()


def test_a_platform_that_is_nearly_a_point_rests_where_straight_lines_carry_a_point():
    robot = ct.load_robot("hangprinter")
    rest = ct.statics.inverse_kinematics(robot, [[-0.13, 0.22, 1.59], [0.28, 0.74, 0.1]])
    assert rest.converged.all() and rest.stable.all()
    outside = ct.statics.inverse_kinematics(robot, [[0.8, -0.8, 1.5]])
    assert ct.statics.STATUS_REASONS[outside.status[0]] == "no tensions within the limits found"
