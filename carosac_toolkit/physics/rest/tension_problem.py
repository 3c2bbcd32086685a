"""Input of every search for tensions: structure matrix, wrench and limits, checked once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from carosac_toolkit.base.arrays import Array, as_floats, batch
from carosac_toolkit.base.errors import InvalidField

DistributionName = Literal["least_squares", "minimum", "p_norm", "centre"]
DISTRIBUTIONS: tuple[str, ...] = get_args(DistributionName)  # in the order of the kernels


@dataclass(frozen=True, kw_only=True, eq=False)
class TensionProblem:
    """Find f with A f + w = 0 within limits, B times; moments are divided by the lever arm.

    Attributes:
        columns: A, column by column [1], shape (B, n, 6).
        wrench: w [N], shape (B, 6).
        lower: Lower limits [N], shape (B, n).
        upper: Upper limits [N], shape (B, n).
    """

    columns: Array
    wrench: Array
    lower: Array
    upper: Array


def prepare(
    structure_matrix: ArrayLike,
    wrench: ArrayLike,
    tension_min: ArrayLike,
    tension_max: ArrayLike,
    arm: float | None,
) -> TensionProblem:
    """Check and scale what `tension_margin.solve` and `tension_distribution.solve` are given.

    Raises:
        InvalidField: Wrong shapes, or a lower limit above its upper one.
    """
    matrix = as_floats("structure_matrix", structure_matrix)
    if matrix.ndim != 3 or matrix.shape[1] != 6:
        raise InvalidField("structure_matrix", f"shape {matrix.shape}", "shape (B, 6, n)")
    matrix = batch("structure_matrix", matrix, (6, matrix.shape[2]))
    size, _, n = matrix.shape
    load = batch("wrench", wrench, (6,))
    if len(load) != size:
        raise InvalidField("wrench", f"shape {load.shape}", f"shape ({size}, 6)")
    if arm is not None and (not arm > 0.0 or not np.isfinite(arm)):
        raise InvalidField("arm", f"{arm} m", "arm > 0")
    lower = per_cable("tension_min", tension_min, size, n)
    upper = per_cable("tension_max", tension_max, size, n)
    check_order(lower, upper)
    scale = np.ones((size, 6))
    scale[:, 3:] /= (levers(matrix) if arm is None else np.full(size, arm))[:, None]
    columns = np.ascontiguousarray((matrix * scale[:, :, None]).swapaxes(1, 2))
    return TensionProblem(columns=columns, wrench=load * scale, lower=lower, upper=upper)


def levers(structure_matrix: Array) -> Array:
    """Return the largest lever arm of a cable about the platform origin [m], shape (B,).

    It grows with the platform, so that dimensionless results do not depend on its size. Where all
    cables act at the origin there are no moments to scale, and it is 1 m.
    """
    arm: Array = np.linalg.norm(structure_matrix[:, 3:], axis=1).max(axis=1, initial=0.0)
    return np.where(arm > 0.0, arm, 1.0)


def per_cable(name: str, value: ArrayLike, size: int, n: int) -> Array:
    """Broadcast a number, (n,) or (B, n), to (B, n)."""
    array = as_floats(name, value)
    if array.shape not in ((), (n,), (size, n)):
        raise InvalidField(name, f"shape {array.shape}", f"a number, shape ({n},) or ({size}, {n})")
    return batch(name, np.broadcast_to(array, (size, n)), (n,))


def check_order(lower: Array, upper: Array) -> None:
    """Refuse crossed limits, shape (B, n)."""
    bad = lower > upper
    if bad.any():
        b, i = (int(k) for k in np.argwhere(bad)[0])
        raise InvalidField(f"tension_min[{i}]", f"{lower[b, i]} N", f"<= {upper[b, i]} N")


def check_distribution(name: str, n: int | None = None) -> None:
    """Refuse an unknown distribution, and a choice for a robot of n cables that has none.

    Raises:
        InvalidField: Names ``distribution``.
    """
    if name not in DISTRIBUTIONS:
        raise InvalidField("distribution", repr(name), f"one of {list(DISTRIBUTIONS)}")
    if n is not None and n < 6 and name != "least_squares":
        allowed = f"'least_squares': statics determine the tensions of {n} cables"
        raise InvalidField("distribution", repr(name), allowed)
