"""States of a drive carried to other places, with another centre of mass.

A drive sees one path and one plant. What a plan depends on beside these, the way ahead, the sway
and what tensions have been used to, is met as well anywhere else; so each of its states becomes
questions to MPC that need neither a simulator nor an estimator.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from baselines.mpc.geometry import excess_at, geometry_at
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.robot.robot import Robot
from learned.approximate_mpc.plan_inputs import PlanInputs

FACE_SHARE = 0.6  # of the states, carried near a face of the box
FACE_DEPTH = 0.075  # of the room that a way leaves: how near
TURN_TRIES_MAX = 20  # of a way, until it fits into the box
CENTERS_MAX = 2.0  # standard deviations of the centre of mass, drawn evenly within


@dataclass(frozen=True, kw_only=True, eq=False)
class Question:
    """What `Teacher.ask_aside` needs.

    Attributes:
        inputs: State, reference and load.
        rest: Tensions of rest, per stage [N], shape (N, n).
        habit: What tensions differ by from those of rest in the long run [N], shape (n,).
        surplus: What lengths sent exceed straight ones by [m], shape (n,).
    """

    inputs: PlanInputs
    rest: Array
    habit: Array
    surplus: Array


def elsewhere(
    robot: Robot,
    met: Sequence[PlanInputs],
    count: int,
    spread: float,
    grid: Array,
    rng: np.random.Generator,
) -> Iterator[Question]:
    """Carry some states of one drive elsewhere, those at which both robots can rest.

    Each is moved, and turned about the vertical, so that the way ahead stays within the box. The
    platform hangs there as it rests, and tensions differ from those of rest by as much as they did.

    Args:
        robot: The nominal robot, of fewer than six cables.
        met: States of the drive.
        count: States to draw.
        spread: One sigma of the centre of mass, per axis [m].
        grid: Times of a plan from now [s], shape (N + 1,).
        rng: Of all that is drawn.
    """
    own = np.median([inputs.center for inputs in met], axis=0)
    new = CENTERS_MAX * spread * rng.uniform(-1.0, 1.0, 3)
    carried = []
    for k in rng.choice(len(met), size=min(count, len(met)), replace=False):
        there = _carried(robot, met[k], new - own, rng)
        if there is not None:
            carried.append((met[k], there))
    if not carried:
        return
    usual_place = np.array([[_usual_place(inputs) for inputs in pair] for pair in carried])
    ends = np.array([there.target[[0, -1]] for _, there in carried])
    rest = _rest(robot, np.concatenate([ends[:, 0], ends[:, 1], usual_place[:, 1]]), np.zeros(3))
    loaded = _rest(robot, np.concatenate([ends[:, 0], usual_place[:, 1]]), new)
    before = _rest(robot, usual_place[:, 0], own)
    first, last, nominal = np.split(rest.tension, 3)
    hanging, (_, used) = np.split(loaded.rotation, 2)[0], np.split(loaded.tension, 2)
    found = before.converged & np.all(
        [*np.split(rest.converged, 3), *np.split(loaded.converged, 2)], axis=0
    )
    share = (grid[:-1] / grid[-1])[:, None]
    for k in np.flatnonzero(found):
        here, there = carried[k]
        usual = used[k] + here.usual_tension - before.tension[k]
        if (usual < robot.tension_min).any():
            continue  # no drive gets there
        inputs = replace(there, rotation=hanging[k], usual_tension=usual)
        geometry = geometry_at(robot, inputs.position, inputs.rotation)
        yield Question(
            inputs=inputs,
            rest=(1.0 - share) * first[k] + share * last[k],
            habit=usual - nominal[k],
            surplus=excess_at(robot, inputs.position, inputs.rotation, usual, geometry),
        )


def _carried(
    robot: Robot, inputs: PlanInputs, center: Array, rng: np.random.Generator
) -> PlanInputs | None:
    """Move and turn a state; None: its way is too long for the box."""
    for _ in range(TURN_TRIES_MAX):
        turn = Rotation.from_rotvec([0.0, 0.0, rng.uniform(-np.pi, np.pi)]).as_matrix()
        way = (inputs.target - inputs.target[0]) @ turn.T
        low, high = robot.workspace_min - way.min(axis=0), robot.workspace_max - way.max(axis=0)
        if (low < high).all():
            break
    else:
        return None
    share = rng.uniform(0.0, 1.0, 3)
    if rng.uniform() < FACE_SHARE:
        depth = rng.uniform(0.0, FACE_DEPTH)
        share[rng.integers(3)] = depth if rng.uniform() < 0.5 else 1.0 - depth
    place = low + share * (high - low)
    both = np.kron(np.eye(2), turn)  # of linear and angular
    return replace(
        inputs,
        position=place + turn @ (inputs.position - inputs.target[0]),
        twist=both @ inputs.twist,
        target=place + way,
        target_velocity=inputs.target_velocity @ turn.T,
        center=inputs.center + center,
        acceleration=both @ inputs.acceleration,
        usual_place=turn @ inputs.usual_place,
    )


def _usual_place(inputs: PlanInputs) -> Array:
    """Return where the reference was in the last half second [m], shape (3,)."""
    return np.asarray(inputs.target[0] + inputs.usual_place)


def _rest(robot: Robot, places: Array, center: Array) -> statics.Equilibrium:
    """Return rests at places (K, 3) [m], with a centre of mass (3,) beside the robot's [m]."""
    loaded = replace(robot, center_of_mass=robot.center_of_mass + center)
    return statics.inverse_kinematics(loaded, places)
