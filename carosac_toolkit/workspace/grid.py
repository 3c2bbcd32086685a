"""Positions on a grid in a box, and on planes through it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.robot.robot import Robot

GRID_AXES = "xyz"


@dataclass(frozen=True, eq=False)
class Grid:
    """Positions at all combinations of coordinates; the last axis with many is a line's.

    Attributes:
        axes: Coordinates along x, y and z of W [m], each rising.
        cell: Volume that each position stands for [m^3]; 0 on a plane.
    """

    axes: tuple[Array, Array, Array]
    cell: float

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of coordinates along each axis."""
        x, y, z = (len(axis) for axis in self.axes)
        return x, y, z

    @property
    def positions(self) -> Array:
        """Return all positions [m], shape (B, 3), z fastest."""
        return np.stack(np.meshgrid(*self.axes, indexing="ij"), axis=-1).reshape(-1, 3)

    @property
    def lines(self) -> NDArray[np.int64]:
        """Return where each line of positions along z, or y where z is one value, begins."""
        step = self.shape[2] if self.shape[2] > 1 else self.shape[1]
        return np.arange(0, int(np.prod(self.shape)), step)


def box_grid(lower: Array, upper: Array, count: int) -> Grid:
    """Return a grid of nearly cubic cells, positions in the middle of its cells.

    Args:
        lower: Lower corner of the box [m], shape (3,).
        upper: Upper corner [m], shape (3,).
        count: About how many positions.
    """
    span = upper - lower
    if not (span > 0.0).all():
        raise InvalidField("box", f"{lower} to {upper} m", "a lower corner below the upper one")
    numbers = _numbers(span, count)
    axes = [
        low + (np.arange(k) + 0.5) * (high - low) / k
        for low, high, k in zip(lower, upper, numbers, strict=True)
    ]
    return Grid((axes[0], axes[1], axes[2]), float(np.prod(span / numbers)))


def slice_grid(lower: Array, upper: Array, axis: str, value: float, count: int) -> Grid:
    """Return a plane of positions across the box, edges included.

    Args:
        lower: Lower corner of the box [m], shape (3,).
        upper: Upper corner [m], shape (3,).
        axis: The axis across the plane: x, y or z.
        value: Its coordinate there [m].
        count: About how many positions.
    """
    across = GRID_AXES.index(axis)
    rest = [k for k in range(3) if k != across]
    axes = [np.array([value])] * 3
    for k, number in zip(rest, _numbers((upper - lower)[rest], count), strict=True):
        axes[k] = np.linspace(lower[k], upper[k], number + 1)
    return Grid((axes[0], axes[1], axes[2]), 0.0)


def _numbers(span: Array, count: int) -> NDArray[np.int64]:
    """Return numbers of cells along axes, of equal size and together about `count`.

    A side thinner than these cells is one cell wide, and the others share them all.
    """
    numbers = np.ones(len(span), dtype=np.int64)
    order = np.argsort(span)
    for k, axis in enumerate(order):
        rest = span[order[k:]]
        edge = float((np.prod(rest) / count) ** (1.0 / len(rest)))
        if span[axis] >= edge:
            numbers[order[k:]] = np.maximum(np.round(rest / edge), 1.0)
            break
    return numbers


def box_of(robot: Robot, name: str) -> tuple[Array, Array]:
    """Return lower and upper corner of a box that a robot has [m].

    Args:
        robot: Robot description.
        name: ``workspace``, the box of its file, or ``frame``, the one around its exit points and
            that box.
    """
    if name == "workspace":
        return robot.workspace_min, robot.workspace_max
    lower = np.minimum(robot.exit_points.min(axis=0), robot.workspace_min)
    return lower, np.maximum(robot.exit_points.max(axis=0), robot.workspace_max)
