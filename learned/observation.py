"""Observation of a policy: named parts of one vector, in units of the workspace.

The same functions look at an environment while training and at a belief while driving, so a policy
sees the same numbers in both.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.numbers import check_fields
from carosac_toolkit.physics.cable.straight_line import inverse_kinematics
from carosac_toolkit.robot.robot import Robot

LENGTH_MARGIN_RATIO = 0.02  # of their range, beyond the lengths of the workspace box
LENGTH_GRID_POINTS = 9  # along each edge of the box, to find the range of lengths


@dataclass(frozen=True, kw_only=True)
class ObservationUnits:
    """Units of an observation, which count as 1; kept with a policy.

    Attributes:
        error: Distance from the target [m].
        speed_error: Speed against the target [m/s].
        ahead: Distance of later targets from the present one [m].
        speed: [m/s].
        acceleration: [m/s^2].
        tilt: Sine of the angle of the platform's z axis to the vertical [-].
        turn: Angular speed [rad/s].
    """

    error: float = 0.1
    speed_error: float = 0.3
    ahead: float = 0.5
    speed: float = 1.0
    acceleration: float = 1.0
    tilt: float = 0.2
    turn: float = 1.0

    def __post_init__(self) -> None:
        """Refuse units that are not positive."""
        names = ("error", "speed_error", "ahead", "speed", "acceleration", "tilt", "turn")
        check_fields(self, positive=names)


@dataclass(frozen=True, kw_only=True, eq=False)
class ObservationInputs:
    """Everything that can be observed of B robots with n cables.

    Attributes:
        position: Platform origin in W [m], shape (B, 3).
        rotation: From P to W, shape (B, 3, 3).
        twist: Linear [m/s], then angular [rad/s], in W at the platform origin, shape (B, 6).
        length: Unstrained lengths, as asked for last [m], shape (B, n).
        due: Where the platform origin should be now, in W [m], shape (B, 3); of set-points that
            settle, the target.
        due_velocity: [m/s], shape (B, 3).
        target: Where it shall be at the end of the step, in W [m], shape (B, 3).
        target_velocity: [m/s], shape (B, 3).
        target_acceleration: [m/s^2], shape (B, 3).
        aimed_acceleration: The same, as much later as lengths are aimed ahead of the target for the
            lag of the winches [m/s^2], shape (B, 3).
        preview: Where it shall be after that, in W [m], shape (B, K, 3).
        last_action: What was applied last, in [-1, 1], shape (B, a).
        mean_error: Fading mean of position less due since the start, see `fading` [m], (B, 3).
        lasting_error: The same, with the longer memory of the correction [m], shape (B, 3).
    """

    position: Array
    rotation: Array
    twist: Array
    length: Array
    due: Array
    due_velocity: Array
    target: Array
    target_velocity: Array
    target_acceleration: Array
    aimed_acceleration: Array
    preview: Array
    last_action: Array
    mean_error: Array
    lasting_error: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class ObservationScales:
    """The workspace box and the lengths in it, which count as -1 to 1.

    Attributes:
        center: Middle of the box in W [m], shape (3,).
        half: Half its edges [m], shape (3,).
        length_low: Shortest straight-line lengths in the box [m], less a margin, shape (n,).
        length_high: Longest ones [m], and a margin, shape (n,).
        units: What counts as 1 where the box is no measure.
    """

    center: Array
    half: Array
    length_low: Array
    length_high: Array
    units: ObservationUnits

    @classmethod
    def of(cls, robot: Robot, units: ObservationUnits | None = None) -> ObservationScales:
        """Measure the workspace of a robot; without units take the default ones."""
        low, high = robot.workspace_min, robot.workspace_max
        axes = [np.linspace(a, b, LENGTH_GRID_POINTS) for a, b in zip(low, high, strict=True)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        lengths = inverse_kinematics(robot, points)
        least, most = lengths.min(axis=0), lengths.max(axis=0)
        room = LENGTH_MARGIN_RATIO * (most - least)
        return cls(
            center=(low + high) / 2, half=(high - low) / 2,
            length_low=least - room, length_high=most + room,
            units=units or ObservationUnits(),
        )  # fmt: skip

    def to_length(self, action: Array) -> Array:
        """Convert actions in [-1, 1] to lengths [m], shape (B, n)."""
        return self.length_low + (action + 1.0) / 2.0 * (self.length_high - self.length_low)

    def to_action(self, length: Array) -> Array:
        """Convert lengths [m] to actions, shape (B, n)."""
        return 2.0 * (length - self.length_low) / (self.length_high - self.length_low) - 1.0

    def to_unit(self, position: Array) -> Array:
        """Convert positions in W [m] to shares of the box, (..., 3)."""
        return (position - self.center) / self.half


def _tilt(look: ObservationInputs, scales: ObservationScales) -> Array:
    """Return the horizontal components of the platform's z axis, in W."""
    return look.rotation[:, :2, 2] / scales.units.tilt


