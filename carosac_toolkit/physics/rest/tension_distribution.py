r"""Tensions within limits that balance a wrench: a choice where there are more than six cables.

.. math:: \min_f \sum_i \phi_i(f_i) \quad \text{subject to} \quad A f + w = 0,
    \quad f_{min} \le f \le f_{max}

With the typical tension :math:`s = (\|w\| + \sum_i f_{min,i}) / n`, moments over the lever arm:

* ``least_squares``: :math:`\phi = (f - f_{ref})^2 / 2`, with reference 0 by default.
* ``minimum``: :math:`\phi = (f - f_{min} + 20 s)^2 / 2`: the smallest sum of tensions, but for the
  quadratic term, whose slope is a twentieth of the sum's at tensions of :math:`s`. The sum alone is
  a linear program, whose answer jumps from one corner to another.
* ``p_norm``: :math:`\phi = x^4 / 4 + x^2 / 200` with :math:`x = f / s`: nearly the smallest 4-norm,
  a smooth stand-in for the smallest largest tension.
* ``centre``: :math:`\phi = -\log(1 - x^2) / 2` with x from -1 to 1 between the limits: the
  analytic centre, far from all limits. Beyond :math:`|x| = 0.99` a parabola of the same slope and
  curvature continues it, so that tensions at a limit have a finite cost.

All are strongly convex, so there is one answer. It is continuous along a path wherever some
tensions strictly inside the limits balance the wrench and A has rank 6 (Berge's maximum theorem);
at the edge of the feasible region nothing is claimed.

`solve` is the batch version (Warp, any n, six dual unknowns); `TensionDistributor` keeps one osqp
problem warm for a control loop.

References:
    Pott, *Cable-Driven Parallel Robots*, Springer, 2018, section 3.7.
    Verhoeven, *Analysis of the Workspace of Tendon-Based Stewart Platforms*, 2004.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from carosac_toolkit.base.arrays import Array, batch
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.extras import require
from carosac_toolkit.physics import warp_setup
from carosac_toolkit.physics.cable.catenary_kernels import vec6d
from carosac_toolkit.physics.rest import distribution_kernels
from carosac_toolkit.physics.rest.tension_problem import (
    DISTRIBUTIONS,
    DistributionName,
    TensionProblem,
    check_distribution,
    check_order,
    levers,
    per_cable,
    prepare,
)

MINIMUM_DEPTH, P_NORM_QUADRATIC, BARRIER_END = 20.0, 0.01, 0.99  # as in `distribution_kernels`
SOLVES_MAX = 30  # QPs of one distribution of a loop
SEARCH_CHANGE = 1e-5  # of a cable's scale: smaller steps are taken in full
LOOP_CHANGE = 1e-7  # of a cable's scale: smaller steps end the sequence of QPs


@dataclass(frozen=True, kw_only=True, eq=False)
class Distribution:
    """Tensions of B wrenches.

    Attributes:
        tension: [N], shape (B, n); within the limits always.
        feasible: True if they balance the wrench, shape (B,). If False, no tensions within the
            limits do, and `tension` is the last attempt.
        residual: Norm of A f + w, moments divided by the lever arm [N], shape (B,).
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
    distribution: DistributionName = "least_squares",
    reference: ArrayLike = 0.0,
    arm: float | None = None,
    device: str = "cpu",
) -> Distribution:
    """Solve for tensions within limits, B problems at once.

    Args:
        structure_matrix: A, maps tensions to the wrench on the platform, shape (B, 6, n).
        wrench: External wrench w at the platform origin, in W [N, N m], shape (B, 6).
        tension_min: Lower limits [N], shape (n,) or (B, n).
        tension_max: Upper limits [N], shape (n,) or (B, n).
        distribution: Which tensions to choose, see the module.
        reference: Tensions to stay close to [N]; 0, a number, (n,) or (B, n). For least squares
            alone.
        arm: Lever arm that makes moments comparable with forces [m]; None: the largest of a cable
            in each problem.
        device: Warp device.

    Returns:
        Tensions with a status; nothing is clipped without `feasible` saying so.

    Raises:
        InvalidField: Wrong shapes, a lower limit above its upper one, an unknown distribution, or
            a reference for another one than least squares.
    """
    check_distribution(distribution)
    _check_reference(distribution, reference)
    asked = prepare(structure_matrix, wrench, tension_min, tension_max, arm)
    nearest = per_cable("reference", reference, *asked.lower.shape)
    tension, status = _launch(asked, nearest, DISTRIBUTIONS.index(distribution), device)
    rest = np.einsum("bni,bn->bi", asked.columns, tension) + asked.wrench
    return Distribution(
        tension=tension, feasible=status == 1, residual=np.linalg.norm(rest, axis=1)
    )


