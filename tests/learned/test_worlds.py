import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.cable import straight_line
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.robot.file import load_robot
from learned.worlds import NoSagWorlds, SettledWorlds
from sim_warp import Simulator
from tests.robots import simple_robot

INNER = 0.8  # share of the box in which all robots here can rest


def positions(robot, count, seed=0, share=INNER):
    """Random positions in the inner part of a workspace box."""
    center = (robot.workspace_max + robot.workspace_min) / 2
    half = share * (robot.workspace_max - robot.workspace_min) / 2
    return center + half * np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 3))


@pytest.mark.parametrize("name", ["carosac", "scampi", "cogiro"])
def test_straight_lengths_of_a_point_lead_there_and_agree_with_each_other(name):
    robot = load_robot(name)
    wanted = positions(robot, 20)
    worlds = NoSagWorlds(robot, 20)
    reached = worlds.advance(straight_line.inverse_kinematics(robot, wanted))
    np.testing.assert_allclose(reached.position, wanted, atol=1e-6)
    np.testing.assert_allclose(reached.inconsistency, 0.0, atol=1e-6)
    assert not reached.failed.any()


def test_lengths_that_contradict_each_other_are_forgiven_but_reported():
    """Four lengths and three coordinates: what a fit leaves is orthogonal to the directions."""
    robot = simple_robot()
    point = positions(robot, 8)
    asked = straight_line.inverse_kinematics(robot, point)
    asked[:, 0] += 0.2
    reached = NoSagWorlds(robot, 8).advance(asked)
    cables = straight_line.straight_length(robot, reached.position)
    np.testing.assert_allclose(reached.inconsistency, asked - cables.length, atol=1e-12)
    pull = np.einsum("bn,bni->bi", reached.inconsistency, cables.direction)
    np.testing.assert_allclose(pull, 0.0, atol=1e-6)
    assert (np.linalg.norm(reached.inconsistency, axis=1) < 0.2).all()  # the best fit is better
    assert (np.abs(reached.inconsistency).max(axis=1) > 0.01).all()  # and none is perfect


@pytest.mark.parametrize("kind", [NoSagWorlds, SettledWorlds])
def test_a_reset_puts_chosen_worlds_at_rest_and_leaves_the_others(kind):
    robot = simple_robot()
    worlds = kind(robot, 3)
    before = worlds.reset(np.arange(3), positions(robot, 3))
    there = positions(robot, 1, seed=5)
    after = worlds.reset(np.array([1]), there)
    np.testing.assert_allclose(after.position[1], there[0], atol=1e-6)
    np.testing.assert_array_equal(after.position[[0, 2]], before.position[[0, 2]])
    np.testing.assert_array_equal(after.length[[0, 2]], before.length[[0, 2]])
    np.testing.assert_array_equal(after.twist, 0.0)
    held = worlds.advance(after.length)  # holding the lengths stays there
    np.testing.assert_allclose(held.position, after.position, atol=1e-6)
    np.testing.assert_allclose(held.inconsistency, 0.0, atol=1e-6)


@pytest.mark.parametrize("name", ["carosac", "scampi"])
def test_catenary_lengths_of_a_point_settle_there(name):
    robot = load_robot(name)
    wanted = positions(robot, 20)
    rest = statics.inverse_kinematics(robot, wanted)
    assert (rest.converged & rest.stable).all()
    worlds = SettledWorlds(robot, 20)
    reached = worlds.advance(rest.unstrained_length)  # from home, metres away
    assert not reached.failed.any()
    np.testing.assert_allclose(reached.position, wanted, atol=1e-6)
    np.testing.assert_allclose(reached.rotation, rest.rotation, atol=1e-6)
    np.testing.assert_allclose(reached.inconsistency, 0.0, atol=1e-6)
    np.testing.assert_allclose(reached.tension, rest.tension, rtol=1e-4)


