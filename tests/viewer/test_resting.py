"""A robot at rest that is moved by its target or its lengths: it obeys, or stays and says why."""

import numpy as np
import pytest

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.viewer.resting import RestingRobot


@pytest.fixture
def scampi():
    return RestingRobot(load_robot("scampi"))


def test_the_platform_comes_to_the_target_and_rests_there(scampi):
    target = scampi.robot.home_position + np.array([0.4, -0.5, 0.8])
    picture = scampi.follow_target(target)
    assert picture.position == pytest.approx(target, abs=1e-9)
    assert not picture.held and not picture.problem and picture.status == "at rest"
    assert scampi.rest.residual[0] < 1e-9 * scampi.robot.weight
    again = statics.forward_kinematics(scampi.robot, scampi.rest.unstrained_length)
    assert again.position[0] == pytest.approx(target, abs=1e-6)


def test_an_infeasible_target_leaves_the_last_feasible_pose_and_says_so(scampi):
    good = scampi.follow_target(scampi.robot.home_position + np.array([0.0, 0.0, 0.5]))
    above = np.array([0.3, -1.8, 9.0])  # higher than any exit: cables do not push
    picture = scampi.follow_target(above)
    assert picture.held and picture.problem
    assert picture.status.startswith("INFEASIBLE") and "last feasible pose" in picture.status
    assert picture.position == pytest.approx(good.position)
    assert picture.tension == pytest.approx(good.tension)
    assert picture.target == pytest.approx(above)
    back = scampi.follow_target(scampi.robot.home_position)
    assert not back.held and back.position == pytest.approx(scampi.robot.home_position, abs=1e-9)


def test_the_lengths_of_a_pose_lead_back_to_it(scampi):
    target = scampi.robot.home_position + np.array([0.2, 0.3, 0.4])
    scampi.follow_target(target)
    lengths = scampi.rest.unstrained_length[0].copy()
    scampi.follow_target(scampi.robot.home_position)
    assert scampi.follow_lengths(lengths).position == pytest.approx(target, abs=1e-6)


def test_longer_cables_let_the_platform_down_and_a_slack_one_is_named():
    resting = RestingRobot(load_robot("cogiro"))
    lengths = resting.rest.unstrained_length[0].copy()
    lower = resting.follow_lengths(lengths + 0.1)
    assert lower.position[2] < resting.robot.home_position[2] - 0.05
    lengths[2] += 0.5
    picture = resting.follow_lengths(lengths)
    name = resting.robot.cable_names[2]
    assert picture.problem and not picture.held
    assert f"cable {name} slack" in picture.status and "OUTSIDE" in picture.status
    assert picture.tension[2] < resting.robot.tension_min[2]
    assert picture.sag[2] > 10 * lower.sag[2]


def test_lengths_that_are_none_change_nothing(scampi):
    before = scampi.home()
    picture = scampi.follow_lengths(np.array([8.0, -1.0, 8.0, 8.0]))
    assert picture.held and picture.position == pytest.approx(before.position)


def test_a_turned_target_is_held_by_eight_cables():
    resting = RestingRobot(load_robot("ipanema1"))
    turn = np.array([[0.995004, -0.0998334, 0.0], [0.0998334, 0.995004, 0.0], [0.0, 0.0, 1.0]])
    u, _, v = np.linalg.svd(turn)
    picture = resting.follow_target(resting.robot.home_position, u @ v)
    assert not picture.held and picture.rotation == pytest.approx(turn, abs=1e-5)


def test_a_robot_that_cannot_rest_at_home_is_refused():
    from dataclasses import replace

    robot = load_robot("scampi")
    heavy = replace(robot, mass=400.0)  # more than its cables may carry
    with pytest.raises(CarosacError, match="no equilibrium at its home position"):
        RestingRobot(heavy)
