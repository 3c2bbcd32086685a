"""The scale of a self-calibration: how well it is known, and from what."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.self_calibration.problem import MotorAngleProblem
from calibration.self_calibration.solver import Trust
from carosac_toolkit.base.arrays import Array

NAMED_SHARE_MIN = 0.1  # of the information on the scale: sources of less are not named


@dataclass(frozen=True, kw_only=True, eq=False)
class Scale:
    """Knowledge of the size of the whole set-up; angles alone tell nothing of it.

    Attributes:
        sigma: One standard deviation, as a share of the size.
        sources: What tells it, each with the standard deviation that it alone would leave, as a
            share, the best first.
    """

    sigma: float
    sources: dict[str, float]

    def sentence(self) -> str:
        """Return in words how well it is known, and from what."""
        information = {name: sigma**-2 for name, sigma in self.sources.items()}
        whole = sum(information.values())
        named = [name for name in information if information[name] > NAMED_SHARE_MIN * whole]
        return (
            f"the scale is known to {100.0 * self.sigma:.2g} %, from the {' and the '.join(named)}"
        )


def find_scale(problem: MotorAngleProblem, shared: Array, covariance: Array, trust: Trust) -> Scale:
    """Find how well the scale is known.

    Args:
        problem: The samples.
        shared: Values of the shared unknowns, shape (m,).
        covariance: Their covariance in the frame of the result, shape (m, m).
        trust: Which known positions count.
    """
    grow = np.zeros(problem.size)
    grow[problem.exits] = problem.points(shared) - problem.robot.home_position
    spread = float(np.sqrt(grow @ covariance @ grow)) / float(grow @ grow)
    sigma, settings = problem.prior.sigma, problem.settings
    known = problem.angles.coordinates_known & trust.known[:, None]
    weight = known / problem.known_sigma[:, :3] ** 2
    place = problem.known_position[:, :3]
    middle = (weight * place).sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-12)
    information = {
        "measured distances": sum((d.length / d.sigma) ** 2 for d in settings.distances),
        **{
            name: ((value / sigma[places]) ** 2).sum()
            for name, (places, value) in lengths_known(problem, shared).items()
        },
        "exit points of the robot file": grow @ problem.prior.information @ grow,
        "known positions": (weight * (place - middle) ** 2).sum(),
    }
    sources = {name: float(value) ** -0.5 for name, value in information.items() if value > 0.0}
    return Scale(sigma=spread, sources=dict(sorted(sources.items(), key=lambda item: item[1])))


def lengths_known(
    problem: MotorAngleProblem, shared: Array
) -> dict[str, tuple[NDArray[np.intp], Array]]:
    """Return the groups of shared unknowns that tell the scale: their places, and lengths [m].

    Args:
        problem: The samples.
        shared: Values of the shared unknowns, shape (m,).
    """
    places, first = np.unique(problem.radii, return_index=True)
    return {
        "lengths at home": (problem.zeros, shared[problem.zeros]),
        "drums": (places, (problem.radius + shared[problem.radii])[first]),
    }
