"""Grids: about as many positions as asked for, cells that fill the box, whatever its shape."""

import numpy as np
import pytest

from carosac_toolkit.workspace import box_grid, slice_grid

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