def _check_reference(distribution: str, reference: ArrayLike) -> None:
    """Refuse a reference that a distribution would ignore."""
    if distribution != "least_squares" and np.any(reference):
        raise InvalidField("reference", reference, f"0: '{distribution}' has its own")


def _launch(
    asked: TensionProblem, reference: Array, choice: int, device: str
) -> tuple[Array, NDArray[np.int32]]:
    """Run the batch kernel."""
    warp_setup.load(distribution_kernels, device)
    size, n, _ = asked.columns.shape

    def floats(values: Array | None = None) -> wp.array:
        if values is None:
            return wp.zeros((size, n), dtype=wp.float64, device=device)
        return wp.array(values, dtype=wp.float64, device=device)

    cost = distribution_kernels.Cost()
    cost.choice, cost.reference = choice, floats(reference)
    cost.scale, cost.middle, cost.softness, cost.iterate = (floats() for _ in range(4))
    tension, status = floats(), wp.zeros(size, dtype=int, device=device)
    inputs = [
        wp.array(asked.columns, dtype=vec6d, device=device),
        wp.array(-asked.wrench, dtype=vec6d, device=device),
        floats(asked.lower), floats(asked.upper), cost, tension, status,
    ]  # fmt: skip
    wp.launch(distribution_kernels.distribute, size, inputs=inputs, device=device)
    return tension.numpy(), status.numpy()