OBSERVATION_PARTS: dict[str, Callable[[ObservationInputs, ObservationScales], Array]] = {
    "length": lambda look, scales: scales.to_action(look.length),
    "position": lambda look, scales: scales.to_unit(look.position),
    "target": lambda look, scales: scales.to_unit(look.target),
    "error": lambda look, scales: (look.position - look.due) / scales.units.error,
    "velocity_error": lambda look, scales: (
        (look.twist[:, :3] - look.due_velocity) / scales.units.speed_error
    ),
    "velocity": lambda look, scales: look.twist[:, :3] / scales.units.speed,
    "tilt": _tilt,
    "turn": lambda look, scales: look.twist[:, 3:] / scales.units.turn,
    "target_velocity": lambda look, scales: look.target_velocity / scales.units.speed,
    "target_acceleration": lambda look, scales: (
        look.target_acceleration / scales.units.acceleration
    ),
    "preview": lambda look, scales: (
        (look.preview - look.target[:, None]).reshape(len(look.target), -1) / scales.units.ahead
    ),
    "last_action": lambda look, scales: look.last_action,
    "mean_error": lambda look, scales: look.mean_error / scales.units.error,
}


TWIST_PARTS = {"velocity", "velocity_error", "turn"}  # parts that need a twist
# Parts that `ObservationUnits` scale.
SCALED_PARTS = {
    *TWIST_PARTS,
    "error",
    "mean_error",
    "tilt",
    "target_velocity",
    "target_acceleration",
    "preview",
}


def check_parts(parts: Sequence[str]) -> None:
    """Refuse an observation of nothing, or of unknown or repeated parts."""
    if not parts:
        raise InvalidField("observation", "no parts", f"some of {sorted(OBSERVATION_PARTS)}")
    for k, name in enumerate(parts):
        if name not in OBSERVATION_PARTS or name in parts[:k]:
            allowed = f"one of {sorted(OBSERVATION_PARTS)}, each once"
            raise InvalidField(f"observation[{k}]", repr(name), allowed)


def observe(parts: Sequence[str], look: ObservationInputs, scales: ObservationScales) -> Array:
    """Return the parts side by side, shape (B, d)."""
    return np.concatenate([OBSERVATION_PARTS[name](look, scales) for name in parts], axis=1)


def fading(mean: Array, error: Array, period: float, memory: float) -> Array:
    """Add an error to a fading mean, shape (B, 3).

    It starts at zero, so a constant error is seen in full after a few times the memory only.

    Args:
        mean: Before it [m], shape (B, 3).
        error: Of the look [m], shape (B, 3).
        period: Between two looks [s].
        memory: Time after which a look counts by 1 / e of what it counted [s].
    """
    return np.asarray(mean + (1.0 - math.exp(-period / memory)) * (error - mean))


def slices(parts: Sequence[str], n: int, previews: int, actions: int) -> dict[str, slice]:
    """Return the place of each part in the observation.

    Args:
        parts: Names.
        n: Number of cables.
        previews: Number of later targets.
        actions: Size of the action.
    """
    sizes = {
        "length": n, "position": 3, "target": 3, "error": 3, "velocity_error": 3, "velocity": 3,
        "tilt": 2, "turn": 3, "target_velocity": 3, "target_acceleration": 3,
        "preview": 3 * previews, "last_action": actions, "mean_error": 3,
    }  # fmt: skip
    ends = np.cumsum([0, *(sizes[name] for name in parts)])
    return {name: slice(int(ends[k]), int(ends[k + 1])) for k, name in enumerate(parts)}
