"""Positions on a grid in a box, on planes through it, and where two cables let a platform rest."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.rest.nearest import PLANE_SHARE, nearest_rest, plane_of_rest
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.robot.sizes import SURFACE_CABLES, cable_size

GRID_AXES = "xyz"


@dataclass(frozen=True, eq=False)
class Grid:
    """Positions at all combinations of coordinates; the last axis with many is a line's.

    Attributes:
        axes: Coordinates along the axes of the grid [m], each rising: x, y and z of W, or on a
            plane of rest along it, across it (0) and upwards.
        cell: Volume that each position stands for [m^3], on a plane of rest its area [m^2]; 0 on a
            slice.
        directions: Unit vectors of these axes in W as columns, shape (3, 3).
        origin: Where the coordinates begin in W [m], shape (3,).
        rests: True for a plane of rest.
    """

    axes: tuple[Array, Array, Array]
    cell: float
    directions: Array = field(default_factory=lambda: np.eye(3))
    origin: Array = field(default_factory=lambda: np.zeros(3))
    rests: bool = False

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of coordinates along each axis."""
        x, y, z = (len(axis) for axis in self.axes)
        return x, y, z

    @property
    def positions(self) -> Array:
        """Return all positions in W [m], shape (B, 3), z fastest."""
        along = np.stack(np.meshgrid(*self.axes, indexing="ij"), axis=-1).reshape(-1, 3)
        return along @ self.directions.T + self.origin if self.rests else along

    def local(self, position: Array) -> Array:
        """Return the coordinates on the grid's axes of positions (B, 3) in W [m]."""
        return np.asarray((position - self.origin) @ self.directions)

    def axis_name(self, axis: int) -> str:
        """Name an axis: x, y or z, or its direction."""
        direction = self.directions[:, axis]
        major = int(np.argmax(np.abs(direction)))
        if direction[major] == 1.0:
            return GRID_AXES[major]
        return "along (" + ", ".join(f"{value:.3g}" for value in direction) + ")"

    @property
    def title(self) -> str:
        """Return the equation of a plane, such as ``z = 2 m``; of one that is askew a point."""
        across = 1 if self.rests else int(np.argmin(self.shape))
        name, point = (
            self.axis_name(across),
            self.origin + self.directions[:, across] * (self.axes[across][0]),
        )
        if name in GRID_AXES:
            return f"{name} = {point[GRID_AXES.index(name)]:.4g} m"
        return f"{self.axis_name(0)} through ({point[0]:.4g}, {point[1]:.4g}) m"

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


def search_grid(robot: Robot, lower: Array, upper: Array, count: int) -> Grid:
    """Return positions at which a robot may rest: a grid in a box, with two cables on a plane.

    Args:
        robot: Robot description; two cables hold a platform in a vertical plane only.
        lower: Lower corner of the box [m], shape (3,).
        upper: Upper corner [m], shape (3,).
        count: About how many positions.

    Raises:
        InvalidField: With two cables, there is no such plane, or it does not meet the box.
    """
    box = box_grid(lower, upper, count)
    if robot.n != SURFACE_CABLES:
        return box
    ends = np.stack(np.meshgrid(*zip(lower, upper, strict=True), indexing="ij"), axis=-1)
    nearest = nearest_rest(robot, np.vstack([robot.home_position[None], ends.reshape(-1, 3)]))
    rest = nearest.equilibrium
    if not rest.converged[0]:
        raise InvalidField("home.position", f"{robot.home_position} m", "near a position of rest")
    normal, point = plane_of_rest(robot, rest.position[rest.converged])
    normal = normal * np.sign(normal[np.argmax(np.abs(normal))])
    along = np.array([normal[1], -normal[0], 0.0])
    along = along * np.sign(along[np.argmax(np.abs(along))])
    rounding = PLANE_SHARE * cable_size(robot)
    offset = float(normal @ point)
    origin = normal * (offset if abs(offset) > rounding else 0.0)
    low, high = line_in_box(origin, along, lower, upper, rounding)
    if low >= high:
        place = f"({point[0]:.4g}, {point[1]:.4g}) m along ({along[0]:.3g}, {along[1]:.3g})"
        allowed = f"a box that the plane of rest of the two cables meets, through {place}"
        raise InvalidField("box", f"{lower} to {upper} m", allowed)
    first, last = np.array([low, lower[2]]), np.array([high, upper[2]])
    numbers = _numbers(last - first, count)
    level, up = (
        a + (np.arange(k) + 0.5) * (b - a) / k for a, b, k in zip(first, last, numbers, strict=True)
    )
    return Grid(
        (level, np.zeros(1), up), float(np.prod((last - first) / numbers)), rests=True,
        directions=np.stack([along, normal, [0.0, 0.0, 1.0]], axis=1), origin=origin,
    )  # fmt: skip


def line_in_box(
    origin: Array, along: Array, lower: Array, upper: Array, tolerance: float = 0.0
) -> tuple[float, float]:
    """Return where a horizontal line enters and leaves a box, as seen from above.

    Args:
        origin: Its origin in W [m], shape (3,).
        along: Its unit vector in W, shape (3,).
        lower: Lower corner of the box [m], shape (3,).
        upper: Upper corner [m], shape (3,).
        tolerance: By how much it may miss the box [m].

    Returns:
        Coordinates on the line [m]; the first is not below the second if it misses the box.
    """
    low, high = -np.inf, np.inf
    size = float(np.linalg.norm(upper - lower))
    for k in range(2):
        if abs(along[k]) * size <= tolerance:  # along this side, but for rounding
            if not lower[k] - tolerance <= origin[k] <= upper[k] + tolerance:
                return 0.0, 0.0
            continue
        ends = sorted(float((side[k] - origin[k]) / along[k]) for side in (lower, upper))
        low, high = max(low, ends[0]), min(high, ends[1])
    return low, high


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
