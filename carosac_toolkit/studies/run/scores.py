"""Scores of one run: tracking and estimation errors, consistency of the covariance, latency."""

from __future__ import annotations

from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.consistency import POSE_SIZE, STATE_SIZE, normalised_square, state_error
from carosac_toolkit.loop.loop import Log
from carosac_toolkit.loop.values import Belief, Innovations, State
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.studies.run.limit_scores import limit_scores

UPPER_QUANTILE = 0.95
ESTIMATION_COLUMNS = (
    "orientation_rmse_rad", "estimation_p95_m", "orientation_p95_rad", "nees_pose", "nees",
    "nees_pose_p95", "covariance_faults", "nis", "nis_dof", "rejected_share",
)  # fmt: skip
CENTRE_SHARE = 0.5  # of each side of the workspace box: inside is the centre, outside the boundary


def score(log: Log, robot: Robot, duration: float, *, replayed: bool = False) -> dict[str, Any]:
    """Score one run.

    Args:
        log: Log of the run.
        robot: The nominal robot, for its workspace box and its limits.
        duration: Duration of the trajectory [s]; the platform should rest after it.
        replayed: True if the driver played a recording, on which no controller tracks anything.

    Returns:
        Difference of the lengths asked and sent; tracking error (truth minus reference) and
        estimation error (belief minus truth) as root mean squares per axis and in norm [m], and
        the scores of `estimation_scores` and `limit_scores`; None where unknown.
    """
    row: dict[str, Any] = {
        "latency_median_s": float(np.median(log.latency)),
        "latency_p95_s": float(np.quantile(log.latency, 0.95)),
        "latency_p99_s": float(np.quantile(log.latency, 0.99)),
        "command_rmse_m": _rms(log.asked - log.command),
        "limited": len({cycle for cycle, _ in log.limited}),
        "completed": log.completed,
        "steps": len(log.time),
    } | estimation_scores(log)
    row |= limit_scores(log, robot, replayed=replayed)
    if log.position is None:
        return row | _axis_errors("tracking", None) | _axis_errors("estimation", None)
    tracking = (
        _axis_errors("tracking", None)
        if replayed
        else _tracking(log, log.position, robot, duration)
    )
    return row | _axis_errors("estimation", log.belief_position - log.position) | tracking


def _tracking(log: Log, position: Array, robot: Robot, duration: float) -> dict[str, Any]:
    """Compare truth and reference."""
    error = position - log.reference
    distance = np.linalg.norm(error, axis=-1)
    middle = 0.5 * (robot.workspace_min + robot.workspace_max)
    half = 0.5 * CENTRE_SHARE * (robot.workspace_max - robot.workspace_min)
    central = (np.abs(log.reference - middle) <= half).all(axis=-1)
    rest = position[log.time > duration]
    swing = rest - rest.mean(axis=0, keepdims=True) if len(rest) else rest
    return _axis_errors("tracking", error) | {
        "tracking_max_m": float(distance.max()),
        "tracking_centre_m": _rms(distance[central]),
        "tracking_boundary_m": _rms(distance[~central]),
        "centre_steps": int(central.sum()),
        "residual_sway_m": _rms(np.linalg.norm(swing, axis=-1)),
    }


def _axis_errors(name: str, error: Array | None) -> dict[str, float | None]:
    """Return root mean squares per axis and in norm [m]."""
    keys = [f"{name}_rmse_{axis}_m" for axis in ("x", "y", "z", "norm")]
    if error is None:
        return dict.fromkeys(keys)
    per_axis = np.sqrt((error**2).mean(axis=(0, 1)))
    values = [*per_axis, np.sqrt((per_axis**2).sum())]
    return {key: float(value) for key, value in zip(keys, values, strict=True)}


def _rms(values: Array) -> float | None:
    """Return the root mean square, or None without values."""
    return float(np.sqrt((values**2).mean())) if values.size else None


def estimation_scores(log: Log) -> dict[str, Any]:
    """Score the beliefs of one run, all cycles of all worlds alike.

    Args:
        log: Log of the run.

    Returns:
        All of `ESTIMATION_COLUMNS`, None where it is not known:

        * root mean square of the angle between believed and true orientation [rad], and 95th
          percentiles of the error in position [m] and orientation [rad];
        * normalised estimation error squared over its degrees of freedom (1 is right), as mean
          over time: of the pose (6) and, where both have a twist, of all (12), and the 95th
          percentile of that of the pose; of cycles with a usable covariance only;
        * cycles whose covariance was not positive definite;
        * normalised innovation squared over its degrees of freedom, the mean degrees of freedom of
          a cycle with measurements, and the share of cycles in which any was rejected.
    """
    row: dict[str, Any] = dict.fromkeys(ESTIMATION_COLUMNS)
    if log.innovations is not None:
        row |= _innovation_scores(log.innovations)
    if log.position is None or log.rotation is None:
        return row
    error = _state_errors(log, log.position, log.rotation)
    distance, angle = (np.linalg.norm(error[:, k : k + 3], axis=1) for k in (0, 3))
    row |= {
        "orientation_rmse_rad": float(np.sqrt((angle**2).mean())),
        "estimation_p95_m": float(np.quantile(distance, UPPER_QUANTILE)),
        "orientation_p95_rad": float(np.quantile(angle, UPPER_QUANTILE)),
    }
    if log.belief_covariance is None:
        return row
    return row | _consistency(error, log.belief_covariance.reshape(-1, STATE_SIZE, STATE_SIZE))


def _state_errors(log: Log, position: Array, rotation: Array) -> Array:
    """Return the errors of all beliefs in the order of their covariance, (T B, 12), or (T B, 6)."""

    def flat(values: Array | None, *shape: int) -> Array | None:
        return None if values is None else values.reshape(-1, *shape)

    time = np.repeat(log.time, position.shape[1])
    truth = State(
        time=time, position=position.reshape(-1, 3), rotation=rotation.reshape(-1, 3, 3),
        twist=flat(log.twist, 6),
    )  # fmt: skip
    belief = Belief(
        time=time,
        position=log.belief_position.reshape(-1, 3),
        rotation=log.belief_rotation.reshape(-1, 3, 3),
        twist=flat(log.belief_twist, 6),
    )
    return state_error(truth, belief)


def _consistency(error: Array, covariance: Array) -> dict[str, Any]:
    """Return mean normalised squares of errors (S, 6 or 12) with covariances (S, 12, 12)."""
    row: dict[str, Any] = {}
    for name, size in (("nees_pose", POSE_SIZE), ("nees", STATE_SIZE)):
        if error.shape[1] < size:
            continue
        block = covariance[:, :size, :size]
        usable = np.linalg.eigvalsh(block)[:, 0] > 0.0
        row["covariance_faults"] = int((~usable).sum())
        if not usable.any():
            continue
        squares = normalised_square(error[usable, :size], block[usable])
        row[name] = float(squares.mean())
        if name == "nees_pose":
            row["nees_pose_p95"] = float(np.quantile(squares, UPPER_QUANTILE))
    return row


def _innovation_scores(innovations: Innovations) -> dict[str, Any]:
    """Return the mean normalised innovation squared, and the share rejected."""
    total, measured = float(innovations.dof.sum()), int((innovations.dof > 0.0).sum())
    return {
        "nis": float(innovations.squares.sum()) / total if total > 0.0 else None,
        "nis_dof": total / measured if measured else None,
        "rejected_share": float((innovations.rejected > 0.0).mean()),
    }
