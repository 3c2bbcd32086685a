"""What a plan depends on, as numbers that mean the same for every robot of the family.

Lengths of the robot are in that of a cable, L, its times in sqrt(L / g), forces in the weight per
cable; what is of the platform is in its own size, and its turning in the time of a pendulum of that
size. Errors and the way ahead are in g T^2 and g T, where T is the unit of time in which all robots
have the same weights of MPC, so that plans answer them alike. What a network would have to multiply
is told as well. `free` and `turning` are the accelerations at rest tensions and habit. `pulls` are
the least tensions in the directions of the cables that add up to an error, a part of the way, an
acceleration. `rates` are what spin, `turning` and the moment give along each cable by turning about
the centre of mass, and the velocity error along it.

Cables are numbered, and axes turned, as `layout_of` says.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from itertools import accumulate, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.mpc.plan_times import settings_for
from baselines.mpc.settings import MpcSettings
from baselines.mpc.target_reader import rests
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot
from learned.approximate_mpc.family_robots import CABLES, family_settings, layout_of
from learned.approximate_mpc.plan_inputs import PlanInputs, UnreadableInputs

TIMES = MpcSettings().stages + 1  # of a plan
# A change of these makes another network of the same file: raise `FAMILY_SCHEMA` with them.
AHEAD = (0, 2, 4, 6, 8, 10, 13, 16, 20)  # times of a plan for which pulls are told
TURNING_MAX = 10.0  # of `turning`, over g and the size of the platform: what spins is lost
CHANGE_MAX = 6.0  # of a tension from that of rest, in the weight per cable: an output of 1
# Numbers of each block: of vectors, of axial vectors, of cables, of scalars. A mirror image turns
# each kind in its way.
BLOCKS = {
    "directions": ("vectors of cables", 3 * CABLES),
    "lengths": ("cables", CABLES),
    "arms": ("vectors of cables", 3 * CABLES),
    "center": ("vectors", 3),
    "inertia": ("tensor", 6),
    "velocity_error": ("vectors", 3),
    "velocity": ("vectors", 3),
    "spin": ("axial vectors", 3),
    "way": ("vectors", 3 * TIMES),
    "way_velocity": ("vectors", 3 * TIMES),
    "push": ("vectors", 3),
    "moment": ("axial vectors", 3),
    "rest": ("cables", CABLES),
    "rest_at_end": ("cables", CABLES),
    "habit": ("cables", CABLES),
    "robot": ("scalars", 11),
    "free": ("vectors", 3),
    "turning": ("axial vectors", 3),
    "pulls": ("cables", (2 * len(AHEAD) + 2) * CABLES),
    "rates": ("cables", 4 * CABLES),
}
UP = np.array([0.0, 0.0, 1.0])
_EDGES = [0, *accumulate(count for _, count in BLOCKS.values())]
PLACES: Mapping[str, slice] = {
    name: slice(a, b) for name, (a, b) in zip(BLOCKS, pairwise(_EDGES), strict=True)
}
COUNT = _EDGES[-1]
_TENSOR = ((0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2))  # rows and columns of the six entries


class FamilyNumbers:
    """Turns inputs into the numbers that a network of the family reads, and back what it tells."""

    def __init__(self, robot: Robot) -> None:
        """Take a robot of the family."""
        chosen, weight_time = settings_for(robot, family_settings(robot))
        scales, layout = Scales(robot), layout_of(robot)
        self._robot, self._order, self._turn = robot, layout.order, layout.turn
        self._length, self._time, self._tension = scales.length, scales.time, scales.tension
        self._error_unit = robot.gravity * weight_time**2
        self._speed_unit = robot.gravity * weight_time
        self._size = float(np.linalg.norm(robot.anchor_points, axis=1).max())
        self._moment = self._size / robot.gravity
        tension, speed = self._tension, self._length / self._time
        shares = (
            self._size / self._length, self._time, chosen.period / self._time,
            chosen.lookahead / self._time, weight_time / self._time,
            robot.tension_min.mean() / tension, robot.tension_max.mean() / tension,
            robot.speed_max.mean() / speed, robot.acceleration_max.mean() / robot.gravity,
            robot.weight_per_length.mean() * self._length / tension,
        )  # fmt: skip
        self._shares = np.array([*np.log(shares), robot.drag * self._time / robot.mass])
        self._inertia = robot.inertia / (robot.mass * self._size**2)
        self._rest: Array | None = None
        self._where: Array = np.full((3, 3), np.nan)

    def count(self, stages: int) -> int:
        """Return how many numbers these are; plans of the family all have as many stages."""
        return COUNT

    def of(self, inputs: PlanInputs) -> Array:
        """Return the numbers, shape (COUNT,).

        Raises:
            UnreadableInputs: A pose that is not finite.
        """
        robot, order, axes = self._robot, self._order, self._turn
        arms = (robot.anchor_points[order] @ inputs.rotation.T) @ axes.T
        place, velocity = axes @ inputs.position, axes @ inputs.twist[:3] / self._speed_unit
        chord = robot.exit_points[order] @ axes.T - place - arms
        distance = np.linalg.norm(chord, axis=1)
        if not np.isfinite(distance).all():
            raise UnreadableInputs("a pose that is not finite")
        along, turned = chord / distance[:, None], axes @ inputs.rotation
        center = turned @ (robot.center_of_mass + inputs.center) / self._size
        inertia = turned @ self._inertia @ turned.T
        rest = self._rests(inputs) / self._tension
        habit = (inputs.usual_tension / self._tension - rest[2])[order]
        wanted = inputs.target_velocity @ axes.T / self._speed_unit
        behind = velocity - wanted[0]
        spin = axes @ inputs.twist[3:] * np.sqrt(self._moment)
        way, faster = (inputs.target @ axes.T - place) / self._error_unit, wanted - wanted[0]
        push = axes @ inputs.acceleration[:3] / robot.gravity
        moment = axes @ inputs.acceleration[3:] * self._moment
        levers = np.cross(arms / self._size - center, along)
        base = (rest[0, order] + habit) / CABLES
        free = base @ along - UP
        turning = np.linalg.solve(inertia, base @ levers)
        turning = np.minimum(np.maximum(turning, -TURNING_MAX), TURNING_MAX)
        pulled = np.vstack([behind, push, way[AHEAD, :], faster[AHEAD[1:], :], free + push])
        numbers: Array = np.concatenate([
            along.ravel(), np.log(distance / self._length), arms.ravel() / self._size, center,
            inertia[_TENSOR], behind, velocity, spin, way.ravel(), faster.ravel(), push, moment,
            rest[0, order], rest[1, order], habit, self._shares, free, turning,
            (np.linalg.pinv(along.T) @ pulled.T).ravel(),
            np.column_stack([levers @ spin, levers @ turning, levers @ moment, along @ behind])
            .ravel(),
        ])  # fmt: skip
        return numbers

    def told(self, numbers: Array, tension: Array) -> Array:
        """Return tensions (n,) [N] as a network would tell them, shape (4,)."""
        return (tension[self._order] / self._tension - base_of(numbers)) / CHANGE_MAX

    def tension(self, numbers: Array, told: Array) -> Array:
        """Return the tensions [N] that a network tells, shape (n,)."""
        found = np.empty(CABLES)
        found[self._order] = (base_of(numbers) + CHANGE_MAX * told) * self._tension
        return found

    def _rests(self, inputs: PlanInputs) -> Array:
        """Return tensions of rest [N] where the plan begins and ends, and at the usual place."""
        target = inputs.target
        where = np.stack([target[0], target[-1], target[0] + inputs.usual_place])
        if self._rest is None or not np.array_equal(where, self._where):
            self._where = where
            self._rest, _ = rests(self._robot, where, self._rest)
        return self._rest


def base_of(numbers: Array) -> Array:
    """Return the tensions, over the weight per cable, that a network's are told from, (..., 4)."""
    return np.asarray(numbers[..., PLACES["rest"]] + numbers[..., PLACES["habit"]])


