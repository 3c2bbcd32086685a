"""The same estimate and covariance by a factor graph (gtsam), to compare with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.self_calibration.blunder_tests import SettledFit
from calibration.self_calibration.problem import POSITION_PRIOR_FACTOR, MotorAngleProblem
from carosac_toolkit.base.arrays import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class MapEstimate:
    """All unknowns with covariances.

    Attributes:
        shared: Shape (m,).
        covariance: Of the shared unknowns, shape (m, m).
        position: [m], shape (N, 3).
        position_covariance: [m^2], shape (N, 3, 3).
        iterations: That the optimiser took from the start it was given.
    """

    shared: Array
    covariance: Array
    position: Array
    position_covariance: Array
    iterations: int


def estimate(problem: MotorAngleProblem, settled: SettledFit) -> MapEstimate:
    """Optimise the graph of all believed data from where the robust fit ended.

    The graph has one vector of shared unknowns and one point for each sample. A sample that is
    not believed keeps its place in the graph, with a known position or its wide prior only.

    Args:
        problem: The samples.
        settled: Start, noise and which data count.
    """
    import gtsam
    from gtsam.symbol_shorthand import S, X

    graph = _graph(problem, settled)
    values = gtsam.Values()
    values.insert(S(0), (settled.fit.shared - problem.prior.mean) / problem.prior.sigma)
    for k, point in enumerate(settled.fit.position):
        values.insert(X(k), point)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setLinearSolverType("MULTIFRONTAL_QR")
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters)
    result = optimizer.optimize()
    marginals = gtsam.Marginals(graph, result)
    scale = problem.prior.sigma
    count = len(problem.angles.samples)
    return MapEstimate(
        shared=problem.prior.mean + scale * result.atVector(S(0)),
        covariance=marginals.marginalCovariance(S(0)) * np.outer(scale, scale),
        position=np.array([result.atPoint3(X(k)) for k in range(count)]),
        position_covariance=np.array([marginals.marginalCovariance(X(k)) for k in range(count)]),
        iterations=optimizer.iterations(),
    )


def _graph(problem: MotorAngleProblem, settled: SettledFit) -> Any:
    """Build the graph: priors, known positions, and one factor of lengths for each sample."""
    import gtsam
    from gtsam.symbol_shorthand import S, X

    graph = gtsam.NonlinearFactorGraph()
    scale, trust, angles = problem.prior.sigma, settled.trust, problem.angles
    prior = gtsam.noiseModel.Gaussian.Information(
        problem.prior.information * np.outer(scale, scale)
    )
    graph.addPriorVector(S(0), np.zeros(problem.size), prior)
    if problem.settings.distances:
        sigmas = np.array([distance.sigma for distance in problem.settings.distances])
        taped = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
        graph.add(gtsam.CustomFactor(taped, [S(0)], _distances(problem, scale)))
    wide = gtsam.noiseModel.Isotropic.Sigma(3, POSITION_PRIOR_FACTOR * problem.longest)
    noise = gtsam.noiseModel.Diagonal.Sigmas(trust.line_sigma / problem.advantage)
    for k in range(len(angles.samples)):
        graph.addPriorPoint3(X(k), problem.robot.home_position, wide)
        if trust.known[k]:
            axes, spread = problem.known_axes[k], POSITION_PRIOR_FACTOR * problem.longest
            tight = gtsam.noiseModel.Diagonal.Sigmas(np.where(axes, problem.known_sigma[k], spread))
            place = np.where(axes, problem.known_position[k], problem.robot.home_position)
            graph.addPriorPoint3(X(k), place, tight)
        if trust.lengths[k]:
            graph.add(gtsam.CustomFactor(noise, [S(0), X(k)], _lengths(problem, scale, k)))
    return graph


def _distances(
    problem: MotorAngleProblem, scale: Array
) -> Callable[[Any, Any, list[Array] | None], Array]:
    """Return the error function of the measured distances, with its Jacobian."""

    def error(factor: Any, values: Any, jacobians: list[Array] | None) -> Array:
        shared = problem.prior.mean + scale * values.atVector(factor.keys()[0])
        miss, slope = problem.distances(shared)
        if jacobians is not None:
            jacobians[0] = np.asfortranarray(slope * scale)
        return miss

    return error


def _lengths(
    problem: MotorAngleProblem, scale: Array, row: int
) -> Callable[[Any, Any, list[Array] | None], Array]:
    """Return the error function of one sample, with its Jacobians."""

    def error(factor: Any, values: Any, jacobians: list[Array] | None) -> Array:
        keys = factor.keys()
        shared = problem.prior.mean + scale * values.atVector(keys[0])
        position = np.asarray(values.atPoint3(keys[1]))
        linear = problem.linearize(shared, position[None], slice(row, row + 1))
        if jacobians is not None:
            jacobians[0] = np.asfortranarray(linear.by_shared[0] * scale)
            jacobians[1] = np.asfortranarray(linear.by_own[0])
        return np.asarray(linear.residual[0])

    return error
