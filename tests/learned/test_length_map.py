import pickle

import numpy as np
import pytest
import warp as wp

from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.physics import warp_setup
from carosac_toolkit.physics.cable import straight_line, straight_line_kernels
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.robot.file import load_robot
from learned import length_map_kernels
from learned.length_map import LengthMap, softness
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
    found = lengths.lengths(points[sound])
    return np.abs(found - rest.unstrained_length[sound]).max(axis=1), points[sound]


def softness_of(lengths, points):
    """What the map says of it, column by column, shape (B, 3, 3)."""
    pushes = np.eye(3)[:, None].repeat(len(points), axis=1)
    return np.stack([lengths.displacement(points, push) for push in pushes], axis=2)


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


def test_beyond_the_box_sag_and_tilt_are_those_of_its_border(carosac):
    robot, lengths = carosac
    border = np.array([[robot.workspace_min[0], -1.8, 3.0]])
    shift = np.array([[-0.3, 0.0, 0.0]])
    moved = lengths.lengths(border + shift) - lengths.lengths(border)
    there = straight_line.inverse_kinematics(robot, border + shift)
    np.testing.assert_allclose(
        moved, there - straight_line.inverse_kinematics(robot, border), atol=1e-12
    )


def test_the_softness_is_that_of_the_rest_and_large_where_the_robot_sways(carosac):
    robot, lengths = carosac
    points = errors(robot, lengths)[1]
    inner = np.abs(points - robot.home_position).max(axis=1) < 1.5
    exact = softness(robot, statics.inverse_kinematics(robot, points[inner]))
    off = np.abs(softness_of(lengths, points[inner]) - exact)
    off /= np.abs(exact).max(axis=(1, 2), keepdims=True)
    assert np.median(off) < 0.02
    assert off.max() < 0.2
    home = np.diag(softness_of(lengths, robot.home_position[None])[0])
    assert home[0] > 5.0 * home[1] > 25.0 * abs(home[2])
    slow = np.sqrt(home[0]) * 2.0 * np.pi  # [s] the period of a mass on that spring alone
    assert slow == pytest.approx(1.0 / 0.45, rel=0.25)  # the slowest mode of sway, 0.45 Hz


def test_a_push_and_an_offset_lead_to_the_lengths_of_where_they_move_the_rest(carosac):
    robot, lengths = carosac
    rng = np.random.default_rng(3)
    points = rng.uniform(robot.workspace_min, robot.workspace_max, (20, 3))
    push, offset = rng.normal(size=(20, 3)), 0.1 * rng.normal(size=(20, 3))
    place = points + offset + lengths.displacement(points, push)
    np.testing.assert_allclose(
        lengths.lengths(points, push=push, offset=offset), lengths.lengths(place), atol=1e-12
    )


def test_copied_after_use_it_says_the_same(carosac):
    robot, lengths = carosac
    first = lengths.lengths(robot.home_position[None])
    copied = pickle.loads(pickle.dumps(lengths))
    np.testing.assert_array_equal(copied.lengths(robot.home_position[None]), first)


@pytest.mark.parametrize("shape", [(3,), (2, 2), (0, 3)])
def test_positions_of_another_shape_are_refused(carosac, shape):
    with pytest.raises(InvalidField, match=r"position: got shape .*; allowed: shape \(B, 3\)"):
        carosac[1].lengths(np.zeros(shape))


def test_a_batch_is_its_rows(carosac):
    robot, lengths = carosac
    points = np.random.default_rng(2).uniform(robot.workspace_min, robot.workspace_max, (5, 3))
    rows = [lengths.lengths(p[None])[0] for p in points]
    np.testing.assert_allclose(lengths.lengths(points), rows, atol=1e-12)


def test_a_robot_that_can_rest_in_little_of_its_box_is_refused(monkeypatch):
    monkeypatch.setattr("learned.length_map.CHEBYSHEV_NODES", 6)  # 216; 168 are needed
    high = simple_robot(workspace_max=[2.4, 0.2, 14.0])
    with pytest.raises(CarosacError, match=r"it can rest at .* % of its workspace box only"):
        LengthMap(high)


def test_the_kernel_compiles_for_a_gpu_where_there_is_none(tmp_path):
    """What environments on a GPU run, and nothing else does."""
    warp_setup.initialise()
    for module in (length_map_kernels, straight_line_kernels):
        (code,) = wp.compile_aot_module(module, arch=90, module_dir=tmp_path, use_ptx=True)
        assert code.suffix == ".ptx"
