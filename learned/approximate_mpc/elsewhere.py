"""States of a drive carried to other places, with another centre of mass.

A drive sees one path and one plant. What a plan depends on beside these, the way ahead, the sway
and the forces of the last half second, is met as well anywhere else; so states of a drive become
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
    """What `Teacher.ask_anew` needs.

    Attributes:
        inputs: State, reference and load.
        rest: Tensions of rest, per stage [N], shape (N, n).
        habit: What tensions differ by from those of rest in the long run [N], shape (n,).
        surplus: Sag less stretch under usual tensions [m], shape (n,).
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

    Each is moved, and turned about the vertical, so that the way of the last half second and the
    way ahead stay within the box. The platform hangs there as it rests, but for the turn by which
    it did not hang so; usual tensions are those of rest and, besides, pull as they did, turned. The
    belief in the centre of mass is off by as much as it was.

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
        found = _carried(robot, met[k], new - own, rng)
        if found is not None:
            carried.append((met[k], *found))
    if not carried:
        return
    before = _rests(robot, [(here.target[0], _usual_place(here)) for here, _, _ in carried], own)
    after = _rests(robot, [(there.target[0], _usual_place(there)) for _, there, _ in carried], new)
    ends = [(there.target[0], there.target[-1], _usual_place(there)) for _, there, _ in carried]
    nominal = _rests(robot, ends, np.zeros(3))
    share = (grid[:-1] / grid[-1])[:, None]
    for (here, there, turn), old, now, usual in zip(carried, before, after, nominal, strict=True):
        if not (old.found and now.found and usual.found):
            continue
        away = turn @ here.rotation @ old.rotation[0].T @ turn.T
        inputs = replace(there, rotation=away @ now.rotation[0])
        geometry = geometry_at(robot, inputs.position, inputs.rotation)
        direction = geometry_at(robot, here.position, here.rotation).direction
        force = turn @ (direction.T @ (here.usual_tension - old.tension[1]))
        tension = now.tension[1] + np.linalg.pinv(geometry.direction.T) @ force
        if (tension < robot.tension_min).any() or (tension > robot.tension_max).any():
            continue  # no drive gets there
        yield Question(
            inputs=replace(inputs, usual_tension=tension),
            rest=(1.0 - share) * usual.tension[0] + share * usual.tension[1],
            habit=tension - usual.tension[2],
            surplus=excess_at(robot, inputs.position, inputs.rotation, tension, geometry),
        )


def _carried(
    robot: Robot, inputs: PlanInputs, center: Array, rng: np.random.Generator
) -> tuple[PlanInputs, Array] | None:
    """Move and turn a state; return the turn (3, 3) too. None: its way is too long for the box."""
    for _ in range(TURN_TRIES_MAX):
        turn = Rotation.from_rotvec([0.0, 0.0, rng.uniform(-np.pi, np.pi)]).as_matrix()
        way = (inputs.target - inputs.target[0]) @ turn.T
        whole = np.vstack([way, turn @ inputs.usual_place])
        low, high = robot.workspace_min - whole.min(axis=0), robot.workspace_max - whole.max(axis=0)
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
    there = replace(
        inputs,
        position=place + turn @ (inputs.position - inputs.target[0]),
        twist=both @ inputs.twist,
        target=place + way,
        target_velocity=inputs.target_velocity @ turn.T,
        center=inputs.center + center,
        acceleration=both @ inputs.acceleration,
        usual_place=turn @ inputs.usual_place,
    )
    return there, turn


def _usual_place(inputs: PlanInputs) -> Array:
    """Return where the reference was in the last half second [m], shape (3,)."""
    return np.asarray(inputs.target[0] + inputs.usual_place)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Rests:
    """Rests at k places.

    Attributes:
        tension: [N], shape (k, n).
        rotation: From P to W, shape (k, 3, 3).
        found: Whether there is one at each.
    """

    tension: Array
    rotation: Array
    found: bool


def _rests(robot: Robot, places: Sequence[tuple[Array, ...]], center: Array) -> list[_Rests]:
    """Return the rests of each group of places [m], with a centre of mass beside the robot's."""
    loaded = replace(robot, center_of_mass=robot.center_of_mass + center)
    groups = np.array(places)
    rest = statics.inverse_kinematics(loaded, groups.reshape(-1, 3))
    every = np.arange(groups.shape[0] * groups.shape[1]).reshape(groups.shape[:2])
    return [
        _Rests(
            tension=rest.tension[rows],
            rotation=rest.rotation[rows],
            found=bool(rest.converged[rows].all()),
        )
        for rows in every
    ]
