r"""Straight-line kinematics: cables without weight or stretch, over pulleys if they have a radius.

This is the model most cable robots run on, and the one the sagging models are compared with. With
datum :math:`a_i`, anchor point :math:`b_i` and rotation :math:`R` held fixed,

.. math:: \ell_i(p) = r_i \theta_i + \lVert p + R b_i - P_i \rVert, \qquad
          p^* = \arg\min_p \sum_i (\ell_i(p) - L_i)^2,

where :math:`P_i` is the tangent point at wrap :math:`\theta_i`; with pulley radius 0 it is the
exit point and :math:`\theta_i = 0`. Nothing stretches, so lengths and unstrained lengths agree.

References:
    Dhakate et al., *CaRoSaC*, IEEE Robotics and Automation Letters, 2025.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from carosac_toolkit.arrays import Array, batch
from carosac_toolkit.errors import InvalidField
from carosac_toolkit.physics import straight_line_kernels, warp_setup
from carosac_toolkit.robot import Robot

TOLERANCE = 1e-10  # gradient norm over the longest length that counts as converged [-]
MAX_ITERATIONS = 200
_BATCH_SIZES_KEPT = 8  # buffers kept per robot


@dataclass(frozen=True, kw_only=True, eq=False)
class StraightCables:
    """The straight cables of a batch of poses.

    Attributes:
        length: Datum to anchor point, wrapped arc included [m], shape (B, n).
        wrap: Angle of contact with the pulley [rad], shape (B, n); 0 where the radius is 0.
        direction: Unit vector in W from the tangent point to the anchor point, shape (B, n, 3):
            the gradient of the length with respect to the platform's position; zero where an
            anchor point lies on its exit point.
        valid: False where the anchor point is inside the pulley and no cable exists, (B, n).
    """

    length: Array
    wrap: Array
    direction: Array
    valid: NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class StraightLineFit:
    """The positions that fit given lengths best, with their evidence.

    Attributes:
        position: Platform origin in W [m], shape (B, 3).
        rotation: The rotation from P to W that was held, shape (B, 3, 3).
        residual: Root mean square over the cables of the length error left [m], shape (B,).
        converged: True where `position` is a strict local minimum: the gradient of the squared
            error has vanished and its Hessian is positive definite, shape (B,).
        iterations: Steps tried, shape (B,).
    """

    position: Array
    rotation: Array
    residual: Array
    converged: NDArray[np.bool_]
    iterations: NDArray[np.int32]


def straight_length(
    robot: Robot, position: ArrayLike, rotation: ArrayLike | None = None
) -> StraightCables:
    """Straight cables at given poses, with the gradient of their lengths.

    Args:
        robot: Robot description, n cables.
        position: Platform origin in W [m], shape (B, 3).
        rotation: From P to W, shape (B, 3, 3); None is the home rotation.

    Returns:
        Lengths, wraps, gradients and whether each cable exists.
    """
    points = batch("position", position, (3,))
    turns = _rotations(robot, rotation, len(points))
    return _workspace(robot, len(points)).lengths(points, turns)


def inverse_kinematics(
    robot: Robot, position: ArrayLike, rotation: ArrayLike | None = None
) -> Array:
    """Straight-line lengths at given poses.

    Args:
        robot: Robot description, n cables.
        position: Platform origin in W [m], shape (B, 3).
        rotation: From P to W, shape (B, 3, 3); None is the home rotation.

    Returns:
        Lengths from datum to anchor point, wrapped arcs included [m], shape (B, n).

    Raises:
        InvalidField: An anchor point lies inside its pulley, where no cable exists.
    """
    cables = straight_length(robot, position, rotation)
    if not cables.valid.all():
        row, cable = (int(i) for i in np.argwhere(~cables.valid)[0])
        raise InvalidField(
            f"position[{row}]",
            np.asarray(position)[row],
            f"positions that keep the anchor point of cable '{robot.cable_names[cable]}' "
            f"outside its pulley of radius {robot.pulley_radius[cable]} m",
        )
    return cables.length


def forward_kinematics(
    robot: Robot,
    length: ArrayLike,
    *,
    rotation: ArrayLike | None = None,
    guess: ArrayLike | None = None,
) -> StraightLineFit:
    """Positions whose straight-line lengths come closest to the given ones.

    The squared error has several minima: where the exit points are near one plane, each solution
    below it has a twin above it. The one found is the one downhill from the guess; the default, the
    home position, finds the side on which the robot works. Where lengths are consistent the
    residual vanishes; check it where they may not be.

    Args:
        robot: Robot description, n cables.
        length: Cable lengths from datum to anchor point [m], shape (B, n).
        rotation: From P to W, held fixed, shape (B, 3, 3); None is the home rotation.
        guess: Where to start [m], shape (B, 3); None is the home position.

    Returns:
        Best-fitting positions, with residuals and `converged`; where that is False the position is
        the last iterate.
    """
    targets = batch("length", length, (robot.n,))
    turns = _rotations(robot, rotation, len(targets))
    start = robot.home_position if guess is None else batch("guess", guess, (3,))
    if guess is not None and len(start) != len(targets):
        raise InvalidField("guess", f"shape {start.shape}", f"shape {(len(targets), 3)}")
    return _workspace(robot, len(targets)).fit(targets, turns, start)


class _Workspace:
    """Buffers and recorded launches of one robot and one batch size: a call allocates little."""

    def __init__(self, robot: Robot, size: int) -> None:
        warp_setup.load(straight_line_kernels)
        self._lock = threading.Lock()
        n = robot.n
        self._buffers: list[Any] = []  # keeps alive what the views look into
        self._position, position = self._new((size,), wp.vec3d)
        self._rotation, rotation = self._new((size,), wp.mat33d)
        self._target, target = self._new((size, n), wp.float64)
        self._length, length = self._new((size, n), wp.float64)
        self._wrap, wrap = self._new((size, n), wp.float64)
        self._direction, direction = self._new((size, n), wp.vec3d)
        self._valid, valid = self._new((size, n), wp.int32)
        self._residual, residual = self._new((size,), wp.float64)
        self._converged, converged = self._new((size,), wp.int32)
        self._iterations, iterations = self._new((size,), wp.int32)
        shape = [
            self._constant(value, wp.vec3d if value.ndim == 2 else wp.float64)
            for value in (
                robot.exit_points, robot.anchor_points, robot.pulley_radius, robot.swivel_axis
            )
        ]  # fmt: skip
        cables = [position, rotation, *shape, length, wrap, direction, valid]
        self._measure = _record(straight_line_kernels.straight_lengths, (size, n), cables)
        limits = [wp.float64(TOLERANCE), MAX_ITERATIONS]
        fit = [target, rotation, *shape, *limits, position, residual, converged, iterations]
        self._solve = _record(straight_line_kernels.fit_position, (size,), fit)

    def lengths(self, position: Array, rotation: Array) -> StraightCables:
        """Run `straight_lengths`."""
        with self._lock:
            self._position[:] = position
            self._rotation[:] = rotation
            self._measure.launch()
            return StraightCables(
                length=self._length.copy(),
                wrap=self._wrap.copy(),
                direction=self._direction.copy(),
                valid=self._valid != 0,
            )

    def fit(self, target: Array, rotation: Array, start: Array) -> StraightLineFit:
        """Run `fit_position`."""
        with self._lock:
            self._target[:] = target
            self._rotation[:] = rotation
            self._position[:] = start
            self._solve.launch()
            return StraightLineFit(
                position=self._position.copy(),
                rotation=self._rotation.copy(),
                residual=self._residual.copy(),
                converged=self._converged != 0,
                iterations=self._iterations.copy(),
            )

    def _new(self, shape: tuple[int, ...], dtype: Any) -> tuple[NDArray[Any], Any]:
        """A zeroed Warp array and the numpy view of its memory."""
        buffer: Any = wp.zeros(shape, dtype=dtype, device="cpu")
        self._buffers.append(buffer)
        return buffer.numpy(), buffer

    def _constant(self, value: Array, dtype: Any) -> Any:
        buffer: Any = wp.array(value, dtype=dtype, device="cpu")
        self._buffers.append(buffer)
        return buffer


def _record(kernel: Any, dim: tuple[int, ...], inputs: list[Any]) -> Any:
    """Pack a launch once; launching it again costs a fraction of `wp.launch`."""
    return wp.launch(kernel, dim=dim, inputs=inputs, device="cpu", record_cmd=True)


_CACHE: WeakKeyDictionary[Robot, OrderedDict[int, _Workspace]] = WeakKeyDictionary()
_CACHE_LOCK = threading.Lock()


def _workspace(robot: Robot, size: int) -> _Workspace:
    """The workspace of this robot and batch size; the least recently used one is dropped."""
    with _CACHE_LOCK:
        kept = _CACHE.setdefault(robot, OrderedDict())
        if size not in kept:
            kept[size] = _Workspace(robot, size)
        kept.move_to_end(size)
        if len(kept) > _BATCH_SIZES_KEPT:
            kept.popitem(last=False)
        return kept[size]


def _rotations(robot: Robot, rotation: ArrayLike | None, size: int) -> Array:
    """Home rotation, or an argument of one rotation matrix per pose."""
    if rotation is None:
        return robot.home_rotation
    turns = batch("rotation", rotation, (3, 3))
    if len(turns) != size:
        raise InvalidField("rotation", f"shape {turns.shape}", f"shape {(size, 3, 3)}")
    error = np.abs(turns @ turns.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2))
    bad = (error > 1e-6) | (np.linalg.det(turns) < 0.0)
    if bad.any():
        index = int(np.argmax(bad))
        raise InvalidField(f"rotation[{index}]", "no rotation matrix", "R R^T = 1, det +1")
    return turns
