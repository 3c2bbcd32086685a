r"""Largest margin to their limits of tensions that balance a wrench.

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

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics import warp_setup
from carosac_toolkit.physics.cable.catenary_kernels import vec6d
from carosac_toolkit.physics.rest import hold_kernels, margin_kernels
from carosac_toolkit.physics.rest.tension_problem import TensionProblem, prepare

PROOF_GAP_MAX = 1e-9  # of the largest limit: how well a margin must be proved
CHUNK_PROBLEMS = 16384  # problems at a time: what bounds the memory; rows do not know of each other


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
    arm: float | None = None,
    device: str = "cpu",
) -> TensionMargin:
    """Solve for the largest margins of tensions to their limits, B problems at once.

    Args:
        structure_matrix: A, maps tensions to the wrench on the platform, shape (B, 6, n).
        wrench: External wrench w at the platform origin, in W [N, N m], shape (B, 6).
        tension_min: Lower limits [N], a number, shape (n,) or (B, n).
        tension_max: Upper limits [N], likewise.
        arm: Lever arm that makes moments comparable with forces [m]; None: the largest of a
            cable at that pose.
        device: Warp device.

    Returns:
        Margins, each with its proof.

    Raises:
        InvalidField: Wrong shapes, or a lower limit above its upper one.
    """
    asked = prepare(structure_matrix, wrench, tension_min, tension_max, arm)
    count, n, _ = asked.columns.shape
    parts = [
        _launch(asked, slice(k, k + CHUNK_PROBLEMS), device)
        for k in range(0, count, CHUNK_PROBLEMS)
    ]
    margin, gap, status, tension, weight = (np.concatenate(x) for x in zip(*parts, strict=True))
    size = np.abs(asked.upper).max(axis=1)
    scaled = np.where(np.isfinite(margin), np.abs(margin), 0.0)
    unbalanced = status == 2
    return TensionMargin(
        margin=np.where(unbalanced, -np.inf, margin),
        tension=tension,
        low=np.where(unbalanced[:, None], 0.0, weight[:, :n]),
        high=np.where(unbalanced[:, None], 0.0, weight[:, n : 2 * n]),
        gap=np.where(unbalanced, 0.0, gap),
        solved=unbalanced | ((status == 1) & (gap <= PROOF_GAP_MAX * (size + scaled))),
    )


def scratch(lines: int, count: int, device: str) -> Any:
    """Allocate the work arrays of `lines` linear programs of `count` unknowns."""
    shapes: dict[str, tuple[tuple[int, ...], type]] = {
        "rows": ((lines, 6, count + 1), wp.float64),
        "order": ((lines, count), int),
        "null": ((lines, count, count + 1), wp.float64),
        "table": ((lines, 2 * count + 1, count + 2), wp.float64),
        "row_of": ((lines, 2 * count), int),
        "column_of": ((lines, count + 1), int),
        "weight": ((lines, 2 * count), wp.float64),
    }
    work = margin_kernels.MarginWork()
    for name, (shape, kind) in shapes.items():
        setattr(work, name, wp.zeros(shape, dtype=kind, device=device))
    return work


def _launch(
    asked: TensionProblem, part: slice, device: str
) -> tuple[Array, Array, NDArray[np.int32], Array, Array]:
    """Run the batch kernel; margin, gap, status, tension and multipliers."""
    warp_setup.load(hold_kernels, device)
    columns = asked.columns[part]
    size, n, _ = columns.shape
    work = scratch(size, n, device)
    tension = wp.zeros((size, n), dtype=wp.float64, device=device)
    margin, gap = (wp.zeros(size, dtype=wp.float64, device=device) for _ in range(2))
    status = wp.zeros(size, dtype=int, device=device)
    limits = (
        wp.array(limit[part], dtype=wp.float64, device=device)
        for limit in (asked.lower, asked.upper)
    )
    inputs = [
        wp.array(columns, dtype=vec6d, device=device),
        wp.array(-asked.wrench[part], dtype=vec6d, device=device),
        *limits,
        work,
        tension,
        margin,
        gap,
        status,
    ]
    wp.launch(hold_kernels.margins, size, inputs=inputs, device=device)
    return margin.numpy(), gap.numpy(), status.numpy(), tension.numpy(), work.weight.numpy()
