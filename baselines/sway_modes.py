"""The slow sway of a platform about a pose of rest: frequency, damping, and what excites it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.motion.cable_drag import cable_drag_of
from carosac_toolkit.physics.rest.modes import mass_matrix, natural_modes
from carosac_toolkit.physics.rest.statics import Equilibrium
from carosac_toolkit.physics.rest.structure import structure_matrix
from carosac_toolkit.robot.robot import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class SwayModes:
    """The K slowest modes about B poses of rest.

    Attributes:
        frequency: Undamped natural frequency [Hz], shape (B, K); not positive where the pose is
            not stable.
        damping: Damping ratio, shape (B, K).
        excitation: Direction of platform acceleration in W that excites each mode, as momentum of
            the mode of unit modal mass [sqrt(kg)], shape (B, K, 3): with the pose of rest moving
            at acceleration a, the modal coordinate q has q'' + (2 pi f)^2 q = -excitation . a.
    """

    frequency: Array
    damping: Array
    excitation: Array


def sway_modes(robot: Robot, rest: Equilibrium, count: int) -> SwayModes:
    """Find the slowest modes of a robot at rest, without the change of tilt between poses.

    Args:
        robot: Robot description.
        rest: B equilibria of this robot, all converged.
        count: How many modes.

    Returns:
        Modes, damped by the air drag of the platform and of the third of each cable that rides with
        it, and by the axial damping of straight cables.
    """
    modes = natural_modes(robot, rest)
    shape = modes.shape[:, :, :count]  # (B, 6, K)
    momentum = mass_matrix(robot, rest.rotation, rest.unstrained_length) @ shape
    spin = shape[:, 3:].swapaxes(1, 2)  # (B, K, 3)
    center = (rest.rotation @ robot.center_of_mass)[:, None, :]
    velocity = shape[:, :3].swapaxes(1, 2) + np.cross(spin, center)  # of the centre of mass
    about = spin @ rest.rotation  # along the axes of P
    power = robot.drag * (velocity**2).sum(axis=2)
    power = power + robot.angular_drag * (about**2 @ robot.angular_drag_axes)
    riding = cable_drag_of(robot) * robot.linear_density * rest.unstrained_length / 3.0  # (B, n)
    arms = robot.anchor_points @ rest.rotation.swapaxes(1, 2)  # (B, n, 3)
    moved = shape[:, :3].swapaxes(1, 2)[:, None] + np.cross(spin[:, None], arms[:, :, None])
    power = power + np.einsum("bn,bnki->bk", riding, moved**2)
    structure = structure_matrix(robot, rest.position, rest.rotation)
    stretch = structure.swapaxes(1, 2) @ shape  # (B, n, K)
    rate = robot.axial_damping / (rest.unstrained_length + robot.run_length)  # (B, n) [N s/m]
    power = power + np.einsum("bn,bnk->bk", rate, stretch**2)
    frequency = modes.frequency[:, :count]
    with np.errstate(divide="ignore", invalid="ignore"):
        damping = power / (4.0 * np.pi * np.abs(frequency))
    excitation = momentum[:, :3].swapaxes(1, 2)
    return SwayModes(frequency=frequency, damping=damping, excitation=excitation)
