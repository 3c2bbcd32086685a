"""Cable lengths at known poses and tensions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from carosac_toolkit.base.arrays import Array, as_floats, batch
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics import warp_setup
from carosac_toolkit.physics.cable import hanging_kernels
from carosac_toolkit.physics.device import device_robot
from carosac_toolkit.robot.robot import Robot

TENSIONED_CLOSURE_MAX_M = 1e-10  # [m]: a larger gap is no solution
TENSION_MISMATCH_MAX = 1e-9  # of the tension: a larger one is no solution


@dataclass(frozen=True, kw_only=True, eq=False)
class CableLengths:
    """Cables of known tension between datum and anchor; NaN where `valid` is False.

    Attributes:
        unstrained_length: Material from datum to anchor [m], shape (B, n).
        sag: By how much the free cable is longer than its chord, as it hangs [m], shape (B, n).
        stretch: Elongation of free cable and run together [m], shape (B, n).
        valid: True if there is such a cable, shape (B, n).
    """

    unstrained_length: Array
    sag: Array
    stretch: Array
    valid: NDArray[np.bool_]


def length_at_tension(
    robot: Robot,
    position: ArrayLike,
    rotation: ArrayLike,
    tension: ArrayLike,
    *,
    device: str = "cpu",
) -> CableLengths:
    """Solve for the length of each cable that reaches a pose with a required tension.

    Of the two cables that may do so, a taut and a deeply sagging one, the taut one is meant; below
    the least tension with which a cable can hang there, there is none.

    Args:
        robot: Robot description, n cables.
        position: Platform origin in W [m], shape (B, 3).
        rotation: Rotation from P to W, shape (B, 3, 3).
        tension: At the platform [N], shape (B, n); NaN where unknown.
        device: Warp device.

    Returns:
        The lengths; a tension that is unknown or not positive has none.
    """
    where = batch("position", position, (3,))
    turn = batch("rotation", rotation, (3, 3))
    asked = as_floats("tension", tension)
    shape = (len(where), robot.n)
    if asked.shape != shape or len(turn) != len(where):
        got = f"shapes {turn.shape} and {asked.shape}"
        raise InvalidField("rotation and tension", got, f"({len(where)}, 3, 3) and {shape}")
    known = np.isfinite(asked) & (asked > 0.0)
    warp_setup.load(hanging_kernels, device)
    cables, _ = device_robot(robot, device)
    inputs = [
        wp.array(where, dtype=wp.vec3d, device=device),
        wp.array(turn, dtype=wp.mat33d, device=device),
        wp.array(np.where(known, asked, 1.0), dtype=wp.float64, device=device),
    ]
    outputs = [wp.zeros(shape, dtype=wp.float64, device=device) for _ in range(5)]
    taut = wp.zeros(shape, dtype=int, device=device)
    wp.launch(
        hanging_kernels.cables_of_tension,
        shape,
        inputs=[cables, *inputs, *outputs, taut],
        device=device,
    )
    length, sag, stretch, closure, mismatch = (a.numpy() for a in outputs)
    valid = (
        known
        & (closure <= TENSIONED_CLOSURE_MAX_M)
        & (mismatch <= TENSION_MISMATCH_MAX * np.where(known, asked, 1.0))
    )
    valid &= (length > 0.0) & (taut.numpy() == 1)
    return CableLengths(
        unstrained_length=np.where(valid, length, np.nan),
        sag=np.where(valid, sag, np.nan),
        stretch=np.where(valid, stretch, np.nan),
        valid=valid,
    )
