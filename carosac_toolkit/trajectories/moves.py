"""Straight moves from point to point, with rests in between."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from carosac_toolkit.base.arrays import Array, frozen_array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.trajectories.curves import PiecewisePolynomial
from carosac_toolkit.trajectories.timing import (
    LIMIT_MARGIN,
    check_duration,
    check_limits,
    check_points,
)
from carosac_toolkit.trajectories.trajectory import Trajectory

# s(x) = 35 x^4 - 84 x^5 + 70 x^6 - 20 x^7: from 0 to 1 with three zero derivatives at both ends
SEPTIC_COEFFICIENTS = np.array([0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0])
SEPTIC_SPEED_MAX = 35 / 16  # highest s', at 1/2
SEPTIC_ACCELERATION_MAX = 84 / (5 * np.sqrt(5))  # highest s'', at 1/2 - 1/sqrt(20)


def waypoints(
    points: ArrayLike,
    *,
    speed_max: float,
    acceleration_max: float,
    rest: float = 1.0,
    duration: float | None = None,
) -> Trajectory:
    """Move straight from point to point and rest at each point in between.

    Each move is a septic polynomial of its own duration, smooth up to its jerk, so that each
    reaches one of the limits; the rests keep their length if a longer `duration` is asked for.

    Args:
        points: In world frame W [m], shape (K, 3), K >= 2.
        speed_max: [m/s].
        acceleration_max: [m/s^2].
        rest: At each inner point [s], >= 0.
        duration: Of it all [s]; None: as fast as the limits allow.
    """
    array = check_points(points)
    check_limits(speed_max, acceleration_max)
    if not 0.0 <= rest < np.inf:
        raise InvalidField("rest", f"{rest} s", "a finite rest >= 0")
    distance = np.linalg.norm(np.diff(array, axis=0), axis=1)
    moving = np.maximum(
        SEPTIC_SPEED_MAX * distance / speed_max,
        np.sqrt(SEPTIC_ACCELERATION_MAX * distance / acceleration_max),
    ) * (1.0 + LIMIT_MARGIN)
    resting = rest * (len(array) - 2)
    if duration is not None:
        check_duration(duration, moving.sum() + resting, speed_max, acceleration_max)
        moving = moving * (duration - resting) / moving.sum()
    curve = _moves_and_rests(array, moving, rest)
    return Trajectory(name="waypoints", curve=curve, duration=float(curve.breaks[-1]), points=array)


def line(
    start: ArrayLike,
    end: ArrayLike,
    *,
    speed_max: float,
    acceleration_max: float,
    duration: float | None = None,
) -> Trajectory:
    """Move straight from start to end, both in world frame W [m], shape (3,)."""
    trajectory = waypoints(
        np.stack([frozen_array("start", start, (3,)), frozen_array("end", end, (3,))]),
        speed_max=speed_max,
        acceleration_max=acceleration_max,
        duration=duration,
    )
    return replace(trajectory, name="line")


def _moves_and_rests(points: Array, moving: Array, rest: float) -> PiecewisePolynomial:
    """Chain moves of given durations [s], shape (K - 1,), and equal rests [s]."""
    durations, coefficients = [], []
    for i, duration in enumerate(moving):
        scaled = SEPTIC_COEFFICIENTS / duration ** np.arange(8)
        move = scaled[:, None] * (points[i + 1] - points[i])
        move[0] = points[i]
        durations.append(duration)
        coefficients.append(move)
        if rest > 0.0 and i < len(moving) - 1:
            durations.append(rest)
            coefficients.append(np.concatenate([points[i + 1][None], np.zeros((7, 3))]))
    breaks = np.concatenate([[0.0], np.cumsum(durations)])
    return PiecewisePolynomial(breaks=breaks, coefficients=np.array(coefficients))
