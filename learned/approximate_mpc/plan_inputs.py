"""What a plan depends on, as numbers that a network reads."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from baselines.mpc import model
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

HALF_TURN = 1e-6  # 1 + trace of a rotation, which is 0 at half a turn


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
    ahead = 3 * (stages + 1)
    return (
        ("1", 3), ("rad", 3), ("m/s", 3), ("rad/s", 3), ("m", ahead), ("m/s", ahead),
        ("m", 3), ("m/s^2", 3), ("rad/s^2", 3), ("1", robot.n), ("m", 3),
    )  # fmt: skip


class PlanNumbers:
    """Turns inputs into the numbers that a network reads, for one robot."""

    def __init__(self, robot: Robot) -> None:
        """Take the robot's box and home."""
        self._robot = robot
        self._middle = 0.5 * (robot.workspace_min + robot.workspace_max)
        self._unit = 2.0 / (robot.workspace_max - robot.workspace_min)
        self._home = np.ascontiguousarray(robot.home_rotation.T)
        self._share = robot.n / robot.weight
        self._usual = slice(-3 - robot.n, -3)

    def count(self, stages: int) -> int:
        """Return how many numbers these are, for a plan of some stages."""
        return input_count(self._robot, stages)

    def of(self, inputs: PlanInputs) -> Array:
        """Return the numbers, in units of the robot where they have any."""
        return np.concatenate([
            (inputs.position - self._middle) * self._unit,
            _small_turn(inputs.rotation @ self._home),
            inputs.twist,
            (inputs.target - inputs.position).ravel(),
            (inputs.target_velocity - inputs.twist[:3]).ravel(),
            inputs.center,
            inputs.acceleration,
            inputs.usual_tension * self._share,
            inputs.usual_place,
        ])  # fmt: skip

    def usual_tension(self, numbers: Array) -> Array:
        """Return the usual tensions [N] (..., n) that are in numbers (..., m)."""
        return np.asarray(numbers[..., self._usual] / self._share)


def _small_turn(rotation: Array) -> Array:
    """Return the modified Rodrigues parameters (3,) of less than half a turn."""
    (a, d, e), (f, b, g), (h, k, c) = rotation.tolist()
    square = 1.0 + a + b + c
    if square < HALF_TURN:  # which no network has seen
        return model.parameters_of(rotation)
    root = math.sqrt(square)  # of the quaternion: its scalar is root / 2, its vector (k - g, ...)
    share = 1.0 / (root * (2.0 + root))  # over 2 root
    return np.array([share * (k - g), share * (e - h), share * (f - d)])