class TensionDistributor:
    """The same problem for one robot in a loop, by osqp, warm-started from call to call.

    Set up once; a call updates matrices and bounds. An infeasible wrench is answered by `feasible`
    False, with the lower limits for tensions: use the last good ones or stop.
    """

    def __init__(
        self,
        n: int,
        tension_min: ArrayLike,
        tension_max: ArrayLike,
        *,
        distribution: DistributionName = "least_squares",
        arm: float | None = None,
    ) -> None:
        """Set the problem up.

        Args:
            n: Number of cables.
            tension_min: Lower limits [N], shape (n,) or a number.
            tension_max: Upper limits [N], shape (n,) or a number.
            distribution: Which tensions to choose, see the module.
            arm: Lever arm that makes moments comparable with forces [m]; None: the largest of a
                cable at each call.
        """
        require("TensionDistributor", "osqp")
        check_distribution(distribution)
        self._lower = per_cable("tension_min", tension_min, 1, n)[0]
        self._upper = per_cable("tension_max", tension_max, 1, n)[0]
        check_order(self._lower[None], self._upper[None])
        self._n, self._distribution, self._arm = n, distribution, arm
        self._quadratic = distribution in ("least_squares", "minimum")
        self._last: Array | None = None
        self._dense = np.zeros((6 + n, n))
        self._dense[6:] = np.eye(n)
        self._mask = np.vstack([np.ones((6, n), bool), np.eye(n, dtype=bool)])
        self._problem = self._set_up()

    def _set_up(self) -> Any:
        """Set osqp up, for tensions in units of the typical one."""
        import osqp
        from scipy import sparse

        problem = osqp.OSQP()
        problem.setup(
            sparse.csc_matrix(np.eye(self._n)),
            np.zeros(self._n),
            sparse.csc_matrix(self._mask.astype(float)),
            np.concatenate([np.zeros(6), self._lower]),
            np.concatenate([np.zeros(6), self._upper]),
            verbose=False,
            eps_abs=1e-9,
            eps_rel=1e-9,
            max_iter=20000,
            polishing=True,
        )
        return problem

    def solve(
        self, structure_matrix: ArrayLike, wrench: ArrayLike, *, reference: ArrayLike = 0.0
    ) -> Distribution:
        """Solve for the tensions of one wrench.

        Args:
            structure_matrix: Shape (1, 6, n).
            wrench: External wrench [N, N m], shape (1, 6).
            reference: Tensions to stay close to [N], a number or shape (n,); for least squares.
        """
        matrix = batch("structure_matrix", structure_matrix, (6, self._n))
        load = batch("wrench", wrench, (6,))
        if len(matrix) != 1 or len(load) != 1:
            raise InvalidField("structure_matrix and wrench", "several problems", "a batch of one")
        _check_reference(self._distribution, reference)
        scale = np.ones(6)
        scale[3:] /= levers(matrix)[0] if self._arm is None else self._arm
        self._dense[:6] = matrix[0] * scale[:, None]
        target = -load[0] * scale
        typical = float(np.linalg.norm(target) + self._lower.sum()) / self._n or 1.0
        nearest = per_cable("reference", reference, 1, self._n)[0]
        tension = self._sequence(target / typical, self._cost(nearest, typical), typical)
        feasible = tension is not None
        self._last = tension
        if tension is None:
            tension = self._lower.copy()
        rest = np.linalg.norm(self._dense[:6] @ tension - target)
        return Distribution(
            tension=tension[None], feasible=np.array([feasible]), residual=np.array([rest])
        )

    def _cost(self, nearest: Array, typical: float) -> tuple[Array, Array]:
        """Return references and scales of the cost, in units of the typical tension."""
        lower, upper = self._lower / typical, self._upper / typical
        if self._distribution == "minimum":
            return lower - MINIMUM_DEPTH, np.ones(self._n)
        if self._distribution == "centre":
            half = 0.5 * (upper - lower)
            return lower + half, np.where(half > 0.0, half, 1.0)
        return nearest / typical, np.ones(self._n)

    def _phi(self, x: Array) -> tuple[Array, Array, Array]:
        """Return the cost of each cable with its first and second derivatives."""
        if self._distribution == "p_norm":
            q = P_NORM_QUADRATIC
            return (0.5 * q + 0.25 * x**2) * x**2, (q + x**2) * x, q + 3.0 * x**2
        if self._distribution == "centre":
            size = np.minimum(np.abs(x), BARRIER_END)
            left, beyond = 1.0 - size**2, np.abs(x) - size
            slope, bend = size / left, (1.0 + size**2) / left**2
            value = -0.5 * np.log(left) + (slope + 0.5 * bend * beyond) * beyond
            return value, np.sign(x) * (slope + bend * beyond), bend
        return 0.5 * x**2, x, np.ones_like(x)

    def _sequence(self, target: Array, cost: tuple[Array, Array], typical: float) -> Array | None:
        """Solve least-squares problems until the cost is least; None if none is feasible."""
        middle, scale = cost
        start = middle if self._last is None or self._quadratic else self._last / typical
        here, balanced = start, False
        for _ in range(SOLVES_MAX):
            _, slope, bend = self._phi((here - middle) / scale)
            slope, bend = slope / scale, bend / scale**2
            there = self._least_squares(target, bend, bend * here - slope, typical)
            if there is None or self._quadratic:
                return None if there is None else there * typical
            change = float((np.abs(there - here) / scale).max())
            if balanced and change > SEARCH_CHANGE:
                there = here + self._share(here, there, slope, cost) * (there - here)
            here, last, balanced = there, here, True
            if change <= LOOP_CHANGE:
                return np.asarray(here * typical)
        return np.asarray(here * typical) if np.allclose(here, last, atol=1e-5) else None

    def _least_squares(
        self, target: Array, bend: Array, slope: Array, typical: float
    ) -> Array | None:
        """Minimise f^T diag(bend) f / 2 - slope^T f; None if there is no balance within limits."""
        size = float(bend.max())
        bound = self._lower / typical, self._upper / typical
        self._problem.update(
            Px=bend / size,
            q=-slope / size,
            Ax=self._dense.T[self._mask.T],
            l=np.concatenate([target, bound[0]]),
            u=np.concatenate([target, bound[1]]),
        )
        result = self._problem.solve(raise_error=False)
        if result.info.status_val != 1:
            return None
        tension: Array = np.clip(result.x, *bound)  # by osqp's tolerance
        return tension

    def _share(self, here: Array, there: Array, slope: Array, cost: tuple[Array, Array]) -> float:
        """Return the share of a step that lowers the cost enough (Armijo)."""

        def total(share: float) -> float:
            x = (here + share * (there - here) - cost[0]) / cost[1]
            return float(self._phi(x)[0].sum())

        share, falls = 1.0, float(slope @ (there - here))
        while total(share) > total(0.0) + 1e-4 * share * falls and share > 1e-6:
            share *= 0.5
        return share


SingleRobot = TensionDistributor  # its name up to version 0.1
