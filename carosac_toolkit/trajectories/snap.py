"""Minimum-snap trajectories through points."""

from __future__ import annotations

from math import factorial

import numpy as np
from numpy.typing import ArrayLike

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.trajectories.curves import PiecewisePolynomial
from carosac_toolkit.trajectories.timing import check_points, segment_breaks, timed
from carosac_toolkit.trajectories.trajectory import Trajectory


def minimum_snap(
    points: ArrayLike,
    *,
    speed_max: float,
    acceleration_max: float,
    duration: float | None = None,
    segment_ratios: ArrayLike | None = None,
) -> Trajectory:
    r"""Pass the points with the least snap, from rest to rest.

    Minimises :math:`\int |p^{(4)}|^2 dt` over septic polynomials that pass the points at given
    times and start and end with zero velocity, acceleration and jerk; the minimiser is
    continuous up to the sixth derivative. Limits are met by stretching time uniformly.

    Args:
        points: In world frame W [m], shape (K, 3), K >= 2.
        speed_max: [m/s].
        acceleration_max: [m/s^2].
        duration: [s]; None: as fast as the limits allow.
        segment_ratios: Relative durations of the segments, shape (K - 1,); None: by distance.

    References:
        Mellinger and Kumar, "Minimum snap trajectory generation and control for quadrotors",
        ICRA 2011; Richter, Bry and Roy, "Polynomial trajectory planning for aggressive quadrotor
        flight in dense indoor environments", ISRR 2013 (elimination of the constraints).
    """
    array = check_points(points)
    breaks = segment_breaks(array, segment_ratios, (speed_max, acceleration_max))
    breaks *= (len(breaks) - 1) / breaks[-1]  # mean segment of 1 s: well scaled
    return timed(
        septic_of_least_snap(array, breaks),
        name="minimum_snap",
        speed_max=speed_max,
        acceleration_max=acceleration_max,
        duration=duration,
        points=array,
    )


def septic_of_least_snap(points: Array, breaks: Array) -> PiecewisePolynomial:
    """Solve the equality-constrained quadratic programme for given passing times.

    The unknowns are velocity, acceleration and jerk at the inner points; passing, continuity up
    to jerk and the rests at the ends are built in, so what is left has no constraints.

    Args:
        points: [m], shape (K, 3).
        breaks: Passing times from 0 [s], shape (K,).
    """
    count = len(points)
    hessian = np.zeros((4 * count, 4 * count))
    maps = [hermite_map(duration) for duration in np.diff(breaks)]
    for i, (to_coefficients, duration) in enumerate(zip(maps, np.diff(breaks), strict=True)):
        block = slice(4 * i, 4 * i + 8)
        hessian[block, block] += to_coefficients.T @ snap_cost(duration) @ to_coefficients
    values = np.zeros((4 * count, 3))  # position, velocity, acceleration, jerk per point
    values[::4] = points
    free = np.array([4 * i + k for i in range(1, count - 1) for k in (1, 2, 3)], dtype=np.intp)
    if len(free):
        known = hessian[np.ix_(free, np.arange(0, 4 * count, 4))] @ points
        values[free] = np.linalg.solve(hessian[np.ix_(free, free)], -known)
    coefficients = np.array([m @ values[4 * i : 4 * i + 8] for i, m in enumerate(maps)])
    return PiecewisePolynomial(breaks=breaks, coefficients=coefficients)


def hermite_map(duration: float) -> Array:
    """Return the matrix (8, 8) from end values to the coefficients of a septic polynomial.

    Args:
        duration: [s].

    Returns:
        From position, velocity, acceleration and jerk at the start, then at the end, to the
        coefficients of ascending powers of the time since the start.
    """
    conditions = np.zeros((8, 8))  # for a duration of 1
    for order in range(4):
        conditions[order, order] = factorial(order)
        for power in range(order, 8):
            conditions[4 + order, power] = factorial(power) // factorial(power - order)
    powers = float(duration) ** np.arange(8)
    return np.asarray(np.linalg.inv(conditions) * np.tile(powers[:4], 2) / powers[:, None])


def snap_cost(duration: float) -> Array:
    """Return the matrix Q (8, 8) with c^T Q c the integral of the squared fourth derivative."""
    cost = np.zeros((8, 8))
    for i in range(4, 8):
        for j in range(4, 8):
            factor = factorial(i) // factorial(i - 4) * (factorial(j) // factorial(j - 4))
            cost[i, j] = factor * duration ** (i + j - 7) / (i + j - 7)
    return cost
