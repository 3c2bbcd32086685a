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


@pytest.mark.parametrize("factor", FACTORS)
def test_inverse_kinematics_of_a_point_hardly_depends_on_the_size(factor):
    # Its yaw has several equilibria of nearly the same tensions: rounding may pick another one.
    here, there, error = solved("hangprinter", factor, 300)
    assert np.count_nonzero(here.status != there.status) <= 1
    assert np.count_nonzero(error > 1e-9) <= 0.2 * len(error)
    assert here.converged.sum() > 120  # of 131 in which straight lines carry a point


def test_a_platform_that_is_nearly_a_point_rests_where_straight_lines_carry_a_point():
    robot = ct.load_robot("hangprinter")
    rest = ct.statics.inverse_kinematics(robot, [[-0.13, 0.22, 1.59], [0.28, 0.74, 0.1]])
    assert rest.converged.all() and rest.stable.all()
    outside = ct.statics.inverse_kinematics(robot, [[0.8, -0.8, 1.5]])
    assert ct.statics.STATUS_REASONS[outside.status[0]] == "no tensions within the limits found"
