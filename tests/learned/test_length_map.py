import numpy as np
import pytest

from carosac_toolkit.errors import CarosacError, InvalidField
from carosac_toolkit.physics import statics, straight_line
from carosac_toolkit.robot_file import load_robot
from learned.length_map import LengthMap
from tests.robots import simple_robot


@pytest.fixture(scope="module")
def carosac():
    robot = load_robot("carosac")
    return robot, LengthMap(robot)


def errors(robot, lengths, count=1500):
    """Largest error of a cable at random feasible positions [m], and the positions."""
    rng = np.random.default_rng(0)
    points = rng.uniform(robot.workspace_min, robot.workspace_max, (count, 3))
    rest = statics.inverse_kinematics(robot, points)
    sound = rest.converged & rest.stable
    found = lengths.lengths(points[sound], np.zeros((sound.sum(), 3)))
    return np.abs(found - rest.unstrained_length[sound]).max(axis=1), points[sound]


def test_the_map_is_catenary_inverse_kinematics_to_millimetres(carosac):
    """Errors are largest where a corner of the box is out of reach; straight lines err more."""
    robot, lengths = carosac
    error, points = errors(robot, lengths)
    assert np.median(error) < 1e-3
    assert error.max() < 1e-2
    assert 0.9 < lengths.feasible < 1.0
    straight = straight_line.inverse_kinematics(robot, points)
    rest = statics.inverse_kinematics(robot, points).unstrained_length
    assert np.median(np.abs(straight - rest).max(axis=1)) > 5.0 * np.median(error)


def test_the_map_says_how_far_off_it_is(carosac):
    robot, lengths = carosac
    assert errors(robot, lengths)[0].max() < 2.0 * lengths.largest_error


def test_a_displacement_moves_the_rest(carosac):
    robot, lengths = carosac
    position = robot.home_position[None]
    shift = np.array([[0.3, -0.2, 0.1]])
    rest = statics.inverse_kinematics(robot, position + shift)
    off = np.abs(lengths.lengths(position, shift) - rest.unstrained_length).max()
    assert off < 2.0 * lengths.largest_error


def test_beyond_the_box_sag_and_tilt_are_those_of_its_border(carosac):
    robot, lengths = carosac
    border = np.array([[robot.workspace_min[0], -1.8, 3.0]])
    shift = np.array([[-0.3, 0.0, 0.0]])
    moved = lengths.lengths(border, shift) - lengths.lengths(border, 0.0 * shift)
    there = straight_line.inverse_kinematics(robot, border + shift)
    np.testing.assert_allclose(
        moved, there - straight_line.inverse_kinematics(robot, border), atol=1e-12
    )


def test_a_batch_is_its_rows(carosac):
    robot, lengths = carosac
    rng = np.random.default_rng(2)
    points = rng.uniform(robot.workspace_min, robot.workspace_max, (5, 3))
    shift = rng.uniform(-0.3, 0.3, (5, 3))
    rows = [lengths.lengths(p[None], d[None])[0] for p, d in zip(points, shift, strict=True)]
    np.testing.assert_allclose(lengths.lengths(points, shift), rows, atol=1e-12)


@pytest.mark.parametrize("wrong", [[[0.4, -1.8, 5.5]], [[np.nan, -1.8, 2.0]]])
def test_positions_outside_the_box_are_refused(carosac, wrong):
    with pytest.raises(InvalidField, match=r"position\[0\]: .*positions in the workspace box"):
        carosac[1].lengths(np.array(wrong), np.zeros((1, 3)))


def test_a_robot_that_can_rest_in_little_of_its_box_is_refused(monkeypatch):
    monkeypatch.setattr("learned.length_map.NODES", 6)  # 216; 168 are needed
    high = simple_robot(workspace_max=[2.4, 0.2, 14.0])
    with pytest.raises(CarosacError, match=r"it can rest at .* % of its workspace box only"):
        LengthMap(high)
