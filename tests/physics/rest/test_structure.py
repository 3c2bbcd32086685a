"""The structure matrix against the lengths it is the derivative of."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from carosac_toolkit.physics.cable.straight_line import inverse_kinematics
from carosac_toolkit.physics.rest.structure import structure_matrix
from tests.robots import eight_cable_robot, simple_robot, with_pulleys


@pytest.mark.parametrize(
    "robot", [simple_robot(), with_pulleys(simple_robot()), eight_cable_robot()]
)
def test_structure_matrix_is_minus_the_transposed_length_jacobian(robot):
    rotation = Rotation.from_rotvec([0.4, -0.3, 0.2]).as_matrix()[None]
    position = robot.home_position[None] + 0.1
    step = 1e-6
    jacobian = np.zeros((robot.n, 6))
    for k in range(6):
        ends = []
        for sign in (1.0, -1.0):
            twist = np.zeros(6)
            twist[k] = sign * step
            turn = Rotation.from_rotvec(twist[3:]).as_matrix()
            ends.append(inverse_kinematics(robot, position + twist[:3], turn @ rotation)[0])
        jacobian[:, k] = (ends[0] - ends[1]) / (2.0 * step)
    assert structure_matrix(robot, position, rotation)[0] == pytest.approx(-jacobian.T, abs=1e-8)


def test_home_rotation_is_the_default_and_batch_equals_loop():
    robot = eight_cable_robot()
    where = robot.home_position + 0.1 * np.arange(9.0).reshape(3, 3) / 9.0
    together = structure_matrix(robot, where)
    for k in range(3):
        alone = structure_matrix(robot, where[k : k + 1], robot.home_rotation[None])
        assert alone[0] == pytest.approx(together[k], abs=1e-15)
