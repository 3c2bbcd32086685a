"""Cubic splines through points, from rest to rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.trajectories.curves import PiecewisePolynomial
from carosac_toolkit.trajectories.timing import check_points, segment_breaks, timed
from carosac_toolkit.trajectories.trajectory import Trajectory


def cubic_spline(
    points: ArrayLike,
    *,
    speed_max: float,
    acceleration_max: float,
    duration: float | None = None,
    segment_ratios: ArrayLike | None = None,
) -> Trajectory:
    """Pass the points on a cubic spline whose acceleration is continuous, the ends included.

    Zero velocity and acceleration at both ends take two more knots than a natural spline; they
    lie inside the first and the last segment. The jerk is piecewise constant.

    Args:
        points: In world frame W [m], shape (K, 3), K >= 2.
        speed_max: [m/s].
        acceleration_max: [m/s^2].
        duration: [s]; None: as fast as the limits allow.
        segment_ratios: Relative durations of the segments, shape (K - 1,); None: by distance.
    """
    array = check_points(points)
    passing = segment_breaks(array, segment_ratios, (speed_max, acceleration_max))
    return timed(
        cubic_from_rest_to_rest(array, passing),
        name="cubic_spline",
        speed_max=speed_max,
        acceleration_max=acceleration_max,
        duration=duration,
        points=array,
    )


def cubic_from_rest_to_rest(points: Array, passing: Array) -> PiecewisePolynomial:
    """Interpolate with zero velocity and acceleration at both ends.

    The unknowns are the accelerations at the knots, zero at the ends, linear in between. Velocity
    and position at a knot are integrals of them, hence linear in them.

    Args:
        points: [m], shape (K, 3).
        passing: Passing times from 0 [s], shape (K,).
    """
    knots = _with_extra_knots(passing)
    step = np.diff(knots)
    count = len(knots)
    speed = np.zeros((count, count))  # velocity at each knot per acceleration at each knot
    place = np.zeros((count, count))
    for i, h in enumerate(step):
        place[i + 1] = place[i] + h * speed[i]
        place[i + 1, i] += h * h / 3
        place[i + 1, i + 1] += h * h / 6
        speed[i + 1] = speed[i]
        speed[i + 1, i : i + 2] += h / 2
    passed = np.searchsorted(knots, passing[1:])  # exact: the knots contain the passing times
    conditions = np.concatenate([place[passed], speed[-1:]])[:, 1:-1]
    wanted = np.concatenate([points[1:] - points[0], np.zeros((1, 3))])
    acceleration = np.zeros((count, 3))
    acceleration[1:-1] = np.linalg.solve(conditions, wanted)
    position, velocity = points[0] + place @ acceleration, speed @ acceleration
    jerk = np.diff(acceleration, axis=0) / step[:, None]
    pieces = [position[:-1], velocity[:-1], acceleration[:-1] / 2, jerk / 6]
    return PiecewisePolynomial(breaks=knots, coefficients=np.stack(pieces, axis=1))


def _with_extra_knots(passing: Array) -> Array:
    """Add a knot in the middle of the first and of the last segment; thirds of a single one."""
    if len(passing) == 2:
        return np.linspace(0.0, passing[1], 4)
    first, last = passing[:2].mean(), passing[-2:].mean()
    return np.concatenate([passing[:1], [first], passing[1:-1], [last], passing[-1:]])
