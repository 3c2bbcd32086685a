r"""The quadratic program of one Gauss-Newton step, in the stage structure that HPIPM exploits.

.. math:: \min \sum_k \tfrac12 \delta_k^\top H_k \delta_k + g_k^\top \delta_k + p\,\sigma_k
                 + \tfrac12 p\,\sigma_k^2, \qquad
          \delta x_{k+1} = A_k \delta x_k + B_k \delta u_k + c_k, \qquad
          l_k - \sigma_k \le C_k \delta_k \le h_k + \sigma_k, \qquad \sigma_k \ge 0

with hard bounds on the inputs. The slack of a stage is one more input.

References:
    Frison, Diehl, *HPIPM: a high-performance quadratic programming framework for model predictive
    control*, IFAC 2020.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from carosac_toolkit.base.arrays import Array

NO_LIMIT = 1e4  # stands for no limit on a scaled row
DYNAMICS_GAP_MAX = 1e-5  # of the dynamics in a solution: more is none
HPIPM_OPTIONS = {
    "iter_max": 50, "mode": "balance",
    "res_g_max": 1e-4, "res_b_max": 1e-7, "res_d_max": 1e-6, "res_m_max": 1e-5,
}  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class GaussNewtonStep:
    """Solution of the program.

    Attributes:
        solved: Whether it is one.
        state: Change of the states, shape (N + 1, nx).
        tension: Change of the inputs, shape (N, n).
        slack: By which share soft limits are exceeded, shape (N,).
    """

    solved: bool
    state: Array
    tension: Array
    slack: Array


class QuadraticProgram:
    """A program of fixed size; N stages, nx states, n inputs, rows with soft limits."""

    def __init__(self, stages: int, states: int, n: int, rows: int) -> None:
        """Set up the solver."""
        import casadi as ca

        self._sizes = stages, states, n, rows
        self._width = states + n + 1
        a_map, self._a_order = _constraint_pattern(stages, states, n, rows)
        h_map = _cost_pattern(stages, states, n)
        options: dict[str, Any] = {
            "error_on_fail": False, "print_time": False, "N": stages,
            "nx": [states] * (stages + 1), "nu": [n + 1] * stages + [0],
            "ng": [2 * rows] * stages + [0], "hpipm": HPIPM_OPTIONS,
        }  # fmt: skip
        self._solver: Any = ca.conic("step", "hpipm", {"h": _sparsity(ca, h_map),
                                                  "a": _sparsity(ca, a_map)}, options)  # fmt: skip
        self._buffers()

    def solve(
        self, *, hessian: Array, gradient: Array, end: Array, dynamics: tuple[Array, Array, Array],
        bounds: tuple[Array, Array], rows: tuple[Array, Array, Array], price: float, start: Array,
    ) -> GaussNewtonStep:  # fmt: skip
        """Solve.

        Args:
            hessian: Diagonal over [x; u], shape (N, nx + n).
            gradient: Over [x; u], shape (N, nx + n).
            end: Diagonal of the Hessian, then gradient of the last state, shape (2, nx).
            dynamics: A (N, nx, nx), B (N, nx, n) and c (N, nx).
            bounds: Of the changes of the inputs, each (N, n).
            rows: C (N, rows, nx + n), and lower and upper limits (N, rows), all scaled.
            price: Of slack.
            start: Change of the first state, which is given, shape (nx,).
        """
        stages, states, n, _ = self._sizes
        self._fill_cost(hessian, gradient, end, price)
        self._fill_constraints(dynamics, rows)
        low, high = (
            self._in[k][: stages * self._width].reshape(stages, -1) for k in ("lbx", "ubx")
        )
        low[:, states : states + n], high[:, states : states + n] = bounds
        low[0, :states] = high[0, :states] = start
        for i, array in enumerate(self._results):
            self._buffer.set_res(i, array.data)  # a call forgets where its results go
        try:
            self._evaluate()
        except RuntimeError:  # the solver refuses numbers that are not finite
            return GaussNewtonStep(solved=False, state=np.zeros((stages + 1, states)),
                        tension=np.zeros((stages, n)), slack=np.zeros(stages))  # fmt: skip
        return self._read(dynamics)

    def _read(self, dynamics: tuple[Array, Array, Array]) -> GaussNewtonStep:
        """Take the solution and look whether it is one."""
        stages, states, n, _ = self._sizes
        a, b, c = dynamics
        body = self._out[: stages * self._width].reshape(stages, self._width)
        x = np.vstack([body[:, :states], self._out[-states:]])
        u, slack = body[:, states : states + n].copy(), body[:, -1].copy()
        solved = bool(np.isfinite(self._out).all()) and bool(self._buffer.stats()["success"])
        if solved:
            follow = np.einsum("kij,kj->ki", a, x[:-1]) + np.einsum("kij,kj->ki", b, u) + c
            solved = bool(np.abs(follow - x[1:]).max() < DYNAMICS_GAP_MAX)
        return GaussNewtonStep(solved=solved, state=x, tension=u, slack=slack)

    def _fill_cost(self, hessian: Array, gradient: Array, end: Array, price: float) -> None:
        """Fill Hessian and gradient, with those of the slack."""
        stages, states, n, _ = self._sizes
        for name, values, last in (("h", hessian, end[0]), ("g", gradient, end[1])):
            block = self._in[name][: stages * self._width].reshape(stages, self._width)
            block[:, : states + n] = values
            block[:, -1] = price
            self._in[name][stages * self._width :] = last

    def _fill_constraints(
        self, dynamics: tuple[Array, Array, Array], rows: tuple[Array, Array, Array]
    ) -> None:
        """Fill in the dynamics, then the soft rows, stage by stage."""
        stages, states, _, count = self._sizes
        a, b, c = dynamics
        matrix, low, high = rows
        one = np.ones((stages, count, 1))
        blocks = (
            np.concatenate([a, b], axis=2), np.full((stages, states), -1.0),
            np.concatenate([matrix, -one], axis=2), np.concatenate([matrix, one], axis=2),
        )  # fmt: skip
        values = np.concatenate([block.reshape(stages, -1) for block in blocks], axis=1).ravel()
        self._in["a"][:] = values[self._a_order]
        lower, upper = (self._in[k].reshape(stages, -1) for k in ("lba", "uba"))
        lower[:, :states] = upper[:, :states] = -c
        lower[:, states : states + count] = -NO_LIMIT
        upper[:, states : states + count] = np.clip(high, -NO_LIMIT, NO_LIMIT)
        lower[:, states + count :] = np.clip(low, -NO_LIMIT, NO_LIMIT)
        upper[:, states + count :] = NO_LIMIT

    def _buffers(self) -> None:
        """Give the solver arrays for all that goes in and comes out."""
        stages = self._sizes[0]
        solver = self._solver
        self._buffer, self._evaluate = solver.buffer()
        self._in = {name: np.zeros(max(1, solver.nnz_in(i)))
                    for i, name in enumerate(solver.name_in())}  # fmt: skip
        self._results = [np.zeros(max(1, solver.nnz_out(i))) for i in range(solver.n_out())]
        for i, array in enumerate(self._in.values()):
            self._buffer.set_arg(i, array.data)
        self._out = self._results[solver.index_out("x")]
        self._in["lbx"][:] = -np.inf
        self._in["ubx"][:] = np.inf
        slack = np.arange(stages) * self._width + self._width - 1
        self._in["lbx"][slack] = 0.0


def _constraint_pattern(
    stages: int, states: int, n: int, rows: int
) -> tuple[Any, np.ndarray[Any, np.dtype[np.int64]]]:
    """Return where `_fill_constraints` puts its values, and the solver's order of them."""
    width, height = states + n + 1, states + 2 * rows
    inner = [
        *((i, j) for i in range(states) for j in range(states + n)),
        *((i, width + i) for i in range(states)),
        *((states + i, j) for i in range(2 * rows) for j in range(width)),
    ]
    row, column = np.array(inner).T
    shift = np.arange(stages)[:, None]
    all_rows, all_columns = (row + shift * height).ravel(), (column + shift * width).ravel()
    order = np.lexsort((all_rows, all_columns))  # by columns
    shape = (stages * height, stages * width + states)
    matrix = sparse.coo_matrix((np.ones(len(order)), (all_rows[order], all_columns[order])), shape)
    return matrix, order


def _cost_pattern(stages: int, states: int, n: int) -> Any:
    """Return the pattern of a diagonal Hessian."""
    size = stages * (states + n + 1) + states
    return sparse.coo_matrix((np.ones(size), (np.arange(size), np.arange(size))), (size, size))


def _sparsity(ca: Any, matrix: Any) -> Any:
    """Convert a pattern to CasADi's sparsity."""
    rows, columns = matrix.row.tolist(), matrix.col.tolist()
    return ca.Sparsity.triplet(*matrix.shape, rows, columns)
