"""Small motions about a pose of rest: mass matrix and natural frequencies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.fleet import Fleet
from carosac_toolkit.physics.rest.statics import Equilibrium
from carosac_toolkit.robot.robot import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class Modes:
    """Six modes per pose, slowest first.

    Attributes:
        frequency: Undamped natural frequency [Hz], shape (B, 6); negative where the pose is
            unstable in that mode: its magnitude is then the rate of growth over 2 pi. NaN where
            the pose is not one of rest.
        shape: Columns are twists (linear, angular, in W at the platform origin), normalised to
            unit modal mass, shape (B, 6, 6).
    """

    frequency: Array
    shape: Array


def mass_matrix(
    robot: Robot | Fleet, rotation: Array, unstrained_length: Array | None = None
) -> Array:
    r"""Return the inertia of the platform about its origin.

    .. math:: M = \begin{bmatrix} m 1 & -m [c]_\times \\ m [c]_\times & I_c - m [c]_\times^2
        \end{bmatrix}, \qquad c = R\, c_P

    Args:
        robot: Robot description; a `Fleet` has a robot for each row.
        rotation: Rotation from P to W, shape (B, 3, 3).
        unstrained_length: [m], shape (B, n): a third of each cable's mass then rides at its
            anchor point, as of a straight cable that swings about its exit; None: no cables.

    Returns:
        M in W at the platform origin, shape (B, 6, 6): kinetic energy is v^T M v / 2 for a twist
        v, linear first.
    """
    center = (rotation @ robot.center_of_mass[..., None])[..., 0]
    heavy = np.reshape(robot.mass, (-1, 1, 1))
    cross = np.zeros((len(center), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -center[:, 2], center[:, 1], -center[:, 0]
    cross -= cross.swapaxes(1, 2)
    mass = np.zeros((len(center), 6, 6))
    mass[:, :3, :3] = heavy * np.eye(3)
    mass[:, 3:, :3] = heavy * cross
    mass[:, :3, 3:] = -heavy * cross
    inertia = rotation @ robot.inertia @ rotation.swapaxes(1, 2)
    mass[:, 3:, 3:] = inertia - heavy * cross @ cross
    if unstrained_length is not None:
        riding = robot.linear_density * unstrained_length / 3.0  # (B, n) [kg]
        arm = robot.anchor_points @ rotation.swapaxes(1, 2)
        reach = np.zeros((*arm.shape[:2], 3, 6))  # velocity of the anchor point per twist
        reach[..., :3] = np.eye(3)
        reach[..., 0, 4], reach[..., 0, 5] = arm[..., 2], -arm[..., 1]
        reach[..., 1, 3], reach[..., 1, 5] = -arm[..., 2], arm[..., 0]
        reach[..., 2, 3], reach[..., 2, 4] = arm[..., 1], -arm[..., 0]
        mass += np.einsum("bn,bnki,bnkj->bij", riding, reach, reach)
    return mass


def natural_modes(robot: Robot, equilibrium: Equilibrium, *, cable_mass: bool = True) -> Modes:
    """Solve for undamped small motions of the platform with the winches held.

    The cables follow quasi-statically: their own waves lie far above (tens of Hz for taut ones).

    Args:
        robot: Robot description.
        equilibrium: B equilibria of this robot.
        cable_mass: True if the cables have inertia; see `mass_matrix`.

    Returns:
        Frequencies and mode shapes of K x = (2 pi f)^2 M x.
    """
    rest = (equilibrium.status != 0) & np.isfinite(equilibrium.stiffness).all(axis=(1, 2))
    stiffness = np.where(rest[:, None, None], equilibrium.stiffness, np.eye(6))
    rotation = np.where(rest[:, None, None], equilibrium.rotation, np.eye(3))
    length = np.where(rest[:, None], equilibrium.unstrained_length, 0.0) if cable_mass else None
    factor = np.linalg.cholesky(mass_matrix(robot, rotation, length))
    half = np.linalg.solve(factor, stiffness)
    symmetric = np.linalg.solve(factor, half.swapaxes(1, 2))
    values, vectors = np.linalg.eigh(0.5 * (symmetric + symmetric.swapaxes(1, 2)))
    frequency = np.sign(values) * np.sqrt(np.abs(values)) / (2.0 * np.pi)
    shape = np.linalg.solve(factor.swapaxes(1, 2), vectors)
    return Modes(
        frequency=np.where(rest[:, None], frequency, np.nan),
        shape=np.where(rest[:, None, None], shape, np.nan),
    )


DIRECTION_NAMES = ("x", "y", "z", "roll", "pitch", "yaw")


def main_directions(robot: Robot, rotation: Array, shape: Array) -> list[tuple[str, ...]]:
    """Name the main direction of each mode: along x, y, z of W, or a turn about one of them.

    It is the direction with the most kinetic energy of the platform, displacements taken at its
    centre of mass.

    Args:
        robot: Robot description.
        rotation: Rotation from P to W, shape (B, 3, 3).
        shape: Columns are twists, `Modes.shape`, shape (B, 6, 6).

    Returns:
        Entries of `DIRECTION_NAMES`, one for each mode of a pose.
    """
    velocity, turn = shape[:, :3], shape[:, 3:]  # (B, 3, 6)
    at_center = velocity + np.cross(turn, (rotation @ robot.center_of_mass)[..., None], axis=1)
    inertia = np.einsum("bik,kl,bil->bi", rotation, robot.inertia, rotation)  # about axes of W
    energy = np.concatenate(
        [robot.mass * at_center**2, inertia[..., None] * turn**2], axis=1
    )  # (B, 6, 6), twice of each direction and mode
    return [tuple(DIRECTION_NAMES[k] for k in main) for main in energy.argmax(axis=1)]


def natural_frequencies(
    robot: Robot, equilibrium: Equilibrium, *, cable_mass: bool = True
) -> Array:
    """Return the frequencies of `natural_modes` [Hz], shape (B, 6), slowest first."""
    return natural_modes(robot, equilibrium, cable_mass=cable_mass).frequency
