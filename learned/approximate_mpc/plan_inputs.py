"""What a plan depends on, as numbers that a network reads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from baselines.mpc.settings import Compiled
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot
from learned.approximate_mpc.packed_function import Expressions, PackedFunction

INPUT_MAX = 1e6  # of a number: no robot comes near it
HALF_TURN = 1e-12  # 1 + trace of a rotation, from which on rounding hides its axis
# A change of these makes other numbers of the same count: raise `PLAN_SCHEMA` with them.
PULLED_EVERY = 2  # of so many times of a plan, one has its pulls told
DAMPING = 1e-3  # of pulls: cables in one plane pull nothing out of it


class UnreadableInputs(InvalidField):
    """A state that no network can read: not finite, or far from all that a robot does."""

    def __init__(self, value: object) -> None:
        super().__init__("plan inputs", value, f"numbers up to {INPUT_MAX:g}")


@dataclass(frozen=True, kw_only=True, eq=False)
class PlanInputs:
    """State, reference and what is known of the load, N stages.

    Attributes:
        position: Platform origin in W [m], shape (3,).
        rotation: From P to W, shape (3, 3).
        twist: Linear first, in W, at the origin, shape (6,).
        target: Reference at the times of the plan from now on [m], shape (N + 1, 3).
        target_velocity: [m/s], shape (N + 1, 3).
        center: Of mass, from that of the robot file, in P [m], shape (3,).
        acceleration: That the model does not know, in W [m/s^2, rad/s^2], shape (6,).
        usual_tension: Of the last half second, along the chords [N], shape (n,).
        usual_place: Reference of the same time, from now [m], shape (3,).
    """

    position: Array
    rotation: Array
    twist: Array
    target: Array
    target_velocity: Array
    center: Array
    acceleration: Array
    usual_tension: Array
    usual_place: Array


class PlanReader(Protocol):
    """Turns inputs into the numbers that some network reads."""

    def count(self, stages: int) -> int:
        """Return how many numbers these are, for a plan of some stages."""

    def of(self, inputs: PlanInputs) -> Array:
        """Return the numbers, shape (m,)."""


PlanCallback = Callable[[PlanInputs], tuple[Array, Array]]
"""Gives the first tensions [N] of a plan, and sag less stretch [m] of these, each (n,)."""

TensionCallback = Callable[[PlanInputs], Array]
"""Gives the first tensions of a plan alone [N], shape (n,)."""


class PlanSource(Protocol):
    """A network that can drive.

    Attributes:
        tension_share: See `learned.approximate_mpc.controller.PlanFollower`.
    """

    tension_share: float

    def planner(self, robot: Robot) -> PlanCallback:
        """Return what plans for a robot."""


def input_count(robot: Robot, stages: int) -> int:
    """Return how many numbers `PlanNumbers` gives."""
    return sum(count for _, count in _blocks(robot, stages))


def input_units(robot: Robot, stages: int) -> Array:
    """Return the units of the numbers of `PlanNumbers`, over those on ``carosac``."""
    ratios = Scales(robot).ratios
    return np.concatenate(
        [np.full(count, ratios.of_unit(unit)) for unit, count in _blocks(robot, stages)]
    )


def _blocks(robot: Robot, stages: int) -> tuple[tuple[str, int], ...]:
    """Return the unit of each block of numbers, and how many these are."""
    n, ahead = robot.n, 3 * (stages + 1)
    pulled = n * len(range(0, stages + 1, PULLED_EVERY))
    return (
        ("1", n), ("1", 3), ("rad", 3), ("m/s", 3), ("rad/s", 3), ("m", ahead), ("m/s", ahead),
        ("m", 3), ("m/s^2", 3), ("rad/s^2", 3), ("m", 3), ("1", 3 * n), ("1", n),
        ("m/s^2", 3), ("rad/s^2", 3), ("m", pulled), ("m/s", pulled), ("m/s^2", 2 * n),
        ("m/s", n), ("m/s^2", 2 * n), ("m/s", n),
    )  # fmt: skip


class PlanNumbers:
    """Turns inputs into the numbers that a network reads, for one robot.

    Beside the inputs, they are what a network would have to multiply: directions and distances of
    the exit points, what accelerations usual tensions give along these (`free` and `turning`),
    least tensions that add up to a part of the way, of its velocity or of an acceleration
    (`pulls`), and how fast the platform turns along each cable (`levers`). Pulleys and cables that
    ride along are left out of them: they are hints, and plans follow from the equations of MPC.
    """

    def __init__(self, robot: Robot, stages: int, compiled: Compiled = "never") -> None:
        """Build the function for a robot and plans of some stages.

        Args:
            robot: Of n cables.
            stages: Of a plan.
            compiled: As in `MpcSettings`.
        """
        self._robot = robot
        self._function = PackedFunction(*_numbers(robot, stages + 1), compiled)

    def count(self, stages: int) -> int:
        """Return how many numbers these are, for a plan of some stages."""
        return input_count(self._robot, stages)

    def of(self, inputs: PlanInputs) -> Array:
        """Return the numbers (m,), in units of the robot where they have any."""
        return self._function(
            inputs.position, inputs.rotation.ravel(), inputs.twist, inputs.target.ravel(),
            inputs.target_velocity.ravel(), inputs.center, inputs.acceleration,
            inputs.usual_tension, inputs.usual_place,
        )  # fmt: skip


def usual_tension(robot: Robot, numbers: Array) -> Array:
    """Return the usual tensions [N] (..., n) that are in numbers (..., m) of `PlanNumbers`."""
    return np.asarray(numbers[..., : robot.n] * (robot.weight / robot.n))


def _numbers(robot: Robot, times: int) -> Expressions:
    """Return inputs and numbers, in the order of `_blocks`, for a plan of so many times."""
    import casadi as ca

    position, velocity, spin, center, push, turned, place = (ca.SX.sym("x", 3) for _ in range(7))
    turn, target, speed = ca.SX.sym("r", 9), ca.SX.sym("w", 3 * times), ca.SX.sym("v", 3 * times)
    usual = ca.SX.sym("t", robot.n)
    rotation = ca.reshape(turn, 3, 3).T  # it was told row by row
    middle = 0.5 * (robot.workspace_min + robot.workspace_max)
    half = 0.5 * (robot.workspace_max - robot.workspace_min)
    arms = ca.DM(robot.anchor_points) @ rotation.T
    chord = ca.DM(robot.exit_points) - ca.repmat(position.T, robot.n, 1) - arms
    distance = ca.sqrt(ca.sum2(chord**2))
    along = chord / ca.repmat(distance, 1, 3)
    offset = rotation @ (ca.DM(robot.center_of_mass) + center)
    levers = ca.vertcat(*(
        ca.cross(arms[i, :].T - offset, along[i, :].T).T for i in range(robot.n)
    ))  # fmt: skip
    free = along.T @ usual / robot.mass - ca.DM([0.0, 0.0, robot.gravity])
    inverse = rotation @ ca.DM(np.linalg.inv(robot.inertia)) @ rotation.T
    turning = inverse @ (levers.T @ usual)
    way = ca.reshape(target, 3, times) - ca.repmat(position, 1, times)
    faster = ca.reshape(speed, 3, times) - ca.repmat(velocity, 1, times)
    some = list(range(0, times, PULLED_EVERY))
    pulled = ca.horzcat(way[:, some], faster[:, some], push, free + push)
    least = along @ ca.solve(along.T @ along + DAMPING * ca.DM.eye(3), pulled)
    numbers = [
        usual * (robot.n / robot.weight), (position - middle) / half,
        _small_turn(rotation @ ca.DM(robot.home_rotation.T)), velocity, spin,
        ca.vec(way), ca.vec(faster), center, push, turned, place, ca.vec(along),
        ca.log(distance / Scales(robot).length), free, turning, ca.vec(least),
        levers @ spin, levers @ turning, levers @ turned, along @ faster[:, 0],
    ]  # fmt: skip
    inputs = [
        position, turn, ca.vertcat(velocity, spin), target, speed, center,
        ca.vertcat(push, turned), usual, place,
    ]  # fmt: skip
    return "numbers", inputs, numbers


def _small_turn(rotation: Any) -> Any:
    """Return the modified Rodrigues parameters (3,); NaN, which is refused, at half a turn."""
    import casadi as ca

    square = 1.0 + ca.trace(rotation)
    root = ca.sqrt(ca.if_else(square > HALF_TURN, square, np.nan))  # twice the scalar part
    vector = ca.vertcat(
        rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0],
        rotation[1, 0] - rotation[0, 1],
    )  # fmt: skip
    return vector / (root * (2.0 + root))
