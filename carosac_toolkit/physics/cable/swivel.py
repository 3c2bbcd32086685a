"""Angles of swivelling pulleys about their axes."""

from __future__ import annotations

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot

ALONG_X_COSINE = 0.9  # an axis nearer to x of W than this has its zero towards y


def swivel_zero(robot: Robot) -> Array:
    """Return the unit vectors in W towards which swivel angles are 0, shape (n, 3).

    That is x of W, projected onto the plane across the swivel axis; for an axis along x, within
    about 25 degrees, it is y.
    """
    axis = robot.swivel_axis
    near_x = np.abs(axis[:, :1]) > ALONG_X_COSINE
    towards = np.where(near_x, [0.0, 1.0, 0.0], [1.0, 0.0, 0.0])
    across = towards - (towards * axis).sum(axis=1, keepdims=True) * axis
    return np.asarray(across / np.linalg.norm(across, axis=1, keepdims=True))


def swivel_angle(robot: Robot, leaving: Array) -> Array:
    """Return how far each pulley has swivelled about its axis [rad], within (-pi, pi].

    The pulley turns with the plane of its axis and the cable that leaves it. Positive angles are
    right-handed about `swivel_axis`, along which the cable comes from the winch; `swivel_zero` is
    where the angle is 0.

    Args:
        robot: Robot description, n cables.
        leaving: Vectors in W along which cables leave their pulleys, of any length, as minus the
            tension vector at the exit, or from exit point to anchor point, shape (B, n, 3).

    Returns:
        shape (B, n); 0 where there is no pulley.
    """
    zero, side = _plane(robot)
    angle = np.arctan2((leaving * side).sum(axis=-1), (leaving * zero).sum(axis=-1))
    return np.where(robot.pulley_radius > 0.0, angle, 0.0)


def straight_swivel_angle(robot: Robot, position: Array, rotation: Array) -> Array:
    """Return the swivel angles of straight cables to a platform [rad], shape (B, n).

    Args:
        robot: Robot description, n cables.
        position: Platform origin in W [m], shape (B, 3).
        rotation: From P to W, shape (B, 3, 3).
    """
    anchors = position[:, None] + robot.anchor_points @ rotation.swapaxes(1, 2)
    return swivel_angle(robot, anchors - robot.exit_points)


def swivel_slope(robot: Robot, leaving: Array) -> Array:
    """Return the change of `swivel_angle` per change of the vectors [rad/m], shape (B, n, 3).

    Args:
        robot: Robot description, n cables.
        leaving: Vectors from exit points to anchor points in W [m], shape (B, n, 3).

    Returns:
        0 where there is no pulley.
    """
    zero, side = _plane(robot)
    along, across = ((leaving * each).sum(axis=-1, keepdims=True) for each in (zero, side))
    slope = (along * side - across * zero) / (along**2 + across**2)
    return np.where(robot.pulley_radius[:, None] > 0.0, slope, 0.0)


def _plane(robot: Robot) -> tuple[Array, Array]:
    """Return the unit vectors across the swivel axes at angles of 0 and 90 degrees, (n, 3) each."""
    zero = swivel_zero(robot)
    return zero, np.cross(robot.swivel_axis, zero)
