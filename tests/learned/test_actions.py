from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from carosac_toolkit.physics.rest import statics
from learned.actions import Absolute, Push
from learned.environment import empty_look
from learned.length_map import LengthMap
from learned.observation import ObservationScales, fading
from learned.worlds import SettledWorlds
from tests.robots import simple_robot

ROBOT = simple_robot()


@pytest.fixture(scope="module")
def push():
    return Push(ROBOT, 2.0, lead=0.025)


def leaning(robot, acceleration):
    """The robot in a hall that leans, so that gravity also pulls against an acceleration.

    Returns:
        The robot, and the rotation from the hall to the frame in which gravity is vertical.
    """
    pull = np.array([0.0, 0.0, -robot.gravity]) - acceleration
    turn, _ = Rotation.align_vectors([[0.0, 0.0, -1.0]], [pull])
    matrix = turn.as_matrix()
    exits = robot.exit_points @ matrix.T
    return replace(robot, exit_points=exits, gravity=float(np.linalg.norm(pull))), matrix


def test_absolute_actions_are_lengths_whatever_there_is_to_see():
    scales = ObservationScales.of(ROBOT)
    actions = Absolute(scales)
    action = np.array([[-1.0, 1.0, 0.0, 0.5]])
    look = empty_look(ROBOT, 0, 4)
    moved = replace(look, position=look.position + 1.0, target=look.target - 1.0)
    expected = scales.to_length(action)
    np.testing.assert_array_equal(actions.lengths(action, look), expected)
    np.testing.assert_array_equal(actions.lengths(action, moved), expected)
    assert actions.size == 4
    np.testing.assert_array_equal(actions.effort(action), 0.0)


def test_no_push_asks_for_the_rest_at_the_target(push):
    look = empty_look(ROBOT, 0, 3)
    rest = statics.inverse_kinematics(ROBOT, look.target).unstrained_length
    found = push.lengths(np.zeros((1, 3)), look)
    np.testing.assert_allclose(found, rest, atol=3e-3)  # what the length map errs by


def test_a_push_moves_the_rest_by_the_softness_and_pulls_at_no_cable(push):
    look = empty_look(ROBOT, 0, 3)
    applied = np.array([[0.4, 0.3, 0.2]])
    wanted = LengthMap(ROBOT).displacement(look.target, 2.0 * applied)[0]
    reached = SettledWorlds(ROBOT, 1).advance(push.lengths(applied, look))
    moved = (reached.position - look.target)[0]
    assert np.linalg.norm(moved - wanted) < 0.1 * np.linalg.norm(wanted) + 3e-3
    np.testing.assert_allclose(reached.inconsistency, 0.0, atol=5e-3)


@pytest.mark.parametrize("acceleration", [[0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.3, -0.3, 0.2]])
def test_a_push_holds_the_platform_against_its_inertia(push, acceleration):
    """Inertia pulls as gravity does in a hall that leans: there it rests at its target."""
    look = empty_look(ROBOT, 0, 3)
    robot, turn = leaning(ROBOT, np.array(acceleration))
    lengths = push.lengths(np.array([acceleration]) / 2.0, look)
    idle = push.lengths(np.zeros((1, 3)), look)
    off, off_idle = (
        np.linalg.norm(statics.forward_kinematics(robot, x).position[0] @ turn - look.target[0])
        for x in (lengths, idle)
    )
    assert off < 0.15 * off_idle + 3e-3


def test_feedforward_is_the_push_of_the_target():
    look = empty_look(ROBOT, 0, 3)
    moving = replace(look, aimed_acceleration=np.array([[0.5, -0.4, 0.3]]))
    with_it = Push(ROBOT, 2.0, feedforward=True)
    without = Push(ROBOT, 2.0)
    none = np.zeros((1, 3))
    np.testing.assert_allclose(
        with_it.lengths(none, moving), without.lengths(moving.aimed_acceleration / 2.0, look)
    )
    np.testing.assert_array_equal(without.lengths(none, moving), without.lengths(none, look))


def test_a_correction_moves_the_target_against_what_lasts():
    look = empty_look(ROBOT, 0, 3)
    error = np.array([[0.02, -0.01, 0.005]])
    off = replace(look, lasting_error=error)
    moved = replace(look, target=look.target - 2.0 * error)
    none, plain = np.zeros((1, 3)), Push(ROBOT, 2.0)
    found = Push(ROBOT, 2.0, correction=2.0).lengths(none, off)
    np.testing.assert_allclose(found, plain.lengths(none, moved), atol=1e-12)
    np.testing.assert_array_equal(plain.lengths(none, off), plain.lengths(none, look))


def test_what_a_plant_lies_off_by_goes_down_to_its_share():
    """With a gain K of the mean error the rest is 1 / (1 + K) of what it would be, in the end."""
    plant = replace(ROBOT, exit_points=ROBOT.exit_points + np.array([0.03, -0.02, 0.01]))
    look = empty_look(ROBOT, 0, 3)
    rest = {}
    for gain in (0.0, 2.0):
        push, lasting = Push(ROBOT, 2.0, correction=gain), np.zeros((1, 3))
        for _ in range(400):
            lengths = push.lengths(np.zeros((1, 3)), replace(look, lasting_error=lasting))
            error = statics.forward_kinematics(plant, lengths).position - look.target
            lasting = fading(lasting, error, 0.1, 4.0)
        rest[gain] = error[0]
    np.testing.assert_allclose(rest[0.0], [0.03, -0.02, 0.01], atol=3e-3)
    np.testing.assert_allclose(rest[2.0], rest[0.0] / 3.0, atol=1e-3)


def test_a_moving_target_is_led(push):
    look = empty_look(ROBOT, 0, 3)
    velocity = np.array([[1.0, -2.0, 0.5]])
    moving = replace(look, target_velocity=velocity)
    later = replace(look, target=look.target + 0.025 * velocity)
    zero = np.zeros((1, 3))
    np.testing.assert_allclose(push.lengths(zero, moving), push.lengths(zero, later), atol=1e-12)


def test_a_push_goes_some_of_the_way_in_a_step():
    slow = Push(ROBOT, 2.0, share=0.4)
    look = replace(empty_look(ROBOT, 0, 3), last_action=np.array([[0.5, 0.0, -0.5]]))
    found = slow.applied(np.array([[1.0, 1.0, -0.5]]), look)
    np.testing.assert_allclose(found, [[0.7, 0.4, -0.5]])


def test_the_effort_of_a_push_is_its_norm_over_the_reach(push):
    applied = np.array([[0.0, 0.0, 0.0], [0.6, 0.0, -0.8]])
    np.testing.assert_allclose(push.effort(applied), [0.0, 1.0])
