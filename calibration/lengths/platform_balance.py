r"""Balance of the platform at measured poses: tensions, and what no tensions can balance.

With fewer than six cables a measured pose at rest has to be an equilibrium. The tensions are those
that leave the least acceleration (Gauss's principle): they minimise
:math:`(w + A f)^\top M^{-1} (w + A f)`, so that a platform that swings on cables of constant length
has its own tensions too, but for the small centripetal part. What they cannot balance, the wrench
along the motions that the cables leave free, tells where gravity points and where the centre of
mass is. Half the weight of each cable hangs on the platform, which is exact for taut cables.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import cross_matrix
from carosac_toolkit.physics.cable.straight_line import StraightCables
from carosac_toolkit.robot.robot import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class PlatformBalance:
    """The balance of S poses of a robot with n < 6 cables.

    Attributes:
        tension: At the platform [N], shape (S, n); not positive where a cable would have to push.
        residual: Wrench along the free motions over the weight, moments over the radius of
            gyration, shape (S, 6 - n).
        by_pose: Its derivative by translation and rotation vector in W, (S, 6 - n, 6).
        by_exit: By the exit points in W, (S, 6 - n, n, 3).
        by_anchor: By the anchor points in P, (S, 6 - n, n, 3).
        by_center: By the centre of mass in P, (S, 6 - n, 3).
        by_gravity: By a small turn of the direction of gravity about x and y of W, (S, 6 - n, 2).
    """

    tension: Array
    residual: Array
    by_pose: Array
    by_exit: Array
    by_anchor: Array
    by_center: Array
    by_gravity: Array


def balance(
    robot: Robot, rotation: Array, cables: StraightCables, up: Array | None = None
) -> PlatformBalance:
    """Return tensions and residual of the balance at measured poses.

    Args:
        robot: With n < 6 cables.
        rotation: From P to W, shape (S, 3, 3).
        cables: Straight cables at these poses.
        up: Unit vector against gravity, shape (3,); None: z.
    """
    against = np.array([0.0, 0.0, 1.0]) if up is None else up
    arm = robot.anchor_points @ rotation.swapaxes(1, 2)  # (S, n, 3) [m], in W
    center = rotation @ robot.center_of_mass  # (S, 3) [m], in W
    weight = -robot.weight * against
    free_length = cables.length - robot.pulley_radius * cables.wrap  # (S, n) [m]
    hanging = 0.5 * robot.weight_per_length * free_length  # (S, n) [N]
    down = -hanging[..., None] * against
    matrix = np.concatenate([-cables.direction, np.cross(arm, -cables.direction)], axis=2)
    load = np.concatenate([weight + down.sum(1), np.cross(arm, down).sum(1)], axis=1)
    load[:, 3:] += np.cross(center, weight)
    tension = _tension(robot, rotation, center, matrix, load)  # (S, n) [N], along the chord
    pull = np.linalg.norm(-tension[..., None] * cables.direction + down, axis=2)
    scale = np.ones(6)
    scale[3:] = 1.0 / np.sqrt(np.trace(robot.inertia) / 3.0 / robot.mass)
    whole = np.linalg.qr((matrix * scale).swapaxes(1, 2), mode="complete")[0]
    free = whole[:, :, robot.n :]  # (S, 6, 6 - n), orthonormal, and to all cables
    row = (free * scale[:, None]).swapaxes(1, 2) / robot.weight  # (S, 6 - n, 6)
    by_tip, by_exit, by_pose = _derivatives(
        cables.direction, tension / free_length, arm, tension, center, weight
    )
    return PlatformBalance(
        tension=np.where(tension > 0.0, pull, tension),
        residual=np.einsum("sfi,si->sf", row, load),
        by_pose=row @ by_pose,
        by_exit=(row[:, None] @ by_exit).swapaxes(1, 2),
        by_anchor=(row[:, None] @ by_tip @ rotation[:, None]).swapaxes(1, 2),
        by_center=-row[:, :, 3:] @ cross_matrix(weight) @ rotation,
        by_gravity=(row[:, :, :3] + row[:, :, 3:] @ cross_matrix(center))
        @ -cross_matrix(weight)[:, :2],
    )


def _tension(robot: Robot, rotation: Array, center: Array, matrix: Array, load: Array) -> Array:
    """Return the tensions of least acceleration, (S, n), by wrenches per cable, (S, n, 6)."""
    turning = rotation @ robot.inertia @ rotation.swapaxes(1, 2)
    lever = cross_matrix(center)
    mass = np.zeros((len(rotation), 6, 6))
    mass[:, :3, :3] = robot.mass * np.eye(3)
    mass[:, :3, 3:] = -robot.mass * lever
    mass[:, 3:, :3] = robot.mass * lever
    mass[:, 3:, 3:] = turning - robot.mass * lever @ lever
    softened = np.linalg.solve(mass, matrix.swapaxes(1, 2))  # (S, 6, n)
    tension = np.linalg.solve(
        matrix @ softened, -np.einsum("sin,si->sn", softened, load)[..., None]
    )
    return np.asarray(tension[..., 0])


def _derivatives(
    direction: Array, stiffness: Array, arm: Array, tension: Array, center: Array, weight: Array
) -> tuple[Array, Array, Array]:
    """Return the derivatives of the wrench at constant tensions.

    Returns:
        By the anchor points and by the exit points in W, both (S, n, 6, 3), and by the pose,
        (S, 6, 6).
    """
    across = np.eye(3) - direction[..., :, None] * direction[..., None, :]
    stiff = across * stiffness[..., None, None]  # (S, n, 3, 3) [N/m]
    lever, pull = cross_matrix(arm), cross_matrix(-tension[..., None] * direction)
    by_exit = np.concatenate([stiff, lever @ stiff], axis=2)
    by_place = -by_exit
    by_tip = by_place.copy()
    by_tip[:, :, 3:] -= pull
    turned = (by_tip @ -lever).sum(1)
    turned[:, 3:] += cross_matrix(weight) @ cross_matrix(center)
    return by_tip, by_exit, np.concatenate([by_place.sum(1), turned], axis=2)
