"""The structure matrix: how straight cables pull on the platform."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from carosac_toolkit.base.arrays import Array, batch
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.physics.fleet import Fleet
from carosac_toolkit.robot.robot import Robot


def structure_matrix(
    robot: Robot | Fleet, position: ArrayLike, rotation: ArrayLike | None = None
) -> Array:
    r"""Map cable tensions to the wrench they apply to the platform.

    With unit vector u_i from anchor point to tangent point, both expressed in W,

    .. math:: w_{cables} = A f, \qquad A_{:,i} = [u_i;\; (R\,b_i) \times u_i],

    hence :math:`\dot\ell = -A^\top \xi` for the twist :math:`\xi = [v; \omega]` in W.

    Args:
        robot: Robot description, n cables; a `Fleet` has a robot for each row.
        position: Platform origin in W [m], shape (B, 3).
        rotation: Rotation R from P to W, shape (B, 3, 3); None is the home rotation.

    Returns:
        Structure matrix A, shape (B, 6, n): rows 0-2 [-], rows 3-5 [m] about the platform origin.

    References:
        Pott, *Cable-Driven Parallel Robots*, Springer, 2018.
    """
    unit = -straight_length(robot, position, rotation).direction
    turn = robot.home_rotation if rotation is None else batch("rotation", rotation, (3, 3))
    arm = np.broadcast_to(robot.anchor_points @ turn.swapaxes(-1, -2), unit.shape)
    return np.concatenate([unit, np.cross(arm, unit)], axis=-1).swapaxes(-1, -2)


def constrained_motion(mass: Array, jacobian: Array) -> Array:
    """Return the least motion, by kinetic energy, that changes lengths as required.

    Args:
        mass: Mass matrix at the origin, shape (..., 6, 6).
        jacobian: Of the lengths, shape (..., n, 6).

    Returns:
        Matrix from length changes to twists, shape (..., 6, n); with over six cables, least
        squares.
    """
    root = np.linalg.cholesky(mass).swapaxes(-1, -2)  # twice the energy: (root @ twist)^2
    inverse = np.linalg.inv(root)
    return np.asarray(inverse @ np.linalg.pinv(jacobian @ inverse, rcond=1e-9))
