"""Shapes of cables at any pose, at rest or not: each hangs between its exit and its anchor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from carosac_toolkit.base.arrays import Array, batch, check_rotations
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics import warp_setup
from carosac_toolkit.physics.cable import hanging_kernels
from carosac_toolkit.physics.device import check_call, device_robot
from carosac_toolkit.physics.fleet import Fleet
from carosac_toolkit.robot.robot import Robot

HANGING_CLOSURE_MAX_M = 1e-9  # [m]: a cable that misses its anchor point by more has not been found


@dataclass(frozen=True, kw_only=True, eq=False)
class HangingCables:
    """Cables of B poses, n each, as quasi-static elastic catenaries.

    Attributes:
        points: Along the free cable in W [m], shape (B, n, samples, 3), tangent point first,
            anchor point last, evenly spaced in unstrained length.
        tension: At the platform [N], shape (B, n).
        exit_tension: Tension vector at the exit, pointing from platform to exit [N], (B, n, 3).
        valid: Whether the cable was found, shape (B, n); where it is False the rest is NaN.
    """

    points: Array
    tension: Array
    exit_tension: Array
    valid: NDArray[np.bool_]


def hanging_cables(
    robot: Robot | Fleet,
    position: ArrayLike,
    rotation: ArrayLike,
    unstrained_length: ArrayLike,
    *,
    samples: int = 24,
    device: str = "cpu",
) -> HangingCables:
    """Hang cables of known length at a pose that need not be one of rest.

    Args:
        robot: Robot description, n cables; a `Fleet` has a robot for each row.
        position: Platform origin in W [m], shape (B, 3).
        rotation: Rotation from P to W, shape (B, 3, 3).
        unstrained_length: Datum to anchor [m], shape (B, n); NaN or <= 0 where there is no cable.
        samples: Points per cable, at least 2.
        device: Warp device.

    Returns:
        The shape and tension of each cable, with a status.

    Raises:
        InvalidField: A wrong shape, or an invalid pose.
    """
    check_call(robot, device)
    if samples < 2:
        raise InvalidField("samples", samples, "samples >= 2")
    where = batch("position", position, (3,))
    turn = batch("rotation", rotation, (3, 3))
    length = np.asarray(unstrained_length, dtype=np.float64)
    shape = (len(where), robot.n)
    if length.shape != shape or len(turn) != len(where):
        got = f"shapes {turn.shape} and {length.shape}"
        allowed = f"({len(where)}, 3, 3) and {shape}"
        raise InvalidField("rotation and unstrained_length", got, allowed)
    check_rotations("rotation", turn)
    known = np.isfinite(length) & (length > 0.0)
    warp_setup.load(hanging_kernels, device)
    cables, _ = device_robot(robot, device)
    tension = wp.zeros(shape, dtype=wp.float64, device=device)
    closure = wp.zeros(shape, dtype=wp.float64, device=device)
    q = wp.zeros(shape, dtype=wp.vec3d, device=device)
    points = wp.zeros((*shape, samples), dtype=wp.vec3d, device=device)
    inputs = [
        cables,
        wp.array(where, dtype=wp.vec3d, device=device),
        wp.array(turn, dtype=wp.mat33d, device=device),
        wp.array(np.where(known, length, 1.0), dtype=wp.float64, device=device),
        tension, q, closure, points,
    ]  # fmt: skip
    wp.launch(hanging_kernels.hanging_points, shape, inputs=inputs, device=device)
    valid = known & (closure.numpy() <= HANGING_CLOSURE_MAX_M)
    return HangingCables(
        points=np.where(valid[..., None, None], points.numpy(), np.nan),
        tension=np.where(valid, tension.numpy(), np.nan),
        exit_tension=np.where(valid[..., None], q.numpy(), np.nan),
        valid=valid,
    )


def offset_from_chord(points: Array) -> Array:
    """Return the sag of cables: offsets of their points from the line between their ends.

    Args:
        points: Along each cable in W [m], shape (..., samples, 3).

    Returns:
        Vectors across the chord, from it to each point [m], shape (..., samples, 3).
    """
    chord = points[..., -1:, :] - points[..., :1, :]
    length = np.linalg.norm(chord, axis=-1, keepdims=True)
    unit = chord / np.where(length > 0.0, length, 1.0)
    offset = points - points[..., :1, :]
    across: Array = offset - (offset * unit).sum(axis=-1, keepdims=True) * unit
    return across
