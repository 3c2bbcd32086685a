"""Timing of curves: limits, durations and passing times."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from carosac_toolkit.base.arrays import Array, batch, frozen_array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.trajectories.curves import Curve
from carosac_toolkit.trajectories.trajectory import Trajectory, peak_of_order

LIMIT_MARGIN = 1e-9  # relative, by which limits are kept: the accuracy of the peaks


def timed(
    curve: Curve,
    *,
    name: str,
    speed_max: float,
    acceleration_max: float,
    duration: float | None,
    points: Array | None = None,
) -> Trajectory:
    """Stretch a curve uniformly until the limits hold: as fast as they allow, or as asked.

    With nominal time stretched by k, speeds fall by k and accelerations by k^2.

    Raises:
        InvalidField: A limit that is not positive, or a duration that would break one.
    """
    check_limits(speed_max, acceleration_max)
    stretch = max(
        peak_of_order(curve, 1) / speed_max, np.sqrt(peak_of_order(curve, 2) / acceleration_max)
    )
    fastest = float(curve.breaks[-1] * stretch * (1.0 + LIMIT_MARGIN))
    if duration is not None:
        check_duration(duration, fastest, speed_max, acceleration_max)
    return Trajectory(name=name, curve=curve, duration=duration or fastest, points=points)


def check_limits(speed_max: float, acceleration_max: float) -> None:
    """Refuse limits that are not positive and finite."""
    limits = (("speed_max", speed_max, "m/s"), ("acceleration_max", acceleration_max, "m/s^2"))
    for field, value, unit in limits:
        if not 0.0 < value < np.inf:
            raise InvalidField(field, f"{value} {unit}", f"a finite {field} > 0")


def check_duration(
    duration: float, fastest: float, speed_max: float, acceleration_max: float
) -> None:
    """Refuse a duration that is shorter than the limits allow."""
    if not fastest * (1.0 - 10 * LIMIT_MARGIN) <= duration < np.inf:
        allowed = f">= {fastest:.6g} s with {speed_max:g} m/s and {acceleration_max:g} m/s^2"
        raise InvalidField("duration", f"{duration} s", allowed)


def check_points(points: ArrayLike) -> Array:
    """Return at least two points, shape (K, 3), of which no two neighbours coincide."""
    array = batch("points", points, (3,))
    if len(array) < 2:
        raise InvalidField("points", f"{len(array)} point", "at least 2 points")
    same = np.linalg.norm(np.diff(array, axis=0), axis=1) < 1e-9
    if same.any():
        index = int(np.argmax(same)) + 1
        raise InvalidField(f"points[{index}]", "the same point as before", "another point")
    return array


def segment_times(points: Array, *, speed_max: float, acceleration_max: float) -> Array:
    """Share the time out among the segments between points.

    Each gets what a straight move under the limits takes, ``distance / speed_max`` and what
    speeding up costs; the first and last, which start or end at rest, half as much again.

    Returns:
        [s], shape (K - 1,); only the ratios matter, since `timed` stretches the result.
    """
    distance = np.linalg.norm(np.diff(points, axis=0), axis=1)
    times = distance / speed_max + np.sqrt(distance / acceleration_max)
    times[0] *= 1.5
    times[-1] *= 1.5
    return np.asarray(times)


def segment_breaks(points: Array, ratios: ArrayLike | None, limits: tuple[float, float]) -> Array:
    """Return the nominal times at which a curve passes its points [s], shape (K,).

    Args:
        points: In W [m], shape (K, 3).
        ratios: Relative durations of the segments, shape (K - 1,), or None to share by distance.
        limits: Speed [m/s] and acceleration [m/s^2].
    """
    check_limits(*limits)
    if ratios is None:
        times = segment_times(points, speed_max=limits[0], acceleration_max=limits[1])
    else:
        times = frozen_array("segment_ratios", ratios, (len(points) - 1,))
        if (times <= 0.0).any():
            index = int(np.argmax(times <= 0.0))
            raise InvalidField(f"segment_ratios[{index}]", times[index], "> 0")
    return np.concatenate([[0.0], np.cumsum(times)])
