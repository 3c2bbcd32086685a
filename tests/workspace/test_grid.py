"""Grids: about as many positions as asked for, cells that fill the box, whatever its shape."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.rest.nearest import nearest_rest
from carosac_toolkit.workspace import box_grid, compute, search_grid, slice_grid
from tests.robots import hanging

BOXES = [[2.0, 2.0, 2.0], [4.0, 4.0, 1e-3], [30.0, 0.01, 0.01], [1.0, 3.0, 0.2]]


@pytest.mark.parametrize("size", BOXES)
@pytest.mark.parametrize("count", [1, 5, 1000])
def test_cells_fill_the_box_and_are_about_as_many_as_asked_for(size, count):
    grid = box_grid(np.zeros(3), np.array(size), count)
    number = len(grid.positions)
    assert count / 2 <= number <= 2 * count
    assert number * grid.cell == pytest.approx(np.prod(size))
    assert (grid.positions > 0.0).all() and (grid.positions < size).all()


@pytest.mark.parametrize("size", BOXES)
def test_a_plane_across_a_flat_box_has_about_as_many_positions_as_asked_for(size):
    grid = slice_grid(np.zeros(3), np.array(size), "x", 0.5, 900)
    assert 450 <= len(grid.positions) <= 2000  # edges included: a thin plane has two rows
    assert (grid.positions[:, 0] == 0.5).all() and grid.cell == 0.0
    assert [axis[0] for axis in grid.axes[1:]] == [0.0, 0.0]
    assert [axis[-1] for axis in grid.axes[1:]] == size[1:]


LOWER, UPPER = np.array([-1.0, -0.5, 1.0]), np.array([1.0, 0.5, 4.0])


def turned(angle, shift=0.0):
    """A robot of two cables, its exit points turned about the vertical and shifted along y."""
    robot = hanging(2)
    turn = Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()
    return replace(
        robot, exit_points=robot.exit_points @ turn.T + [0.0, shift, 0.0],
        anchor_points=robot.anchor_points + np.array([0.0, 0.03, 0.05]),
        center_of_mass=np.array([0.02, 0.05, -0.2]),  # the plane is beside the exit points
    )  # fmt: skip


@pytest.mark.parametrize("angle", [0.0, 0.3, np.pi / 2, -2.0])
def test_two_cables_are_judged_where_they_let_the_platform_rest(angle):
    robot = turned(angle)
    grid = search_grid(robot, LOWER, UPPER, 60)
    where = grid.positions
    assert 30 <= len(where) <= 120
    assert (where > LOWER - 1e-9).all() and (where < UPPER + 1e-9).all()
    rest = nearest_rest(robot, where)
    assert rest.equilibrium.converged.all()
    assert rest.distance == pytest.approx(0.0, abs=1e-9)
    region = compute(robot, grid)
    assert region.verdicts.rest.converged.mean() > 0.9  # low beside an exit point nothing holds
    np.testing.assert_allclose(grid.local(where)[:, 1], 0.0, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 0.2, np.pi / 2])
def test_the_area_of_a_plane_of_rest_is_that_of_its_part_in_the_box(angle):
    grid = search_grid(turned(angle), LOWER, UPPER, 500)
    width = min(2.0 / max(abs(np.cos(angle)), 1e-9), 1.0 / max(abs(np.sin(angle)), 1e-9))
    assert len(grid.positions) * grid.cell == pytest.approx(3.0 * width, rel=0.1)


def test_more_cables_are_judged_all_over_the_box():
    grid = search_grid(hanging(3), LOWER, UPPER, 500)
    np.testing.assert_array_equal(grid.positions, box_grid(LOWER, UPPER, 500).positions)
    assert not grid.rests and grid.cell == box_grid(LOWER, UPPER, 500).cell


def test_planes_are_named():
    moved = replace(hanging(2), exit_points=hanging(2).exit_points + np.array([0.0, 0.2, 0.0]))
    assert search_grid(moved, LOWER, UPPER, 50).title == "y = 0.2 m"
    assert slice_grid(LOWER, UPPER, "z", 2.0, 50).title == "z = 2 m"
    askew = search_grid(turned(0.3), LOWER, UPPER, 50).title
    assert askew.startswith("along (0.955, 0.296, 0) through (")


def test_a_plane_of_rest_that_is_not_there_is_refused():
    with pytest.raises(InvalidField, match=r"box: got .* a box that the plane of rest of the two"):
        search_grid(turned(0.0, shift=2.0), LOWER, UPPER, 50)
    above = replace(hanging(2), exit_points=np.array([[0.0, 0.0, 6.0], [0.0, 0.0, 5.0]]))
    with pytest.raises(InvalidField, match=r"exit_points: got .*not one above the other, with two"):
        search_grid(above, LOWER, UPPER, 50)
