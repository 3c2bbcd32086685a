"""Sway with which a recording begins: displacement and speed along the free directions.

With n < 6 cables of constant lengths a platform still moves in 6 - n directions. How far it is from
its equilibrium at the first sample, and how fast it moves there, are unknown beside the robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh, null_space
from scipy.spatial.transform import Rotation

from calibration.identification.measured_poses import MeasuredPoses
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.physics.rest.modes import mass_matrix
from carosac_toolkit.physics.rest.statics import Equilibrium
from carosac_toolkit.physics.rest.structure import constrained_motion, structure_matrix
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.validation.phases import anchors_at

REST_DISPLACEMENT_SIGMA = Scaled(0.01, "m", least=1e-3)  # of a platform that seems to rest
MOVING_SIGMA_SHARE = 2.0  # of the first guess: prior sigma of a platform that moves
NEWTON_STEPS_MAX = 12
LENGTH_TOLERANCE_SHARE = 1e-10  # of a length: a smaller difference needs no further Newton step
GUESS_PERIODS = 0.4  # of the fastest free mode, over which a polynomial is fitted
GUESS_DEGREE_MAX = 3
GUESS_POSES_MIN = 4  # poses, from which a speed can be guessed


@dataclass(frozen=True, kw_only=True, eq=False)
class FreeSway:
    """Free directions of a platform at rest, m = 6 - n of them, none with six cables or more.

    The coordinates of a start are m displacements from the equilibrium and m speeds, each over its
    prior sigma; their prior mean is 0.

    Attributes:
        shape: Columns are twists (linear first, in W, at the origin) that move the fastest anchor
            point by 1 m/s, shape (6, m); modes of the platform on cables that do not stretch.
        frequency: Of these modes [rad/s], slowest first, shape (m,).
        sigma: Prior sigma of the displacements [m], then of the speeds [m/s], shape (2 m,).
        guess: Coordinates from which a search begins, shape (2 m,).
    """

    shape: Array
    frequency: Array
    sigma: Array
    guess: Array

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        count = range(len(self.frequency))
        words = ("displacement", "speed")
        return tuple(f"start.{word}[{i}]" for word in words for i in count)

    def values(self, coordinates: Array) -> tuple[Array, Array]:
        """Return displacements [m] and speeds [m/s] along the free directions, each (..., m)."""
        parts = np.split(self.sigma * coordinates, 2, axis=-1)
        return parts[0], parts[1]

    def state(
        self, robot: Robot, rest: Pose, length: Array, rate: Array, coordinates: Array
    ) -> tuple[Array, Array, Array]:
        """Return where a robot starts.

        The displaced platform is moved on to where its straight cables are as long as at rest, so
        that a large swing does not stretch them.

        Args:
            robot: Robot description, n cables.
            rest: Its equilibrium, B = 1.
            length: Unstrained lengths there [m], shape (n,).
            rate: Of the lengths [m/s], shape (n,).
            coordinates: shape (2 m,).

        Returns:
            Position [m], (3,), rotation, (3, 3), and twist of the platform origin in W, (6,).
        """
        displacement, speed = self.values(coordinates)
        position, rotation = _moved(rest.position[0], rest.rotation[0], self.shape @ displacement)
        wanted = straight_length(robot, rest.position, rest.rotation).length[0]
        for _ in range(NEWTON_STEPS_MAX):
            missing = wanted - straight_length(robot, position[None], rotation[None]).length[0]
            if not np.abs(missing).max() > LENGTH_TOLERANCE_SHARE * wanted.max():
                break
            _, along = _cable_motion(robot, position, rotation, length)
            position, rotation = _moved(position, rotation, along @ missing)
        jacobian, along = _cable_motion(robot, position, rotation, length)
        twist = self.shape @ speed
        return position, rotation, twist + along @ (rate - jacobian @ twist)


def find_sway(robot: Robot, rest: Equilibrium, poses: MeasuredPoses, *, moves: bool) -> FreeSway:
    """Find the free directions at rest, and guess the first motion from measured poses.

    Args:
        robot: Robot description, n cables.
        rest: Its equilibrium on the first lengths, B = 1.
        poses: Measured ones, from the start on.
        moves: True if the platform moves at first; otherwise the guess is rest.
    """
    jacobian = -structure_matrix(robot, rest.position, rest.rotation)[0].T
    mass = mass_matrix(robot, rest.rotation, rest.unstrained_length)[0]
    basis = null_space(jacobian) if robot.n < len(jacobian.T) else np.zeros((6, 0))
    squared, weights = np.zeros(0), np.zeros((0, 0))
    if basis.size:
        stiffness = 0.5 * (rest.stiffness[0] + rest.stiffness[0].T)
        squared, weights = eigh(basis.T @ stiffness @ basis, basis.T @ mass @ basis)
    modes = basis @ weights
    arms = anchors_at(robot, np.zeros((1, 3)), rest.rotation)[0]
    speeds = [np.linalg.norm(c[:3] + np.cross(c[3:], arms), axis=1).max() for c in modes.T]
    shape = modes / np.array(speeds)
    frequency = np.sqrt(np.abs(squared))
    floor = np.full(len(frequency), REST_DISPLACEMENT_SIGMA.of(Scales(robot).ratios))
    sigma = np.concatenate([floor, frequency * floor])
    guess = np.zeros(len(sigma))
    if moves and len(frequency):
        guess = _guess(rest, poses, np.linalg.cholesky(mass).T, shape, frequency)
        swing = np.hypot(*np.split(guess / np.concatenate([np.ones_like(floor), frequency]), 2))
        reach = np.maximum(floor, MOVING_SIGMA_SHARE * swing.max())
        sigma = np.concatenate([reach, frequency * reach])
    return FreeSway(shape=shape, frequency=frequency, sigma=sigma, guess=guess / sigma)


def swaying_states(
    sway: FreeSway,
    robots: Sequence[Robot],
    rest: Pose,
    length: Array,
    rate: Array,
    coordinates: Array,
) -> tuple[Array, Array, Array]:
    """Return where B robots start; see `FreeSway.state`.

    Args:
        sway: Their free directions.
        robots: B robots.
        rest: Their equilibria, B of them.
        length: Unstrained lengths [m], shape (B, n).
        rate: Of these [m/s], shape (B, n).
        coordinates: shape (B, 2 m).

    Returns:
        Positions (B, 3), rotations (B, 3, 3) and twists (B, 6).
    """
    states = [
        sway.state(
            robot, Pose(position=rest.position[b : b + 1], rotation=rest.rotation[b : b + 1]),
            length[b], rate[b], coordinates[b],
        )
        for b, robot in enumerate(robots)
    ]  # fmt: skip
    position, rotation, twist = zip(*states, strict=True)
    return np.array(position), np.array(rotation), np.array(twist)


def _moved(position: Array, rotation: Array, move: Array) -> tuple[Array, Array]:
    """Return a pose after a small or large motion (linear, rotation vector in W)."""
    return position + move[:3], Rotation.from_rotvec(move[3:]).as_matrix() @ rotation


def _cable_motion(
    robot: Robot, position: Array, rotation: Array, length: Array
) -> tuple[Array, Array]:
    """Return the Jacobian of the lengths (n, 6), and the least motion that changes them (6, n)."""
    jacobian = -structure_matrix(robot, position[None], rotation[None])[0].T
    mass = mass_matrix(robot, rotation[None], length[None])[0]
    return jacobian, constrained_motion(mass, jacobian)


def _guess(
    rest: Equilibrium, poses: MeasuredPoses, root: Array, shape: Array, frequency: Array
) -> Array:
    """Return displacements [m] and speeds [m/s] of the first measured poses, shape (2 m,).

    A polynomial in time is fitted to the motion from the equilibrium, in the metric of the kinetic
    energy, whose root is `root`.
    """
    span = GUESS_PERIODS * 2.0 * np.pi / float(frequency.max())
    count = max(int(np.searchsorted(poses.time, poses.time[0] + span)), GUESS_POSES_MIN)
    early = poses.rows(np.arange(min(count, len(poses.time))))
    turned = Rotation.from_matrix(early.rotation @ rest.rotation[0].T).as_rotvec()
    motion = np.hstack([early.position - rest.position[0], turned])  # (K, 6)
    modal = motion @ root.T @ np.linalg.pinv(root @ shape).T  # (K, m)
    degree = min(GUESS_DEGREE_MAX, len(early.time) // 2)
    when = (early.time - early.time[0]) / max(span, float(np.ptp(early.time)))
    fit = np.polynomial.polynomial.polyfit(when, modal, degree)
    speed = fit[1] / max(span, float(np.ptp(early.time)))
    return np.concatenate([fit[0], speed])
