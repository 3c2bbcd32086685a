"""Poses and twists that agree with the lengths of straight cables and with their rates."""

from __future__ import annotations

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import from_rotation_vector
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.physics.fleet import Fleet
from carosac_toolkit.physics.rest.modes import mass_matrix
from carosac_toolkit.physics.rest.structure import constrained_motion, structure_matrix
from carosac_toolkit.robot.robot import Robot

RATE_STEP_SHARE = 1e-4  # of the time in which a cable's length falls, for differences
NEWTON_STEPS_MAX = 12
LENGTH_TOLERANCE_SHARE = 1e-10  # of a length: a smaller difference needs no further Newton step


def moved_pose(position: Array, rotation: Array, move: Array) -> tuple[Array, Array]:
    """Return a pose (3,), (3, 3) after a motion: linear [m], then rotation vector in W [rad]."""
    return position + move[:3], from_rotation_vector(move[3:]) @ rotation


def moved_poses(position: Array, rotation: Array, move: Array) -> tuple[Array, Array]:
    """Return poses (B, 3), (B, 3, 3) after motions (B, 6); see `moved_pose`."""
    return position + move[:, :3], from_rotation_vector(move[:, 3:]) @ rotation


def poses_on_lengths(
    robot: Robot | Fleet, position: Array, rotation: Array, length: Array
) -> tuple[Array, Array]:
    """Return the nearest poses, by kinetic energy, at which straight cables have given lengths.

    Newton's method; with more than six cables least squares.

    Args:
        robot: Robot description, n cables; a `Fleet` has a robot for each row.
        position: Platform origins in W [m], shape (B, 3).
        rotation: From P to W, shape (B, 3, 3).
        length: Wanted, straight, datum to anchor point [m], shape (B, n).

    Returns:
        Positions and rotations there.
    """
    for _ in range(NEWTON_STEPS_MAX):
        missing = length - straight_length(robot, position, rotation).length
        off = np.abs(missing).max(axis=1) > LENGTH_TOLERANCE_SHARE * length.max(axis=1)
        if not off.any():
            break
        _, along = _cable_motion(robot, position, rotation, length)
        move = np.where(off[:, None], np.einsum("bij,bj->bi", along, missing), 0.0)
        position, rotation = moved_poses(position, rotation, move)
    return position, rotation


def twists_on_rates(
    robot: Robot | Fleet, position: Array, rotation: Array, length: Array, rate: Array, twist: Array
) -> Array:
    """Return the nearest twists, by kinetic energy, at which straight cables have given rates.

    Args:
        robot: Robot description, n cables; a `Fleet` has a robot for each row.
        position: Platform origins in W [m], shape (B, 3).
        rotation: From P to W, shape (B, 3, 3).
        length: Of the cables [m], shape (B, n).
        rate: Wanted [m/s], shape (B, n).
        twist: Linear first, in W, at the origin, shape (B, 6).

    Returns:
        shape (B, 6).
    """
    jacobian, along = _cable_motion(robot, position, rotation, length)
    missing = rate - np.einsum("bij,bj->bi", jacobian, twist)
    return np.asarray(twist + np.einsum("bij,bj->bi", along, missing))


def pull_of_held_cables(
    robot: Robot | Fleet, position: Array, rotation: Array, twist: Array
) -> tuple[Array, Array]:
    r"""Return the tensions with which straight cables keep their lengths in motion.

    They give the platform the acceleration that its twist asks for,

    .. math:: M \dot\xi + h = w + A f, \qquad A^\top \dot\xi + \dot A^\top \xi = 0,

    with the weight w and the gyroscopic wrench h. Cables have no mass.

    Args:
        robot: Robot description, n cables, at most six; a `Fleet` has a robot for each row.
        position: Platform origins in W [m], shape (B, 3).
        rotation: From P to W, shape (B, 3, 3).
        twist: Linear first, in W, at the origin, shape (B, 6), along which no length changes.

    Returns:
        Tensions [N], shape (B, n), and accelerations, shape (B, 6).
    """
    mass = mass_matrix(robot, rotation)
    center = (rotation @ robot.center_of_mass[..., None])[..., 0]
    omega = twist[:, 3:]
    inertia = rotation @ robot.inertia @ rotation.swapaxes(1, 2)
    force = -np.reshape(robot.mass, (-1, 1)) * np.cross(omega, np.cross(omega, center))
    force[:, 2] -= robot.weight
    moment = np.cross(center, force) - np.cross(omega, np.einsum("bij,bj->bi", inertia, omega))
    wrench = np.concatenate([force, moment], axis=1)
    reach = straight_length(robot, position, rotation).length.mean(axis=1, keepdims=True)
    step = RATE_STEP_SHARE * np.sqrt(reach / robot.gravity)  # (B, 1)
    steps = [moved_poses(position, rotation, side * step * twist) for side in (-1.0, 1.0)]
    before, after = (structure_matrix(robot, *pose) for pose in steps)
    turning = np.einsum("bij,bi->bj", (after - before) / (2.0 * step[:, None]), twist)
    structure = structure_matrix(robot, position, rotation)
    free = np.linalg.solve(mass, wrench[:, :, None])[:, :, 0]
    along = np.linalg.solve(mass, structure)
    missing = -turning - np.einsum("bij,bi->bj", structure, free)
    tension = np.linalg.solve(structure.swapaxes(1, 2) @ along, missing[:, :, None])[:, :, 0]
    return tension, free + np.einsum("bij,bj->bi", along, tension)


def _cable_motion(
    robot: Robot | Fleet, position: Array, rotation: Array, length: Array
) -> tuple[Array, Array]:
    """Return Jacobians of the lengths (B, n, 6), and the least motions that change them."""
    jacobian = -structure_matrix(robot, position, rotation).swapaxes(1, 2)
    mass = mass_matrix(robot, rotation, length)
    return jacobian, constrained_motion(mass, jacobian)
