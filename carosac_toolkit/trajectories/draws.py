"""Random trajectories inside a robot's workspace box."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.trajectories.snap import minimum_snap
from carosac_toolkit.trajectories.splines import cubic_spline
from carosac_toolkit.trajectories.trajectory import Trajectory, bounds

SHRINK_ATTEMPTS = 100
SHRINK_FACTOR = 0.999


def random_minimum_snap(
    robot: Robot,
    rng: np.random.Generator,
    *,
    speed_max: float,
    acceleration_max: float,
    count: int = 6,
    distance_min: float | None = None,
) -> Trajectory:
    """Draw points in the workspace box and pass them with the least snap.

    See `draw_points` for the points. Where the curve between them leaves the box, its points are
    drawn towards the middle of the box, axis by axis, until it does not.

    Args:
        robot: Whose box it is.
        rng: Source of randomness.
        speed_max: [m/s].
        acceleration_max: [m/s^2].
        count: Number of points, >= 2.
        distance_min: Of neighbouring points [m]; None: a quarter of the shortest edge of the box.
    """
    make = partial(minimum_snap, speed_max=speed_max, acceleration_max=acceleration_max)
    return _fitted(make, draw_points(robot, rng, count=count, distance_min=distance_min), robot)


def random_spline(
    robot: Robot,
    rng: np.random.Generator,
    *,
    speed_max: float,
    acceleration_max: float,
    count: int = 6,
    distance_min: float | None = None,
) -> Trajectory:
    """Draw points in the workspace box and pass them on a cubic spline.

    Arguments and treatment of the box as in `random_minimum_snap`.
    """
    make = partial(cubic_spline, speed_max=speed_max, acceleration_max=acceleration_max)
    return _fitted(make, draw_points(robot, rng, count=count, distance_min=distance_min), robot)


def draw_points(
    robot: Robot, rng: np.random.Generator, *, count: int, distance_min: float | None = None
) -> Array:
    """Draw points uniformly in the workspace box, each at least `distance_min` from the last.

    Returns:
        In world frame W [m], shape (count, 3).
    """
    low, high = robot.workspace_min, robot.workspace_max
    edge = float((high - low).min())
    apart = edge / 4 if distance_min is None else distance_min
    if count < 2:
        raise InvalidField("count", count, "at least 2 points")
    if not 0.0 < apart <= edge / 2:  # such a point exists, wherever the last one lies
        raise InvalidField("distance_min", f"{apart} m", f"0 < distance_min <= {edge / 2:g} m")
    points = [rng.uniform(low, high)]
    while len(points) < count:
        candidate = rng.uniform(low, high)
        if np.linalg.norm(candidate - points[-1]) >= apart:
            points.append(candidate)
    return np.array(points)


def _fitted(make: Callable[[Array], Trajectory], points: Array, robot: Robot) -> Trajectory:
    """Draw the points towards the middle of the box until the curve lies inside it."""
    middle = (robot.workspace_min + robot.workspace_max) / 2
    half = (robot.workspace_max - robot.workspace_min) / 2
    for _ in range(SHRINK_ATTEMPTS):
        trajectory = make(points)
        lower, upper = bounds(trajectory.curve)
        reach = np.array(
            [max(m - a[0], b[0] - m) for m, a, b in zip(middle, lower, upper, strict=True)]
        )
        if (reach <= half).all():
            return trajectory
        factor = np.where(reach > half, SHRINK_FACTOR * half / reach, 1.0)
        points = middle + factor * (points - middle)
    raise InvalidField(
        "workspace", f"a curve outside after {SHRINK_ATTEMPTS} attempts", "a larger box"
    )
