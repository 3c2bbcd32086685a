r"""Fits in the presence of blunders: graduated non-convexity, then tests row by row.

Graduated non-convexity (Yang et al., RA-L 2020) fits a truncated least-squares cost through a
family of costs that starts convex: rows are weighted, all but equally at first, until each counts
fully or not at all. Tests then refine that choice: with the fit's Jacobian :math:`A` and whitened
residuals :math:`r`, the test value of a row is its residual over the residual's own standard
deviation,

.. math:: w_i = r_i / \sqrt{1 - a_i N^{-1} a_i^\top} \quad\text{(used)}, \qquad
          w_i = r_i / \sqrt{1 + a_i N^{-1} a_i^\top} \quad\text{(left out)}, \qquad N = A^\top A,

where A holds the rows in use. The bracket of a row in use is its redundancy, between 0 (nothing
checks it) and 1.

References:
    Yang, Antonante, Tzoumas, Carlone, *Graduated Non-Convexity for Robust Spatial Perception*,
    IEEE Robotics and Automation Letters, 2020. Baarda, *A Testing Procedure for Use in Geodetic
    Networks*, 1968.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.observability import Unobservable
from calibration.robust import truncated
from calibration.tachymeter.network import Network
from carosac_toolkit.base.arrays import Array

BLUNDER_SIGMAS = 4.0  # test value from which a row is left out: 1 in 16000 good rows is
READMISSION_SIGMAS = 3.0  # test value under which a row that was left out is used again
ALIKE_CORRELATION = (
    0.98  # correlation of two test values from which one blunder looks like the other
)
CHECKED_REDUNDANCY = 0.05  # redundancy under which a row counts as unchecked
_CONVEXITY_GROWTH = 1.4  # of the parameter of graduated non-convexity, per step
_CONVEXITY_STEPS_MAX = 100
_WEIGHT_MIN = 1e-12  # weight of a row that is left out, so that every system can be solved
_SINGULAR_EIGENVALUE_SHARE = (
    1e-14  # of the largest eigenvalue of a normal matrix scaled to a unit diagonal
)


@dataclass(frozen=True, kw_only=True, eq=False)
class SurveyFit:
    """A fit with the rows it uses; rows in the order of `network`.

    Attributes:
        values: ``gtsam.Values`` of the estimate.
        used: Rows in use, shape (m,).
        residual: Whitened residuals, model minus measured, shape (m,).
        test: Test value of each row [sigmas], shape (m,); 0 where a row has no check.
        redundancy: Share of a row that others check, shape (m,); 0 for a row left out.
        alike: For each row left out, the row that would explain the data as well, or -1, (m,).
        covariance: Of all unknowns in the order of `Network.columns`.
        chi2: Sum of squares of all residuals in use, priors included.
        freedom: Its degrees of freedom.
        converged: True if the tests came to rest.
    """

    values: Any
    used: NDArray[np.bool_]
    residual: Array
    test: Array
    redundancy: Array
    alike: NDArray[np.intp]
    covariance: Array
    chi2: float
    freedom: int
    converged: bool


def fit(network: Network, start: Any) -> SurveyFit:
    """Fit a survey and leave blunders out.

    Args:
        network: The survey.
        start: ``gtsam.Values`` to start from.

    Returns:
        The estimate without blunders.

    Raises:
        Unobservable: The survey does not determine all unknowns.
    """
    used, values = _graduated(network, start)
    used = _fewest(network, values, used)
    seen: set[bytes] = set()
    while True:
        values = _solve(network, values, used)
        trial = _tested(network, values, used)
        change = _worst(trial)
        if change is None:
            return _finished(trial, network, converged=True)
        used = used.copy()
        used[change] = ~used[change]
        if used.tobytes() in seen:
            return _finished(trial, network, converged=False)
        seen.add(used.tobytes())


def _graduated(network: Network, values: Any) -> tuple[NDArray[np.bool_], Any]:
    """Fit truncated least squares by graduated non-convexity; return rows in use and values."""
    weight = np.ones(len(network.sigma))
    square = BLUNDER_SIGMAS**2
    values = _optimize(network, values, weight, 20)
    residual = network.dense(values)[1][: len(weight)]
    most = float((residual**2).max())
    mu = square / (2.0 * most - square) if 2.0 * most > square else np.inf
    for _ in range(_CONVEXITY_STEPS_MAX if np.isfinite(mu) else 0):
        weight = np.maximum(truncated(residual, BLUNDER_SIGMAS, mu), _WEIGHT_MIN)
        values = _optimize(network, values, weight, 3)
        residual = network.dense(values)[1][: len(weight)]
        mu *= _CONVEXITY_GROWTH
        if ((weight <= _WEIGHT_MIN) | (weight >= 1.0)).all():
            break
    return weight > 0.5, values


def _fewest(network: Network, values: Any, used: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Explain each target's misfit by one or two readings where three or more were left out.

    Graduated non-convexity can end in a local minimum where a target has few shots: it then blames
    several good readings for one bad one.
    """
    jacobian, residual = network.dense(values)
    for target in network.survey.targets:
        rows = np.flatnonzero([name == target for name in _targets(network)])
        out = [int(row) for row in rows if not used[row]]
        if len(out) < 2:
            continue
        best, least = used, _truncated_cost(jacobian, residual, used)
        for count in range(1, min(len(out), 3)):
            for chosen in combinations(rows, count):
                trial = used.copy()
                trial[rows] = True
                trial[list(chosen)] = False
                cost = _truncated_cost(jacobian, residual, trial)
                if cost < least:
                    best, least = trial, cost
        used = best
    return used