def test_the_weight_hangs_on_the_tensions_of_a_settled_platform():
    """Seen from the exit points, the cables carry platform and all that hangs of themselves."""
    robot = simple_robot(linear_density=np.full(4, 1e-6))  # cables without weight
    worlds = SettledWorlds(robot, 6)
    reached = worlds.reset(np.arange(6), positions(robot, 6))
    anchors = np.einsum("bij,nj->bni", reached.rotation, robot.anchor_points)
    cable = robot.exit_points - anchors - reached.position[:, None]
    unit = cable / np.linalg.norm(cable, axis=2, keepdims=True)
    force = np.einsum("bn,bni->bi", reached.tension, unit)
    expected = np.tile([0.0, 0.0, robot.mass * robot.gravity], (6, 1))
    np.testing.assert_allclose(force, expected, atol=0.02)


def test_particles_settle_where_the_equilibrium_says():
    robot = load_robot("carosac")
    wanted = positions(robot, 3, share=0.6)
    length = straight_line.inverse_kinematics(robot, wanted)
    length[:, 0] += [0.05, -0.05, 0.1]  # lengths that do not agree: the platform tilts
    settled = SettledWorlds(robot, 3).advance(length)
    assert not settled.failed.any()
    simulator = Simulator(robot, worlds=3, cables="particles")
    simulator.reset(unstrained_length=length)
    simulator.step(length, 1.0)
    state = simulator.state.numpy()
    assert np.linalg.norm(settled.position - state.position, axis=1).max() < 3e-3
    assert np.abs(settled.rotation - state.rotation).max() < 0.02


def test_inconsistency_of_settled_lengths_is_what_they_lack_to_inverse_kinematics():
    robot = simple_robot()
    wanted = positions(robot, 4, share=0.5)
    asked = statics.inverse_kinematics(robot, wanted).unstrained_length
    asked[:, 2] += 0.05
    reached = SettledWorlds(robot, 4).advance(asked)
    assert not reached.failed.any()
    ideal = statics.inverse_kinematics(robot, reached.position).unstrained_length
    np.testing.assert_allclose(reached.inconsistency, asked - ideal, atol=1e-9)
    assert (np.abs(reached.inconsistency).max(axis=1) > 5e-3).all()


def test_lengths_on_which_nothing_can_hang_fail_and_leave_the_platform():
    robot = simple_robot()
    worlds = SettledWorlds(robot, 3)
    before = worlds.reset(np.arange(3), positions(robot, 3, share=0.5))
    asked = before.length.copy()
    asked[1] = 2.0  # too short to meet by metres: no finite tension within limits holds that
    reached = worlds.advance(asked)
    assert reached.failed.tolist() == [False, True, False]
    np.testing.assert_array_equal(reached.position[1], before.position[1])
    np.testing.assert_array_equal(reached.length[1], before.length[1])
    again = worlds.advance(before.length)  # and it goes on from there
    assert not again.failed.any()
    np.testing.assert_allclose(again.position, before.position, atol=1e-6)


@pytest.mark.parametrize("kind", [NoSagWorlds, SettledWorlds])
def test_a_state_is_not_touched_by_what_happens_afterwards(kind):
    robot = simple_robot()
    worlds = kind(robot, 3)
    start = worlds.reset(np.arange(3), positions(robot, 3, share=0.5))
    crooked = start.length + np.array([0.05, 0.0, 0.0, 0.0])
    worlds.advance(crooked)
    state = worlds.state()

    def go_on():
        found = worlds.reset(np.array([0]), positions(robot, 1, seed=9))
        return found, worlds.advance(crooked + 0.01)

    first, second = go_on(), None
    worlds.restore(state)
    second = go_on()
    for one, other in zip(first, second, strict=True):
        for name in ("position", "rotation", "length", "inconsistency"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name), name)


def test_settled_worlds_refuse_a_start_without_rest_and_a_robot_that_cannot_hang():
    robot = simple_robot()
    with pytest.raises(InvalidField, match=r"position: got .*; allowed: where the robot can rest"):
        SettledWorlds(robot, 1).reset(np.arange(1), np.array([[0.4, -1.8, 20.0]]))
    heavy = simple_robot(mass=1e5)
    with pytest.raises(InvalidField, match="a stable equilibrium at home; simple has none"):
        SettledWorlds(heavy, 1)
