"""Tensions of a point-like platform whose geometry is known in part."""

from __future__ import annotations

import numpy as np

from calibration.self_calibration.balance import force_balance, operating_tensions
from calibration.self_calibration.knowledge import Knowledge, problem_at, spare_directions
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.rest import tension_margin

GEOMETRY_DRAWS = 10  # robots drawn from what is known, all of which must be able to rest there


def safe_margin(known: Knowledge, position: Array, rng: np.random.Generator) -> Array:
    """Return the smallest margin to the tensions used on purpose, over likely robots [N], (C,).

    Args:
        known: Present knowledge.
        position: Platform origin in W [m], shape (C, 3).
        rng: Source of the likely robots.
    """
    exits, size = known.problem.exits, known.problem.exits.size
    drawn = rng.multivariate_normal(
        np.zeros(size), known.exit_covariance, size=GEOMETRY_DRAWS, method="eigh"
    )
    low, high = operating_tensions(known.problem.robot)
    margins = []
    for away in [np.zeros(size), *drawn]:
        shared = known.shared.copy()
        shared[exits] += away.reshape(exits.shape)
        matrix, weight = force_balance(known.problem, shared, position)
        margins.append(tension_margin.solve(matrix, weight, low, high, arm=1.0).margin)
    return np.asarray(np.min(margins, axis=0))


def tension_error(known: Knowledge, start: Array, position: Array) -> Array:
    """Return three standard deviations of the tensions after a move by lengths alone [N], (C,).

    The move begins where tensions are right. Wrong lengths that the platform can give way to
    change no tension; the others stretch the cables.

    Args:
        known: Present knowledge.
        start: Where the move begins [m], shape (3,).
        position: Where it ends [m], shape (C, 3).
    """
    robot = known.problem.robot
    places = np.vstack([start, position])
    linear = problem_at(known, places).linearize(known.shared, places)
    change = linear.by_shared[1:] - linear.by_shared[0]
    spare = spare_directions(linear.by_own[1:])
    straight, _ = known.problem.straight(known.shared, position)
    softness = (straight + robot.run_length) / robot.axial_stiffness
    soft = spare.swapaxes(1, 2) @ (softness[:, :, None] * spare)
    stretched = spare @ np.linalg.solve(soft, spare.swapaxes(1, 2) @ change)
    variance = np.einsum("cim,mk,cik->ci", stretched, known.covariance, stretched)
    return np.asarray(3.0 * np.sqrt(variance.max(axis=1)))