def _targets(network: Network) -> list[str]:
    """Return the target of every weighted row."""
    names = [shot.target for shot in network.survey.shots]
    names += [reference.name for reference in network.survey.known]
    return [name for name in names for _ in range(3)]


def _truncated_cost(jacobian: Array, residual: Array, used: NDArray[np.bool_]) -> float:
    """Return the truncated least-squares cost of the linearised problem with some rows."""
    active = np.ones(len(residual), dtype=bool)
    active[: len(used)] = used
    rows, right = jacobian[active], residual[active]
    step = np.linalg.lstsq(rows, -right, rcond=None)[0]
    return float(((right + rows @ step) ** 2).sum() + BLUNDER_SIGMAS**2 * (~used).sum())


def _solve(network: Network, values: Any, used: NDArray[np.bool_]) -> Any:
    """Fit by least squares with some rows."""
    return _optimize(network, values, np.where(used, 1.0, _WEIGHT_MIN), 50)


def _optimize(network: Network, values: Any, weight: Array, iterations: int) -> Any:
    """Optimise by Levenberg-Marquardt."""
    import gtsam

    settings = gtsam.LevenbergMarquardtParams()
    settings.setMaxIterations(iterations)
    settings.setRelativeErrorTol(1e-12)
    settings.setAbsoluteErrorTol(1e-12)
    return gtsam.LevenbergMarquardtOptimizer(network.graph(weight), values, settings).optimize()


@dataclass(frozen=True, kw_only=True, eq=False)
class _TestedFit:
    """A fit with its tests."""

    values: Any
    used: NDArray[np.bool_]
    jacobian: Array
    residual: Array
    covariance: Array
    test: Array
    redundancy: Array


def _tested(network: Network, values: Any, used: NDArray[np.bool_]) -> _TestedFit:
    """Test every row against a fit; rows are taken back where too few are left."""
    jacobian, residual = network.dense(values)
    while True:
        active = np.concatenate([used, np.ones(network.prior_rows, dtype=bool)])
        covariance, free = _inverse(jacobian[active])
        if covariance is not None:
            break
        leverage = np.where(used, -1.0, np.abs(jacobian[: len(used)] @ free))
        if used.all() or leverage.max() <= 0.0:
            raise Unobservable(_loose_unknowns(network, free))
        used = used.copy()
        used[int(np.argmax(leverage))] = True
    hat = np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian)[: len(used)]
    redundancy = np.where(used, np.maximum(1.0 - hat, 0.0), 0.0)
    spread = np.sqrt(np.where(used, redundancy, 1.0 + hat))
    test = np.where(spread > 1e-4, residual[: len(used)] / np.maximum(spread, 1e-4), 0.0)
    return _TestedFit(
        values=values, used=used, jacobian=jacobian, residual=residual, covariance=covariance,
        test=test, redundancy=redundancy,
    )  # fmt: skip


def _inverse(jacobian: Array) -> tuple[Array | None, Array]:
    """Return the inverse of the normal matrix, or None and the free combination."""
    normal = jacobian.T @ jacobian
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    values, vectors = np.linalg.eigh(normal * np.outer(scale, scale))
    if values[0] <= _SINGULAR_EIGENVALUE_SHARE * values[-1] or not np.isfinite(scale).all():
        return None, scale * vectors[:, 0]
    inverse = (vectors / values) @ vectors.T
    return inverse * np.outer(scale, scale), np.zeros(len(scale))


def _worst(trial: _TestedFit) -> int | None:
    """Return the next row to leave out, or else to use again."""
    size = np.abs(trial.test)
    worst = int(np.argmax(np.where(trial.used, size, -1.0)))
    if trial.used[worst] and size[worst] > BLUNDER_SIGMAS:
        return worst
    best = int(np.argmin(np.where(trial.used, np.inf, size)))
    return best if not trial.used[best] and size[best] < READMISSION_SIGMAS else None


def _finished(trial: _TestedFit, network: Network, *, converged: bool) -> SurveyFit:
    """Return the final fit."""
    used = trial.used
    active = np.concatenate([used, np.ones(network.prior_rows, dtype=bool)])
    return SurveyFit(
        values=trial.values,
        used=used,
        residual=trial.residual[: len(used)],
        test=trial.test,
        redundancy=trial.redundancy,
        alike=_alike(trial, active),
        covariance=trial.covariance,
        chi2=float((trial.residual[active] ** 2).sum()),
        freedom=int(active.sum()) - network.size,
        converged=converged,
    )


def _alike(trial: _TestedFit, active: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the rows in use whose blunder would look like that of a row left out."""
    alike_rows = np.full(len(trial.used), -1)
    for i in np.flatnonzero(~trial.used):
        rows = np.append(np.flatnonzero(active), i)
        covariance, _ = _inverse(trial.jacobian[rows])
        if covariance is None:
            continue
        mine = trial.jacobian[i] @ covariance @ trial.jacobian[rows].T
        cofactor = -mine
        cofactor[-1] += 1.0
        own = 1.0 - np.einsum("ij,jk,ik->i", trial.jacobian[rows], covariance, trial.jacobian[rows])
        alike = np.abs(cofactor) / np.sqrt(np.maximum(own * own[-1], 1e-300))
        alike[(own < 1e-6) | (rows == i) | (rows >= len(trial.used))] = 0.0
        if alike.max() > ALIKE_CORRELATION:
            alike_rows[i] = rows[int(np.argmax(alike))]
    return alike_rows


def _loose_unknowns(network: Network, free: Array) -> str:
    """Name the unknowns that nothing determines."""
    share = {name: float(np.abs(free[where]).max()) for name, where in network.columns.items()}
    most = max(share.values())
    names = [name for name, size in share.items() if size > 0.1 * most][:6]
    return f"the survey does not determine {', '.join(names)}; sight more common points from there"
