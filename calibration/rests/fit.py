"""Least squares over shared parameters and the true lengths of each rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.linear_samples import LinearSamples
from calibration.normal_equations import SharedSolution, solve
from calibration.rests.model import RestModel
from calibration.rests.start import RestStart, heading
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics.cable.lengths import length_at_tension
from carosac_toolkit.physics.rest import statics

ROUNDS_MAX = 100
LENGTH_MIN_SHARE = 1e-3  # a search keeps lengths positive
COST_SETTLED = 3e-3  # a step that changes the sum of squares by less is the last one
DAMPING_SETTLED_MAX = 10.0  # with more damping steps are short anywhere
DAMPING_START, DAMPING_MIN, DAMPING_MAX = 1e-3, 1e-9, 1e12


@dataclass(frozen=True, kw_only=True, eq=False)
class RestFit:
    """Solution of a fit.

    Attributes:
        value: Of the shared parameters, shape (k,).
        length: True unstrained lengths at each rest [m], shape (K, n).
        rest: Equilibria on them.
        linear: Residuals there, those left out weighted by 0.
        solution: Covariances there.
        cost: Sum of all squared residuals in standard deviations, prior included.
        rounds: Of the search.
        converged: True if the last step was within `COST_SETTLED`.
    """

    value: Array
    length: Array
    rest: statics.Equilibrium
    linear: LinearSamples
    solution: SharedSolution
    cost: float
    rounds: int
    converged: bool


def first_lengths(model: RestModel, start: RestStart) -> tuple[Array, Array, statics.Equilibrium]:
    """Return parameters, true lengths and equilibria with which the search begins."""
    unknowns = model.unknowns
    robot, value = unknowns.robot, unknowns.prior.mean.copy()
    value[unknowns.prior.rows("length_offset")] = start.offset
    pose = Pose(position=start.position, rotation=start.rotation)
    if model.readings.attitude is not None:
        turned = heading(start.rotation, model.readings.attitude)
        value[unknowns.prior.rows("heading")] = turned
    pull = model.readings.tension
    if pull is None:
        held = robot.n >= 6
        pull = statics.inverse_kinematics(
            robot, start.position, start.rotation if held else None, guess=pose
        ).tension
    length = length_at_tension(robot, start.position, start.rotation, pull).unstrained_length
    scale = 1.0 if robot.length_scale is None else robot.length_scale
    read = (model.readings.length - start.offset) / scale
    length = np.where(np.isfinite(length) & (robot.n >= 6), length, read)
    length = np.maximum(length, LENGTH_MIN_SHARE * np.abs(length).max())
    return value, length, model.equilibria(value, length, pose)


def fit(
    model: RestModel, start: tuple[Array, Array, statics.Equilibrium], weight: NDArray[np.bool_]
) -> RestFit:
    """Search the least squares from a start (Levenberg-Marquardt).

    Args:
        model: Of K rests.
        start: Parameters, true lengths and equilibria.
        weight: False for residuals that are left out, shape (K, m).
    """
    value, length, rest = start
    prior = model.unknowns.prior
    cost = _cost(model, value, length, rest, weight)
    damping, rounds, converged = DAMPING_START, 0, False
    linear, fresh = _weighted(model.linear(value, length, rest), weight), False
    while rounds < ROUNDS_MAX and damping < DAMPING_MAX:
        rounds += 1
        pull = prior.information @ (prior.mean - value)
        step = solve(linear, prior.information, pull, damping=damping)
        new_value = value + step.shared
        new_length = np.maximum(length + step.own, LENGTH_MIN_SHARE * length)
        found = model.equilibria(new_value, new_length, rest)
        new_cost = _cost(model, new_value, new_length, found, weight)
        small = abs(cost - new_cost) < COST_SETTLED and damping < DAMPING_SETTLED_MAX
        converged = bool(found.converged.all()) and small
        if found.converged.all() and new_cost <= cost * (1.0 + 1e-9):
            value, length, rest, cost = new_value, new_length, found, new_cost
            linear, fresh = _weighted(model.linear(value, length, rest), weight), False
            damping = max(0.3 * damping, DAMPING_MIN)
        elif fresh:
            damping *= 4.0
        else:
            linear, fresh = _weighted(model.linear(value, length, rest, fresh=True), weight), True
        if converged:
            break
    pull = prior.information @ (prior.mean - value)
    return RestFit(
        value=value, length=length, rest=rest, linear=linear,
        solution=solve(linear, prior.information, pull), cost=cost, rounds=rounds,
        converged=converged,
    )  # fmt: skip


def _cost(
    model: RestModel, value: Array, length: Array, rest: statics.Equilibrium,
    weight: NDArray[np.bool_],
) -> float:  # fmt: skip
    """Return the sum of all squares, prior included."""
    off = value - model.unknowns.prior.mean
    residual = np.where(weight, model.residual(value, length, rest), 0.0)
    return float((residual**2).sum() + off @ model.unknowns.prior.information @ off)


def _weighted(linear: LinearSamples, weight: NDArray[np.bool_]) -> LinearSamples:
    """Return rows with zeros where they are left out."""
    kept = weight[..., None]
    return LinearSamples(
        residual=np.where(weight, linear.residual, 0.0),
        by_shared=np.where(kept, linear.by_shared, 0.0),
        by_own=np.where(kept, linear.by_own, 0.0),
    )
