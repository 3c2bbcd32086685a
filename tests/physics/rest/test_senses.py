import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.values import State
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.senses import sensed_home, turn_between
from carosac_toolkit.physics.rest.structure import structure_matrix
from tests.robots import eight_cable_robot, simple_robot

ROBOTS = [simple_robot(), eight_cable_robot()]


def home_of(robot, position=None):
    where = robot.home_position if position is None else np.asarray(position)
    return State(time=np.zeros(1), position=where[None], rotation=robot.home_rotation[None])


@pytest.mark.parametrize("robot", ROBOTS, ids=lambda robot: robot.name)
def test_derivatives_predict_the_readings_a_centimetre_away(robot):
    here = sensed_home(robot, home_of(robot))
    step = np.array([0.006, -0.005, 0.004])
    there = sensed_home(robot, home_of(robot, robot.home_position + step)).reading
    n = robot.n
    predicted = here.reading + here.by_position @ step
    assert there[:n] == pytest.approx(predicted[:n], abs=2e-2)  # the second order of 9 mm
    assert there[n : n + 3] == pytest.approx(predicted[n : n + 3], abs=2e-3)
    assert there[n + 3 : n + 6] == pytest.approx(robot.home_position + step, abs=1e-9)


@pytest.mark.parametrize("robot", ROBOTS, ids=lambda robot: robot.name)
def test_a_stress_between_the_cables_neither_lifts_nor_moves_the_platform(robot):
    sensed, n = sensed_home(robot, home_of(robot)), robot.n
    held = n >= 6
    assert sensed.by_stress.shape == (n + 9, n - (6 if held else 3))
    assert np.linalg.norm(sensed.by_stress[:n], axis=0) == pytest.approx(1.0)
    assert sensed.by_stress[n + 3 : n + 6] == pytest.approx(0.0, abs=1e-5)  # position [m/N]
    matrix = structure_matrix(robot, robot.home_position[None], sensed.rotation[None])[0]
    wrench = matrix[: 6 if held else 3] @ sensed.by_stress[:n]
    assert wrench == pytest.approx(0.0, abs=0.01)  # of 1 N; straight lines, cables hang


def test_six_cables_or_more_sense_a_wrong_rotation_and_fewer_are_turned_by_gravity():
    robot = eight_cable_robot()
    sensed = sensed_home(robot, home_of(robot))
    n, g = robot.n, robot.gravity
    assert sensed.by_rotation[n + 6 :] == pytest.approx(np.eye(3), abs=1e-6)
    tilt = np.array([[0.0, -g, 0.0], [g, 0.0, 0.0], [0.0, 0.0, 0.0]])  # of R^T (0, 0, g)
    assert sensed.by_rotation[n : n + 3] == pytest.approx(tilt, abs=1e-4)
    assert not sensed_home(simple_robot(), home_of(simple_robot())).by_rotation.any()


def test_the_turn_between_rotations_is_its_angle_about_its_axis():
    angle = 0.02
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    start = statics.inverse_kinematics(simple_robot(), simple_robot().home_position[None])
    rotation = start.rotation[0]
    assert turn_between(rotation, turn @ rotation) == pytest.approx([0.0, 0.0, angle], abs=1e-6)


def test_cables_that_hang_slack_are_not_taut():
    robot = simple_robot(linear_density=np.full(4, 5.0))  # 40 kg each
    assert not sensed_home(robot, home_of(robot)).taut
    assert sensed_home(simple_robot(), home_of(simple_robot())).taut


def test_a_home_without_rest_is_refused():
    robot = simple_robot()
    with pytest.raises(InvalidField, match="around which the platform can rest"):
        sensed_home(
            robot, home_of(robot, robot.exit_points.mean(axis=0) + np.array([0.0, 0.0, 5.0]))
        )
