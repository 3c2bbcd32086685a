r"""How far tensions that balance a wrench can be kept from their limits.

.. math:: s^* = \max_{f, s} s \quad \text{subject to} \quad A f + w = 0, \quad
    f_{min} + s \le f \le f_{max} - s

A wrench is feasible where :math:`s^* \ge 0`. The linear program is solved exactly for any n, one
thread each, and every answer carries its proof: multipliers :math:`\lambda \ge 0` of the 2n limits,
of sum 1, with :math:`\lambda_{low} - \lambda_{high}` in the row space of A. Loosening limit j by
1 N raises the margin by :math:`\lambda_j` N, so that the largest one names the limit that counts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from carosac_toolkit.arrays import Array, as_floats, batch
from carosac_toolkit.errors import InvalidField
from carosac_toolkit.physics import hold_kernels, margin_kernels, warp_setup
from carosac_toolkit.physics.cable_kernels import vec6d

ROUNDING = 1e-9  # of the largest limit: how well a margin must be proved
CHUNK = 16384  # problems at a time: what bounds the memory; rows do not know of each other


@dataclass(frozen=True, kw_only=True, eq=False)
class TensionMargin:
    """The largest margins of B wrenches.

    Attributes:
        margin: [N], shape (B,); negative where no tensions within the limits balance the wrench:
            by so much all limits would have to be widened. Minus infinity where no tensions at all
            do, of whatever sign.
        tension: Balanced tensions that have this margin [N], shape (B, n).
        low: Multiplier of each lower limit: N of margin per N of limit, shape (B, n).
        high: The same of each upper limit, shape (B, n); low and high have the sum 1.
        gap: By how much the margin could be larger at most, proved by low and high [N], (B,).
        solved: Whether the proof holds to rounding, shape (B,); elsewhere numbers mean nothing.
    """

    margin: Array
    tension: Array
    low: Array
    high: Array
    gap: Array
    solved: NDArray[np.bool_]


def solve(
    structure_matrix: ArrayLike,
    wrench: ArrayLike,
    tension_min: ArrayLike,
    tension_max: ArrayLike,
    *,
    arm: float = 1.0,
    device: str = "cpu",
) -> TensionMargin:
    """Largest margins of tensions to their limits, B problems at once.

    Args:
        structure_matrix: A, maps tensions to the wrench on the platform, shape (B, 6, n).
        wrench: External wrench w at the platform origin, in W [N, N m], shape (B, 6).
        tension_min: Lower limits [N], shape (n,).
        tension_max: Upper limits [N], shape (n,).
        arm: Lever arm that makes moments comparable with forces [m].
        device: Warp device.

    Returns:
        Margins, each with its proof.

    Raises:
        InvalidField: Wrong shapes, or a lower limit above its upper one.
    """
    matrix = as_floats("structure_matrix", structure_matrix)
    if matrix.ndim != 3 or matrix.shape[1] != 6:
        raise InvalidField("structure_matrix", f"shape {matrix.shape}", "shape (B, 6, n)")
    matrix = batch("structure_matrix", matrix, (6, matrix.shape[2]))
    load = batch("wrench", wrench, (6,))
    if len(load) != len(matrix):
        raise InvalidField("wrench", f"shape {load.shape}", f"shape ({len(matrix)}, 6)")
    if not arm > 0.0 or not np.isfinite(arm):
        raise InvalidField("arm", f"{arm} m", "arm > 0")
    n = matrix.shape[2]
    lower, upper = _limits("tension_min", tension_min, n), _limits("tension_max", tension_max, n)
    if (lower > upper).any():
        i = int(np.argmax(lower > upper))
        raise InvalidField(f"tension_min[{i}]", f"{lower[i]} N", f"<= {upper[i]} N")
    scale = np.array([1.0, 1.0, 1.0, 1.0 / arm, 1.0 / arm, 1.0 / arm])
    columns = np.ascontiguousarray((matrix * scale[:, None]).swapaxes(1, 2))
    parts = [
        _launch(columns[k : k + CHUNK], -load[k : k + CHUNK] * scale, lower, upper, device)
        for k in range(0, len(columns), CHUNK)
    ]
    margin, gap, status, tension, weight = (np.concatenate(x) for x in zip(*parts, strict=True))
    size = float(np.abs(upper).max())
    scaled = np.where(np.isfinite(margin), np.abs(margin), 0.0)
    unbalanced = status == 2
    return TensionMargin(
        margin=np.where(unbalanced, -np.inf, margin),
        tension=tension,
        low=np.where(unbalanced[:, None], 0.0, weight[:, :n]),
        high=np.where(unbalanced[:, None], 0.0, weight[:, n : 2 * n]),
        gap=np.where(unbalanced, 0.0, gap),
        solved=unbalanced | ((status == 1) & (gap <= ROUNDING * (size + scaled))),
    )


def scratch(lines: int, count: int, device: str) -> Any:
    """What the linear programs of `lines` threads work in of `count` unknowns."""
    shapes: dict[str, tuple[tuple[int, ...], type]] = {
        "rows": ((lines, 6, count + 1), wp.float64),
        "order": ((lines, count), int),
        "null": ((lines, count, count + 1), wp.float64),
        "table": ((lines, 2 * count + 1, count + 2), wp.float64),
        "row_of": ((lines, 2 * count), int),
        "column_of": ((lines, count + 1), int),
        "weight": ((lines, 2 * count), wp.float64),
    }
    work = margin_kernels.Work()
    for name, (shape, kind) in shapes.items():
        setattr(work, name, wp.zeros(shape, dtype=kind, device=device))
    return work


def _limits(name: str, value: ArrayLike, n: int) -> Array:
    """One number or (n,) as (n,)."""
    array = as_floats(name, value)
    if array.shape not in ((), (n,)):
        raise InvalidField(name, f"shape {array.shape}", f"a number or shape ({n},)")
    limits: Array = batch(name, np.broadcast_to(array, (n,))[None], (n,))[0]
    return limits


def _launch(
    columns: Array, target: Array, lower: Array, upper: Array, device: str
) -> tuple[Array, Array, NDArray[np.int32], Array, Array]:
    """Run the batch kernel; margin, gap, status, tension and multipliers."""
    warp_setup.load(hold_kernels, device)
    size, n, _ = columns.shape
    work = scratch(size, n, device)
    tension = wp.zeros((size, n), dtype=wp.float64, device=device)
    margin, gap = (wp.zeros(size, dtype=wp.float64, device=device) for _ in range(2))
    status = wp.zeros(size, dtype=int, device=device)
    limits = (
        wp.array(np.broadcast_to(limit, (size, n)).copy(), dtype=wp.float64, device=device)
        for limit in (lower, upper)
    )
    inputs = [
        wp.array(columns, dtype=vec6d, device=device),
        wp.array(target, dtype=vec6d, device=device),
        *limits,
        work,
        tension,
        margin,
        gap,
        status,
    ]
    wp.launch(hold_kernels.margins, size, inputs=inputs, device=device)
    return margin.numpy(), gap.numpy(), status.numpy(), tension.numpy(), work.weight.numpy()
