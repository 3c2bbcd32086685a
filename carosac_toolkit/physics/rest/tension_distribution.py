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

from carosac_toolkit.base.arrays import Array, batch
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics import warp_setup
from carosac_toolkit.physics.cable.catenary_kernels import vec6d
from carosac_toolkit.physics.rest import bounded_kernels
from carosac_toolkit.physics.rest.tension_problem import check_order, per_cable, prepare


@dataclass(frozen=True, kw_only=True, eq=False)
class Distribution:
    """Tensions of B wrenches.

    Attributes:
        tension: [N], shape (B, n); within the limits always.
        feasible: True if they balance the wrench, shape (B,). If False, no tensions within the
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
    """Solve for least-squares tensions within limits, B problems at once.

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
    asked = prepare(structure_matrix, wrench, tension_min, tension_max, arm)
    limits = (asked.lower, asked.upper, per_cable("reference", reference, *asked.lower.shape))
    tension, status = _launch(asked.columns, -asked.wrench, limits, device)
    rest = np.einsum("bni,bn->bi", asked.columns, tension) + asked.wrench
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

        self._lower = per_cable("tension_min", tension_min, 1, n)[0]
        self._upper = per_cable("tension_max", tension_max, 1, n)[0]
        check_order(self._lower[None], self._upper[None])
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
        """Solve for the tensions of one wrench.

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
        self._problem.update(
            q=-per_cable("reference", reference, 1, self._n)[0],
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
