"""Sizes and lines of the static scene: frame, workspace box, platform, camera."""

from __future__ import annotations

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot

PLATFORM_FLATNESS_MIN = 0.22  # of its largest side: a flatter platform is drawn this high
PLATFORM_SIZE_MIN = 0.02  # of the frame: a smaller platform is drawn this large
CAMERA_DIRECTION = np.array([0.62, -1.0, 0.30])  # from where the camera looks


def extent(robot: Robot) -> Array:
    """Return the lowest and highest corner of the robot, floor included [m], shape (2, 3)."""
    points = np.vstack(
        [robot.exit_points, robot.workspace_min, robot.workspace_max, robot.home_position]
    )
    lower, upper = points.min(axis=0), points.max(axis=0)
    lower[2] = min(lower[2], 0.0)
    return np.stack([lower, upper])


def posts(robot: Robot) -> Array:
    """Return lines from the floor to each exit point [m], shape (n, 2, 3)."""
    foot = robot.exit_points.copy()
    foot[:, 2] = extent(robot)[0, 2]
    return np.stack([foot, robot.exit_points], axis=1)


def platform_box(robot: Robot) -> tuple[Array, Array]:
    """Return sides and centre of the box that stands for the platform, in P [m], each (3,).

    It is the box of the anchor points, given a height where they lie in a plane.
    """
    lower, upper = robot.anchor_points.min(axis=0), robot.anchor_points.max(axis=0)
    sides = upper - lower
    smallest = PLATFORM_SIZE_MIN * float(np.ptp(extent(robot), axis=0).max())
    least = max(PLATFORM_FLATNESS_MIN * float(sides.max()), PLATFORM_FLATNESS_MIN * smallest)
    sides = np.maximum(sides, [smallest, smallest, least])
    sides = np.maximum(sides, least)
    return sides, 0.5 * (lower + upper)


def camera(robot: Robot) -> tuple[Array, Array]:
    """Return position and target of a camera that sees all of the robot [m]."""
    lower, upper = extent(robot)
    middle = 0.5 * (lower + upper)
    span = upper - lower
    view = CAMERA_DIRECTION.copy()
    if span[1] > 1.5 * span[0]:  # look across the long side
        view = np.array([1.0, -0.62, 0.30])
    away = 1.4 * float(np.linalg.norm(span))
    return middle + away * view / np.linalg.norm(view), middle