class Mirror(NamedTuple):
    """How numbers of a robot become those of its mirror image: reordered, then multiplied.

    Attributes:
        order: Of the numbers, shape (COUNT,).
        sign: Of each, shape (COUNT,).
        cables: Order of what is told, shape (4,).
    """

    order: NDArray[np.intp]
    sign: Array
    cables: NDArray[np.intp]


def mirror(axes: Collection[int]) -> Mirror:
    """Return the mirror image along x (0), y (1), both or neither.

    What a network has seen of a robot is true of its mirror image, too.
    """
    cables = np.arange(CABLES).reshape(2, 2)  # (-, -) and (+, -), then (+, +) and (-, +)
    sign = np.ones(3)
    for axis in axes:
        sign[axis] = -1.0
        cables = cables[:, ::-1] if axis == 0 else cables[::-1, ::-1]
    order_of_cables, orders, signs = cables.ravel(), [], []
    for name, (kind, count) in BLOCKS.items():
        order, signed = np.arange(count), np.ones(count)
        if kind in ("cables", "vectors of cables"):
            order = order.reshape(CABLES, -1)[order_of_cables].ravel()
        if kind in ("vectors", "vectors of cables"):
            signed = np.tile(sign, count // 3)
        elif kind == "axial vectors":
            signed = np.prod(sign) * np.tile(sign, count // 3)
        elif kind == "tensor":
            signed = sign[list(_TENSOR[0])] * sign[list(_TENSOR[1])]
        orders.append(PLACES[name].start + order)
        signs.append(signed)
    return Mirror(np.concatenate(orders), np.concatenate(signs), order_of_cables)
