"""Sway with which a recording begins: displacement and speed along the free directions.

With n < 6 cables of constant lengths a platform still moves in 6 - n directions. How far it is from
its equilibrium at the first sample, and how fast it moves there, are unknown beside the robot. A
platform that moves also vibrates on its elastic cables: how far they are stretched beyond their
lengths at rest, and how fast, is unknown too. Where only its sway is seen, it starts some time
before, as it would hang on cables that do not vibrate: by its first pose dry friction then
remembers what it should.
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
from carosac_toolkit.loop.values import Belief, Pose
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.physics.fleet import Fleet
from carosac_toolkit.physics.rest.held_lengths import (
    moved_poses,
    poses_on_lengths,
    pull_of_held_cables,
    twists_on_rates,
)
from carosac_toolkit.physics.rest.modes import mass_matrix, natural_frequencies
from carosac_toolkit.physics.rest.statics import Equilibrium
from carosac_toolkit.physics.rest.structure import structure_matrix
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.validation.first_motion import first_state
from carosac_toolkit.validation.phases import anchors_at

REST_DISPLACEMENT_SIGMA = Scaled(0.01, "m", least=1e-3)  # of a platform that seems to rest
MOVING_SIGMA_SHARE = 2.0  # of the first guess: prior sigma of a platform that moves
RATE_STEP_SHARE = 1e-3  # of the time in which a cable's length falls, for a difference
STRETCH_SIGMA_SHARE = 2.0  # of the elongation at rest: prior sigma of a further one, in motion


@dataclass(frozen=True, kw_only=True, eq=False)
class FreeSway:
    """Free directions of a platform at rest, m = 6 - n of them, none with six cables or more.

    The coordinates of a start are m displacements from the equilibrium and m speeds, and of a
    platform that moves the elongations of its n cables beyond those at rest and their rates; each
    over its prior sigma. Their prior mean is 0.

    Attributes:
        shape: Columns are twists (linear first, in W, at the origin) that move the fastest anchor
            point by 1 m/s, shape (6, m); modes of the platform on cables that do not stretch.
        frequency: Of these modes [rad/s], slowest first, shape (m,).
        sigma: Prior sigma of the displacements [m], then of the speeds [m/s], shape (2 m,).
        stretch_sigma: Prior sigma of the elongations [m], then of their rates [m/s], shape (2 n,);
            (0,) for a platform that seems to rest, or whose vibrations are not seen.
        guess: Coordinates from which a search begins, shape (2 m + 2 n,) or (2 m,).
        begin: When the platform starts, before its first pose, on cables that do not vibrate, but
            for elongations among the coordinates [s]; None: at the first reading, on cables as
            long as at rest.
    """

    shape: Array
    frequency: Array
    sigma: Array
    stretch_sigma: Array
    guess: Array
    begin: float | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        words = {
            "displacement": len(self.sigma) // 2,
            "speed": len(self.sigma) // 2,
            "elongation": len(self.stretch_sigma) // 2,
            "elongation_rate": len(self.stretch_sigma) // 2,
        }
        return tuple(f"start.{word}[{i}]" for word, count in words.items() for i in range(count))

    def values(self, coordinates: Array) -> tuple[Array, Array]:
        """Return displacements [m] and speeds [m/s] along the free directions, each (m,)."""
        parts = np.split(self.sigma * coordinates[: len(self.sigma)], 2)
        return parts[0], parts[1]

    def elongations(self, coordinates: Array) -> tuple[Array, Array]:
        """Return elongations [m] of cables and their rates [m/s], each (n,), or (1,) zero."""
        if not len(self.stretch_sigma):
            return np.zeros(1), np.zeros(1)
        first, stop = len(self.sigma), len(self.sigma) + len(self.stretch_sigma)
        parts = np.split(self.stretch_sigma * coordinates[first:stop], 2)
        return parts[0], parts[1]


def find_sway(
    robot: Robot,
    rest: Equilibrium,
    poses: MeasuredPoses,
    *,
    moves: bool,
    before: float = 0.0,
) -> FreeSway:
    """Find the free directions at rest, and guess the first motion from measured poses.

    Args:
        robot: Robot description, n cables.
        rest: Its equilibrium on the first lengths, B = 1.
        poses: Measured ones, from the start on.
        moves: True if the platform moves at first; otherwise the guess is rest.
        before: Time from the start of a platform that moves to its first pose, where its
            vibrations are not seen [s]; 0: it starts at its first reading, and may vibrate.
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
    guess, elongations = np.zeros(len(sigma)), np.zeros(0)
    if moves and len(frequency):
        first = first_state(robot, rest, poses.time, poses.position, poses.rotation)
        guess = _guess(rest, first, np.linalg.cholesky(mass).T, shape)
        swing = np.hypot(*np.split(guess / np.concatenate([np.ones_like(floor), frequency]), 2))
        reach = np.maximum(floor, MOVING_SIGMA_SHARE * swing.max())
        sigma = np.concatenate([reach, frequency * reach])
        if before:
            guess = _earlier(guess, frequency, before)
        else:
            elongations = stretch_sigma(robot, rest)
    return FreeSway(
        shape=shape,
        frequency=frequency,
        sigma=sigma,
        stretch_sigma=elongations,
        guess=np.concatenate([guess / sigma, np.zeros(len(elongations))]),
        begin=float(poses.time[0]) - before if before else None,
    )


