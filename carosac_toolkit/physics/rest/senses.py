"""What load cells, an IMU and a pose measurement sense of a platform at rest at its home."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.rotations import from_matrix, to_matrix
from carosac_toolkit.loop.values import Pose, State
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.homing import DEGREES_OF_FREEDOM
from carosac_toolkit.physics.rest.structure import structure_matrix
from carosac_toolkit.robot.robot import Robot

AXES = 3
FINITE_DIFFERENCE_STEP = 1e-5  # [m] and [rad]; tensions change by more than the solver's error
TAUT_TENSION_PER_WEIGHT = 3.0  # sag of 1/24 of the chord: the cable pulls along it
STRESS_RANK_TOLERANCE = 1e-6  # relative: smaller motions and wrenches are none


@dataclass(frozen=True, kw_only=True, eq=False)
class SensedHome:
    """Readings at a home and how they change if it is wrong.

    A reading is the n tensions at the platform [N], the specific force in P [m/s^2], the position
    in W [m], and the turn in W from the rotation of rest at home: axis times 2 sin(angle / 2), so
    radians where it is small. Together n + 9 numbers.

    Attributes:
        rotation: Rotation from P to W of rest at home, shape (3, 3).
        reading: Readings at home, shape (n + 9,).
        by_position: Change per metre of position along each axis of W, shape (n + 9, 3).
        by_rotation: Change per radian about each axis of W, shape (n + 9, 3); zeros with fewer
            than six cables, which leave the rotation to gravity.
        by_stress: Change per newton of each stress by which cables pull against each other and the
            pose stays, shape (n + 9, k). The rotation may change where gravity decides on it: k is
            n - 3 with fewer than six cables, else n - 6.
        taut: True if every cable pulls enough to be nearly straight.
    """

    rotation: Array
    reading: Array
    by_position: Array
    by_rotation: Array
    by_stress: Array
    taut: bool


def sensed_home(robot: Robot, home: State, tension: Array | None = None) -> SensedHome:
    """Compute the readings at a home, and their derivatives by central differences.

    Args:
        robot: Robot description, n cables.
        home: A batch of one: with six cables or more at its rotation, with fewer at that of rest.
        tension: Measured tensions [N], shape (n,). With six cables or more the ones nearest to
            them that hold the platform are expected, as its pose does not determine the stress.
            None: those of inverse kinematics.

    Raises:
        InvalidField: The platform cannot rest there.
    """
    held = robot.n >= DEGREES_OF_FREEDOM
    steps = FINITE_DIFFERENCE_STEP * np.concatenate([np.eye(AXES), -np.eye(AXES)])
    still = np.zeros_like(steps)
    shift = np.concatenate([np.zeros((1, AXES)), steps, still])
    half_turn = 0.5 * np.concatenate([np.zeros((1, AXES)), still, steps])
    turn = to_matrix(np.concatenate([np.ones((len(shift), 1)), half_turn], axis=1))
    rotation = turn @ home.rotation if held else None
    rest = statics.inverse_kinematics(robot, home.position + shift, rotation)
    if not rest.converged.all():
        where = np.round(home.position[0], 4).tolist()
        raise InvalidField("position", f"{where} m", "a pose around which the platform can rest")
    expected = rest.tension
    if held and tension is not None:
        expected = _nearest(
            structure_matrix(robot, rest.position, rest.rotation), expected, tension
        )
    readings = _readings(robot, rest, expected, rest.rotation[0])
    by_position, by_rotation = (
        _slope(part) for part in readings[1:].reshape(2, 2, AXES, -1)
    )  # position or rotation, side, axis, reading
    weight = robot.linear_density * robot.gravity * rest.unstrained_length[0]
    return SensedHome(
        rotation=rest.rotation[0],
        reading=readings[0],
        by_position=by_position,
        by_rotation=by_rotation if held else np.zeros_like(by_rotation),
        by_stress=_held_stress(robot, rest) if held else _free_stress(robot, rest),
        taut=bool((rest.tension[0] >= TAUT_TENSION_PER_WEIGHT * weight).all()),
    )


def turn_between(start: Array, end: Array) -> Array:
    """Return axis times 2 sin(angle / 2) of the turn between two rotations, in W, (3,)."""
    return np.asarray(2.0 * from_matrix((end @ start.T)[None])[0, 1:])


def _nearest(matrix: Array, rest: Array, tension: Array) -> Array:
    """Return the tensions nearest to measured ones that pull on the platform as those of rest."""
    off = tension - rest  # sag turns the pull of taut cables by a force that is the same for both
    pulling = np.linalg.pinv(matrix, rcond=STRESS_RANK_TOLERANCE) @ matrix
    return np.asarray(tension - np.einsum("bij,bj->bi", pulling, off))


def _readings(
    robot: Robot, rest: statics.Equilibrium, tension: Array, home_rotation: Array
) -> Array:
    """Return the readings at equilibria with these tensions [N], shape (B, n + 9)."""
    force = robot.gravity * rest.rotation[:, 2, :]  # R^T times g up
    turns = np.stack([turn_between(home_rotation, rotation) for rotation in rest.rotation])
    return np.concatenate([tension, force, rest.position, turns], axis=1)


def _held_stress(robot: Robot, rest: statics.Equilibrium) -> Array:
    """Return tensions that balance each other at the first of the equilibria, (n + 9, k)."""
    from scipy.linalg import null_space

    matrix = structure_matrix(robot, rest.position[:1], rest.rotation[:1])[0]
    balanced = null_space(matrix, rcond=STRESS_RANK_TOLERANCE)
    return np.concatenate([balanced, np.zeros((3 * AXES, balanced.shape[1]))])


def _free_stress(robot: Robot, rest: statics.Equilibrium) -> Array:
    """Return what changes where lengths turn the platform and leave its position, (n + 9, k)."""
    from scipy.linalg import null_space

    n = robot.n
    near = Pose(
        position=np.repeat(rest.position[:1], 2 * n, axis=0),
        rotation=np.repeat(rest.rotation[:1], 2 * n, axis=0),
    )
    changes = FINITE_DIFFERENCE_STEP * np.concatenate([np.eye(n), -np.eye(n)])
    wound = statics.forward_kinematics(robot, rest.unstrained_length[0] + changes, guess=near)
    readings = _readings(robot, wound, wound.tension, rest.rotation[0])
    by_length = _slope(readings.reshape(2, n, -1))
    placed = by_length[n + AXES : n + 2 * AXES]
    stress = by_length @ null_space(placed, rcond=STRESS_RANK_TOLERANCE)
    return np.asarray(stress / np.linalg.norm(stress[:n], axis=0))


def _slope(readings: Array) -> Array:
    """Return central differences of readings on two sides, (2, k, m), as columns (m, k)."""
    return np.asarray((readings[0] - readings[1]).T / (2.0 * FINITE_DIFFERENCE_STEP))
