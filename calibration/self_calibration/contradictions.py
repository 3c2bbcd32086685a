"""Sources of the scale that contradict each other: each is predicted from everything else."""

from __future__ import annotations

import numpy as np

from calibration.self_calibration.blunder_tests import SettledFit, cautious
from calibration.self_calibration.frame import Frame
from calibration.self_calibration.problem import MotorAngleProblem
from calibration.self_calibration.scale import Scale, lengths_known
from calibration.self_calibration.solver import equations, fit
from carosac_toolkit.base.arrays import Array

SIGMAS_MAX = 3.0  # standard deviations between a source and its prediction: more is no chance


def contradictions(
    problem: MotorAngleProblem, settled: SettledFit, frame: Frame, scale: Scale
) -> tuple[str, ...]:
    """Name measured distances, lengths at home and drums that everything else contradicts.

    One source that is much sharper than the others pulls them along, each by little. Left out, it
    is predicted by them.

    Args:
        problem: The samples.
        settled: The fit.
        frame: Its frame.
        scale: What tells it.
    """
    lines = _wrong_distances(problem, settled, frame, scale)
    return tuple(lines or _wrong_group(problem, settled, frame, scale))


def _wrong_distances(
    problem: MotorAngleProblem, settled: SettledFit, frame: Frame, scale: Scale
) -> list[str]:
    """Name the measured distances that everything else contradicts."""
    lines = []
    for k, distance in enumerate(problem.settings.distances):
        shared, covariance = _predicted(problem.without(distance=k), settled, frame)
        miss, slope = problem.distances(shared)
        sigma = float(np.sqrt(slope[k] @ covariance @ slope[k]))
        apart = abs(float(miss[k])) / float(np.hypot(sigma, distance.sigma))
        if apart > SIGMAS_MAX:
            others = len(problem.settings.distances) > 1
            rest = "everything else" if others else _best_but("measured distances", scale)
            lines.append(
                f"the distance {distance} is {distance.length:.4g} m as measured, but "
                f"{distance.length + miss[k]:.4g} m (sigma {sigma:.2g} m) by {rest}, {apart:.1f} "
                "standard deviations off: is it between these points, and right?"
            )
    return lines


def _wrong_group(
    problem: MotorAngleProblem, settled: SettledFit, frame: Frame, scale: Scale
) -> list[str]:
    """Name the first group of lengths known before that is of another scale than the rest."""
    prior = problem.prior
    for name, (places, known) in lengths_known(problem, prior.mean).items():
        shared, covariance = _predicted(problem.without(places=places), settled, frame)
        # The scale that fits the group best, by the group's own sigmas.
        weight = known / prior.sigma[places] ** 2
        weight /= weight @ known
        grown = float(weight @ (shared - prior.mean)[places])
        spread = covariance[np.ix_(places, places)] + np.diag(prior.sigma[places] ** 2)
        apart = abs(grown) / float(np.sqrt(weight @ spread @ weight))
        if apart > SIGMAS_MAX:
            size = "smaller" if grown > 0.0 else "larger"
            return [
                f"the set-up is {100.0 * abs(grown):.2g} % {size} by the {name} than by "
                f"{_best_but(name, scale)}, {apart:.1f} standard deviations off: which is right?"
            ]
    return []


def _best_but(name: str, scale: Scale) -> str:
    """Name the best other source of the scale."""
    return next((f"the {other}" for other in scale.sources if other != name), "everything else")


def _predicted(
    problem: MotorAngleProblem, settled: SettledFit, frame: Frame
) -> tuple[Array, Array]:
    """Fit with the data that were trusted; return the shared unknowns and their covariance."""
    trust = cautious(problem, settled)
    other = fit(problem, settled.fit.shared, settled.fit.position, trust)
    system = equations(problem, other.shared, other.position, trust)
    return other.shared, frame.covariance(system.information)
