"""Poses and twists that agree with the lengths of straight cables and with their rates."""

from __future__ import annotations

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import from_rotation_vector
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.physics.rest.modes import mass_matrix
from carosac_toolkit.physics.rest.structure import constrained_motion, structure_matrix
from carosac_toolkit.robot.robot import Robot

NEWTON_STEPS_MAX = 12
LENGTH_TOLERANCE_SHARE = 1e-10  # of a length: a smaller difference needs no further Newton step


def moved_pose(position: Array, rotation: Array, move: Array) -> tuple[Array, Array]:
    """Return a pose (3,), (3, 3) after a motion: linear [m], then rotation vector in W [rad]."""
    return position + move[:3], from_rotation_vector(move[3:]) @ rotation


def pose_on_lengths(
    robot: Robot, position: Array, rotation: Array, length: Array
) -> tuple[Array, Array]:
    """Return the nearest pose, by kinetic energy, at which straight cables have given lengths.

    Newton's method; with more than six cables least squares.

    Args:
        robot: Robot description, n cables.
        position: Platform origin in W [m], shape (3,).
        rotation: From P to W, shape (3, 3).
        length: Wanted, straight, datum to anchor point [m], shape (n,).

    Returns:
        Position and rotation there.
    """
    for _ in range(NEWTON_STEPS_MAX):
        missing = length - straight_length(robot, position[None], rotation[None]).length[0]
        if not np.abs(missing).max() > LENGTH_TOLERANCE_SHARE * length.max():
            break
        _, along = _cable_motion(robot, position, rotation, length)
        position, rotation = moved_pose(position, rotation, along @ missing)
    return position, rotation


def twist_on_rates(
    robot: Robot, position: Array, rotation: Array, length: Array, rate: Array, twist: Array
) -> Array:
    """Return the nearest twist, by kinetic energy, at which straight cables have given rates.

    Args:
        robot: Robot description, n cables.
        position: Platform origin in W [m], shape (3,).
        rotation: From P to W, shape (3, 3).
        length: Of the cables [m], shape (n,).
        rate: Wanted [m/s], shape (n,).
        twist: Linear first, in W, at the origin, shape (6,).

    Returns:
        shape (6,).
    """
    jacobian, along = _cable_motion(robot, position, rotation, length)
    return np.asarray(twist + along @ (rate - jacobian @ twist))


def _cable_motion(
    robot: Robot, position: Array, rotation: Array, length: Array
) -> tuple[Array, Array]:
    """Return the Jacobian of the lengths (n, 6), and the least motion that changes them (6, n)."""
    jacobian = -structure_matrix(robot, position[None], rotation[None])[0].T
    mass = mass_matrix(robot, rotation[None], length[None])[0]
    return jacobian, constrained_motion(mass, jacobian)