def swaying_states(
    sways: Sequence[FreeSway],
    fleet: Fleet,
    rest: Pose,
    length: Array,
    rate: Array,
    coordinates: Sequence[Array],
) -> tuple[Array, Array, Array]:
    """Return where B robots start.

    Displaced platforms are moved on to where their straight cables are as long as at rest, or by
    their elongation longer: a large swing alone does not stretch them. Of those that start before
    their first reading, cables are as much longer as the swing pulls at them.

    Args:
        sways: Their free directions.
        fleet: B robots, n cables each.
        rest: Their equilibria, B of them.
        length: Unstrained lengths there [m], shape (B, n).
        rate: Of these [m/s], shape (B, n).
        coordinates: Of each robot, as its sway has them.

    Returns:
        Positions (B, 3) [m], rotations (B, 3, 3), and twists (B, 6) of the origins in W.
    """
    values = [sway.values(each) for sway, each in zip(sways, coordinates, strict=True)]
    move = np.array([sway.shape @ value[0] for sway, value in zip(sways, values, strict=True)])
    free = np.array([sway.shape @ value[1] for sway, value in zip(sways, values, strict=True)])
    position, rotation = moved_poses(rest.position, rest.rotation, move)
    longer, faster = (
        np.array([
            np.broadcast_to(sway.elongations(each)[k], fleet.n)
            for sway, each in zip(sways, coordinates, strict=True)
        ])
        for k in range(2)
    )  # fmt: skip
    wanted = straight_length(fleet, rest.position, rest.rotation).length + longer
    position, rotation = poses_on_lengths(fleet, position, rotation, wanted)
    twist = twists_on_rates(fleet, position, rotation, length, rate + faster, free)
    calm = np.flatnonzero([sway.begin is not None for sway in sways])
    if len(calm):
        robots = fleet.rows(calm)
        stretch, growth = _stretch_in_motion(
            robots, Pose(position=rest.position[calm], rotation=rest.rotation[calm]),
            Pose(position=position[calm], rotation=rotation[calm]), twist[calm], length[calm],
        )  # fmt: skip
        position[calm], rotation[calm] = poses_on_lengths(
            robots, position[calm], rotation[calm], wanted[calm] + stretch
        )
        twist[calm] = twists_on_rates(
            robots, position[calm], rotation[calm], length[calm],
            rate[calm] + faster[calm] + growth, free[calm],
        )  # fmt: skip
    return position, rotation, twist


def _stretch_in_motion(
    fleet: Fleet, rest: Pose, pose: Pose, twist: Array, length: Array
) -> tuple[Array, Array]:
    """Return by how much a swing stretches cables beyond their rest [m], and how fast [m/s].

    Both (B, n): what straight cables pull that keep their lengths, over their stiffness. A platform
    that starts so hardly vibrates.
    """
    at_rest, _ = pull_of_held_cables(fleet, rest.position, rest.rotation, np.zeros_like(twist))
    pull, change = pull_of_held_cables(fleet, pose.position, pose.rotation, twist)
    step = RATE_STEP_SHARE * np.sqrt(length.mean(axis=1, keepdims=True) / fleet.gravity)  # (B, 1)
    there = moved_poses(pose.position, pose.rotation, step * twist)
    later, _ = pull_of_held_cables(fleet, *there, twist + step * change)
    softness = (length + fleet.run_length) / fleet.axial_stiffness
    return softness * (pull - at_rest), softness * (later - pull) / step


def _earlier(state: Array, frequency: Array, time: float) -> Array:
    """Return displacements and speeds (2 m,) of undamped modes [rad/s] some time [s] before."""
    away, speed = np.split(state, 2)
    cos, sin = np.cos(frequency * time), np.sin(frequency * time)
    return np.concatenate([
        away * cos - speed / frequency * sin, speed * cos + away * frequency * sin
    ])  # fmt: skip


def stretch_sigma(robot: Robot, rest: Equilibrium) -> Array:
    """Return the prior sigma of elongations [m] and of their rates [m/s], shape (2 n,)."""
    strain = rest.tension[0] / robot.axial_stiffness
    sigma = STRETCH_SIGMA_SHARE * strain * (rest.unstrained_length[0] + robot.run_length)
    stiff = 2.0 * np.pi * natural_frequencies(robot, rest)[0, -robot.n :].mean()
    return np.concatenate([sigma, stiff * sigma])


def _guess(rest: Equilibrium, first: Belief, root: Array, shape: Array) -> Array:
    """Return displacements [m] and speeds [m/s] of a state along the free directions, (2 m,).

    The nearest in the metric of the kinetic energy, whose root is `root`.
    """
    assert first.twist is not None
    turned = Rotation.from_matrix(first.rotation[0] @ rest.rotation[0].T).as_rotvec()
    away = np.concatenate([first.position[0] - rest.position[0], turned])
    along = np.linalg.pinv(root @ shape) @ root
    return np.concatenate([along @ away, along @ first.twist[0]])
