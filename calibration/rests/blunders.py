"""Readings that do not fit the others: which to leave out, and what they are called."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibration.rests.fit import RestFit, fit
from calibration.rests.model import RestModel
from calibration.rests.result import SensorBlunder
from carosac_toolkit.base.arrays import Array

BLUNDER_SIGMAS = 4.5  # farther residuals are blunders
BLUNDER_OF_WORST = 0.5  # of the largest one: smaller ones may be its work, and wait
BLUNDER_ROUNDS_MAX = 8
BLUNDER_ROUNDS_MIN = 2  # after which the rest of the readings should fit
REDUNDANCY_MIN = 1e-4  # residuals with less show no blunder beside rounding
MISFIT_USELESS = 3.0  # times as large as their noise: the result is of no use
AS_GOOD_COST = 9.0  # squares that sum up to so much more fit as well


def without_blunders(
    model: RestModel, best: RestFit, weight: NDArray[np.bool_]
) -> tuple[RestFit, NDArray[np.bool_]]:
    """Leave blunders out, the worst ones of all rests, and fit again (data snooping).

    Of a rest, readings of which one as well as the other may be the blunder are all left out.
    """
    turning = model.columns.get("attitude", model.columns.get("inclination", np.zeros(0, int)))
    for round_ in range(BLUNDER_ROUNDS_MAX):
        if round_ >= BLUNDER_ROUNDS_MIN and misfit_of(best, weight) > MISFIT_USELESS:
            break  # these are no blunders
        deviation = np.where(weight, _deviation(best), 0.0)
        size = deviation.max(axis=1, keepdims=True)
        out = size > max(BLUNDER_SIGMAS, BLUNDER_OF_WORST * float(size.max()))
        out = out & (deviation**2 > size**2 - AS_GOOD_COST) & (deviation > BLUNDER_SIGMAS)
        if not out.any():
            break
        out[:, turning] = out[:, turning].any(axis=1, keepdims=True)
        weight = weight & ~out
        best = fit(model, (best.value, best.length, best.rest), weight)
    return best, weight


def misfit_of(best: RestFit, weight: NDArray[np.bool_]) -> float:
    """Return the size of the residuals over that which their noise lets expect."""
    return float(np.sqrt(best.cost / max(redundancy_of(best, weight), 1)))


def redundancy_of(best: RestFit, weight: NDArray[np.bool_]) -> int:
    """Return the number of readings beyond those that the unknowns take."""
    return int(weight.sum()) - best.length.size


def _deviation(best: RestFit) -> Array:
    """Return sizes of residuals in their own standard deviations, shape (K, m).

    They are nearer to the solution than their noise is large; 0 where they cannot tell.
    """
    rows = best.linear
    known = np.einsum("kmm->km", best.solution.joint_covariance(rows.by_own, rows.by_shared))
    tells = known < 1.0 - REDUNDANCY_MIN
    return np.where(tells, np.abs(rows.residual) / np.sqrt(np.where(tells, 1.0 - known, 1.0)), 0.0)


def sensor_blunders(
    model: RestModel, best: RestFit, weight: NDArray[np.bool_]
) -> tuple[SensorBlunder, ...]:
    """Return the readings that were left out, with their distance from the solution."""
    robot = model.unknowns.robot
    residual = model.residual(best.value, best.length, best.rest)
    found = []
    for name, columns in model.columns.items():
        cables = model.pulleys if name == "swivel_angle" else np.arange(robot.n)
        per_cable = name in ("length", "tension", "swivel_angle")
        for j, column in enumerate(columns):
            if not per_cable and j:
                continue  # an orientation is left out as a whole
            for rest in np.flatnonzero(~weight[:, column]):
                whole = residual[rest, [column] if per_cable else columns]
                found.append(
                    SensorBlunder(
                        rest=int(rest),
                        sensor=name,
                        cable=robot.cable_names[cables[j]] if per_cable else None,
                        sigmas=float(np.linalg.norm(whole)),
                    )
                )
    return tuple(found)
