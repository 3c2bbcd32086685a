from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit.physics import statics
from learned.actions import Absolute, Displacement
from learned.environment import empty_look
from learned.observation import Scales
from learned.worlds import SettledWorlds
from tests.robots import simple_robot

ROBOT = simple_robot()


@pytest.fixture(scope="module")
def displacement():
    return Displacement(ROBOT, 0.3, lead=0.025)


def test_absolute_actions_are_lengths_whatever_there_is_to_see():
    scales = Scales.of(ROBOT)
    actions = Absolute(scales)
    action = np.array([[-1.0, 1.0, 0.0, 0.5]])
    look = empty_look(ROBOT, 0, 4)
    moved = replace(look, position=look.position + 1.0, target=look.target - 1.0)
    expected = scales.to_length(action)
    np.testing.assert_array_equal(actions.lengths(action, look), expected)
    np.testing.assert_array_equal(actions.lengths(action, moved), expected)
    assert actions.size == 4
    np.testing.assert_array_equal(actions.effort(action), 0.0)


def test_no_displacement_asks_for_the_rest_at_the_target(displacement):
    look = empty_look(ROBOT, 0, 3)
    rest = statics.inverse_kinematics(ROBOT, look.target).unstrained_length
    found = displacement.lengths(np.zeros((1, 3)), look)
    np.testing.assert_allclose(found, rest, atol=3e-3)  # what the length map errs by


def test_a_displacement_leads_beside_the_target(displacement):
    look = empty_look(ROBOT, 0, 3)
    action = np.array([[1.0, -0.5, 0.25]])
    reached = SettledWorlds(ROBOT, 1).advance(displacement.lengths(action, look))
    wanted = 0.3 * action
    off = np.linalg.norm(reached.position - look.target - wanted)
    assert off < 5e-3
    np.testing.assert_allclose(reached.inconsistency, 0.0, atol=5e-3)  # and pulls at no cable


def test_a_moving_target_is_led(displacement):
    look = empty_look(ROBOT, 0, 3)
    velocity = np.array([[1.0, -2.0, 0.5]])
    moving = replace(look, target_velocity=velocity)
    later = replace(look, target=look.target + 0.025 * velocity)
    zero = np.zeros((1, 3))
    np.testing.assert_allclose(
        displacement.lengths(zero, moving), displacement.lengths(zero, later), atol=1e-12
    )


def test_the_effort_of_a_displacement_is_its_norm_over_the_reach(displacement):
    action = np.array([[0.0, 0.0, 0.0], [0.6, 0.0, -0.8]])
    np.testing.assert_allclose(displacement.effort(action), [0.0, 1.0])
