"""One trajectory of every kind."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from carosac_toolkit import trajectories
from carosac_toolkit.trajectories import Trajectory
from tests.robots import simple_robot

POINTS = np.array([[0.0, 0, 2], [1.0, 0.5, 2.5], [1.2, -0.7, 3.0], [-0.4, -0.1, 2.2]])

FACTORIES: dict[str, Callable[..., Trajectory]] = {
    "minimum_snap": lambda **k: trajectories.minimum_snap(POINTS, **k),
    "minimum_snap_of_two": lambda **k: trajectories.minimum_snap(POINTS[:2], **k),
    "cubic_spline": lambda **k: trajectories.cubic_spline(POINTS, **k),
    "cubic_spline_of_two": lambda **k: trajectories.cubic_spline(POINTS[:2], **k),
    "waypoints": lambda **k: trajectories.waypoints(POINTS, rest=0.7, **k),
    "waypoints_without_rest": lambda **k: trajectories.waypoints(POINTS, rest=0.0, **k),
    "line": lambda **k: trajectories.line(POINTS[0], POINTS[1], **k),
    "circle": lambda **k: trajectories.circle([0, 0, 3], 0.8, normal=(0.2, -0.3, 1.0), **k),
    "short_arc": lambda **k: trajectories.circle([0, 0, 3], 0.8, turns=-0.1, **k),
    "many_turns": lambda **k: trajectories.circle([0, 0, 3], 0.8, turns=7.3, **k),
    "spiral": lambda **k: trajectories.spiral([0, 0, 2], 1.0, 0.2, 1.5, start_angle=0.4, **k),
    "spiral_from_its_axis": lambda **k: trajectories.spiral([0, 0, 2], 0.0, 1.0, -0.5, **k),
    "random_minimum_snap": lambda **k: trajectories.random_minimum_snap(
        simple_robot(), np.random.default_rng(3), **k
    ),
    "random_spline": lambda **k: trajectories.random_spline(
        simple_robot(), np.random.default_rng(3), **k
    ),
}
FIXED = [name for name in FACTORIES if not name.startswith("random")]
ONE_SPEED = 1.0  # [m/s]
ONE_ACCELERATION = 1.0  # [m/s^2]


def make(name: str, **changes: float) -> Trajectory:
    """Build one of `FACTORIES` under limits of 1 m/s and 1 m/s^2, or others."""
    limits = {"speed_max": ONE_SPEED, "acceleration_max": ONE_ACCELERATION}
    return FACTORIES[name](**(limits | changes))
