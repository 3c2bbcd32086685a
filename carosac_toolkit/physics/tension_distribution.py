r"""Tensions within limits that balance a wrench.

.. math:: \min_f \tfrac12 \|f - f_{ref}\|^2 \quad \text{subject to} \quad A f + w = 0,
    \quad f_{min} \le f \le f_{max}

`solve` is the batch version (Warp, any n, six dual unknowns); `SingleRobot` keeps one osqp problem
warm for a control loop.

References:
    Pott, *Cable-Driven Parallel Robots*, Springer, 2018, section 3.7.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from carosac_toolkit.arrays import Array, as_floats, batch
from carosac_toolkit.errors import InvalidField
from carosac_toolkit.physics import bounded_kernels, warp_setup
from carosac_toolkit.physics.cable_kernels import vec6d


@dataclass(frozen=True, kw_only=True, eq=False)
class Distribution:
    """Tensions of B wrenches.

    Attributes:
        tension: [N], shape (B, n); within the limits always.
        feasible: Whether they balance the wrench, shape (B,). Where False, no tensions within the
            limits do, and `tension` is the last attempt.
        residual: Norm of A f + w, moments divided by `arm` [N], shape (B,).
    """

    tension: Array
    feasible: NDArray[np.bool_]
    residual: Array


def solve(
    structure_matrix: ArrayLike,
    wrench: ArrayLike,
    tension_min: ArrayLike,
    tension_max: ArrayLike,
    *,
    reference: ArrayLike = 0.0,
    arm: float = 1.0,
    device: str = "cpu",
) -> Distribution:
    """Least-squares tensions within limits, B problems at once.

    Args:
        structure_matrix: A, maps tensions to the wrench on the platform, shape (B, 6, n).
        wrench: External wrench w at the platform origin, in W [N, N m], shape (B, 6).
        tension_min: Lower limits [N], shape (n,) or (B, n).
        tension_max: Upper limits [N], shape (n,) or (B, n).
        reference: Tensions to stay close to [N]; 0, a number, (n,) or (B, n).
        arm: Lever arm that makes moments comparable with forces [m].
        device: Warp device.

    Returns:
        Tensions with a status; nothing is clipped without `feasible` saying so.

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
    if not arm > 0.0 or not np.isfinite(arm):
        raise InvalidField("arm", f"{arm} m", "arm > 0")
    lower, upper, middle = (
        _limits(name, value, size, n)
        for name, value in (
            ("tension_min", tension_min),
            ("tension_max", tension_max),
            ("reference", reference),
        )
    )
    _check_order(lower, upper)
    scale = np.array([1.0, 1.0, 1.0, 1.0 / arm, 1.0 / arm, 1.0 / arm])
    columns = np.ascontiguousarray((matrix * scale[:, None]).swapaxes(1, 2))
    tension, status = _launch(columns, -load * scale, (lower, upper, middle), device)
    rest = np.einsum("bni,bn->bi", columns, tension) + load * scale
    return Distribution(
        tension=tension, feasible=status == 1, residual=np.linalg.norm(rest, axis=1)
    )


def _launch(
    columns: Array, target: Array, limits: tuple[Array, ...], device: str
) -> tuple[Array, NDArray[np.int32]]:
    """Run the batch kernel."""
    warp_setup.load(bounded_kernels, device)
    size, n, _ = columns.shape
    tension = wp.zeros((size, n), dtype=wp.float64, device=device)
    status = wp.zeros(size, dtype=int, device=device)
    inputs = [
        wp.array(columns, dtype=vec6d, device=device),
        wp.array(target, dtype=vec6d, device=device),
        *(wp.array(limit, dtype=wp.float64, device=device) for limit in limits),
        tension,
        status,
    ]
    wp.launch(bounded_kernels.distribute, size, inputs=inputs, device=device)
    return tension.numpy(), status.numpy()


def _limits(name: str, value: ArrayLike, size: int, n: int) -> Array:
    """One number, (n,) or (B, n) as (B, n)."""
    array = as_floats(name, value)
    if array.shape not in ((), (n,), (size, n)):
        raise InvalidField(name, f"shape {array.shape}", f"a number, shape ({n},) or ({size}, {n})")
    return batch(name, np.broadcast_to(array, (size, n)), (n,))


def _check_order(lower: Array, upper: Array) -> None:
    """Refuse crossed limits."""
    bad = lower > upper
    if bad.any():
        b, i = (int(k) for k in np.argwhere(bad)[0])
        raise InvalidField(f"tension_min[{i}]", f"{lower[b, i]} N", f"<= {upper[b, i]} N")


class SingleRobot:
    """The same problem for one robot in a loop, by osqp, warm-started from call to call.

    An infeasible wrench is answered by `feasible` False and the tensions of the smallest wrench
    error are *not* computed: use the last good ones or stop.
    """

    def __init__(self, n: int, tension_min: ArrayLike, tension_max: ArrayLike) -> None:
        """Set the problem up.

        Args:
            n: Number of cables.
            tension_min: Lower limits [N], shape (n,) or a number.
            tension_max: Upper limits [N], shape (n,) or a number.
        """
        import osqp
        from scipy import sparse

        self._lower = _limits("tension_min", tension_min, 1, n)[0]
        self._upper = _limits("tension_max", tension_max, 1, n)[0]
        _check_order(self._lower[None], self._upper[None])
        self._n = n
        stacked = sparse.csc_matrix(np.vstack([np.ones((6, n)), np.eye(n)]))
        self._dense = np.zeros((6 + n, n))
        self._dense[6:] = np.eye(n)
        self._mask = np.vstack([np.ones((6, n), bool), np.eye(n, dtype=bool)])
        self._problem = osqp.OSQP()
        self._problem.setup(
            sparse.csc_matrix(np.eye(n)),
            np.zeros(n),
            stacked,
            np.concatenate([np.zeros(6), self._lower]),
            np.concatenate([np.zeros(6), self._upper]),
            verbose=False,
            eps_abs=1e-9,
            eps_rel=1e-9,
            max_iter=20000,
            polishing=True,
        )

    def solve(
        self, structure_matrix: ArrayLike, wrench: ArrayLike, *, reference: ArrayLike = 0.0
    ) -> Distribution:
        """Tensions for one wrench.

        Args:
            structure_matrix: Shape (1, 6, n).
            wrench: External wrench [N, N m], shape (1, 6).
            reference: Tensions to stay close to [N], a number or shape (n,).
        """
        matrix = batch("structure_matrix", structure_matrix, (6, self._n))
        load = batch("wrench", wrench, (6,))
        if len(matrix) != 1 or len(load) != 1:
            raise InvalidField("structure_matrix and wrench", "several problems", "a batch of one")
        self._dense[:6] = matrix[0]
        middle = _limits("reference", reference, 1, self._n)[0]
        self._problem.update(
            q=-middle,
            Ax=self._dense.T[self._mask.T],
            l=np.concatenate([-load[0], self._lower]),
            u=np.concatenate([-load[0], self._upper]),
        )
        result = self._problem.solve(raise_error=False)
        solved = result.info.status_val == 1
        tension = np.clip(result.x, self._lower, self._upper) if solved else self._lower.copy()
        rest = np.linalg.norm(matrix[0] @ tension + load[0])
        return Distribution(
            tension=tension[None], feasible=np.array([solved]), residual=np.array([rest])
        )
