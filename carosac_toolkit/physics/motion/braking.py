r"""The controlled stop of winches at a fixed period, and the commands that leave room for it.

Commanded lengths :math:`L_k` at period :math:`h` define, by differences,

.. math:: v_k = (L_k - L_{k-1}) / h, \quad a_k = (v_k - v_{k-1}) / h, \quad
          j_k = (a_k - a_{k-1}) / h.

Let :math:`n(v, a)` be the speed left once :math:`a` was taken to zero in steps of at most
:math:`j_{max} h`. The controlled stop takes, at every period, the acceleration :math:`a'` within
:math:`[a - j_{max} h, a + j_{max} h] \cap [-a_{max}, a_{max}]` for which
:math:`n(v + a' h, a') = 0`, or the end of that interval which comes closest. It ends at
:math:`v = a = 0` exactly, after finitely many periods. A motion is *admissible* if the controlled
stop that follows it keeps every limit until it is at rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.physics import warp_setup
from carosac_toolkit.physics.motion import braking_kernels, stop_kernels
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

SETTLE_ROUNDINGS = 5.0  # of a length, by which a shortened step may end beyond its target
BOX_SLACK = Scaled(1e-9, "m")  # accuracy of the straight-line position
_MACHINE_EPSILON = 2.0**-52
_MOTION_FIELDS = ("length", "speed", "acceleration", "position")
_CABLE_BUFFERS = (
    "length", "speed", "acceleration", "asked", "pace", "pace_change", "actual", "brake_length",
    "base_length", "base_speed", "base_acceleration", "share", "base_end", "walk_length",
    "walk_speed", "walk_acceleration", "sent_length", "sent_speed", "sent_acceleration", "low",
    "high", "peak",
)  # fmt: skip


class WinchMotion(NamedTuple):
    """Commanded motion of the winches.

    Attributes:
        length: Unstrained length [m], shape (B, n).
        speed: Its difference to the one before, by the period [m/s], shape (B, n).
        acceleration: The same of the speed [m/s^2], shape (B, n).
        position: Straight-line position of the platform origin in W [m], shape (B, 3); followed
            only where the box counts.
    """

    length: Array
    speed: Array
    acceleration: Array
    position: Array


class Extremes(NamedTuple):
    """Extremes of a motion followed by the controlled stop.

    Attributes:
        low: Shortest length [m], shape (B, n).
        high: Longest length [m], shape (B, n).
        speed: Largest speed [m/s], shape (B, n).
        outside: Largest distance of the straight-line position beyond a face of the workspace box
            [m], shape (B,); infinite where no position fits the lengths.
    """

    low: Array
    high: Array
    speed: Array
    outside: Array


@dataclass(frozen=True, kw_only=True)
class Slack:
    """Rounding error of lengths in double precision and its derivatives, plus 1e-12 of each limit.

    Attributes:
        length: [m].
        speed: [m/s].
        acceleration: [m/s^2].
        jerk: [m/s^3].
    """

    length: float
    speed: float
    acceleration: float
    jerk: float

    @classmethod
    def of(cls, robot: Robot, jerk_max: float, period: float) -> Slack:
        """Return the slack of a robot's winches at a period [s]."""
        grain = 4.0 * _MACHINE_EPSILON * float(robot.length_max.max())
        return cls(
            length=grain,
            speed=grain / period + 1e-12 * float(robot.speed_max.min()),
            acceleration=2.0 * grain / period**2 + 1e-12 * float(robot.acceleration_max.min()),
            jerk=4.0 * grain / period**3 + 1e-12 * jerk_max,
        )


class Brakes:
    """Controlled stops of a batch of B robots of n cables, compiled, with their buffers."""

    def __init__(
        self, robot: Robot, size: int, *, period: float, jerk_max: float, jump_max: float, box: bool
    ) -> None:
        """Allocate.

        Args:
            robot: Robot description, n cables.
            size: Batch B.
            period: Time between two commands [s].
            jerk_max: [m/s^3].
            jump_max: Largest distance of a command from the measured length [m].
            box: True if the straight-line position must stay in the workspace box.
        """
        warp_setup.load(braking_kernels)
        self.slack = Slack.of(robot, jerk_max, period)
        rules = stop_kernels.Rules()
        rules.period, rules.jerk_max, rules.jump_max = period, jerk_max, jump_max
        _fill_rules(rules, robot, self.slack)
        rules.steps_max, rules.use_box = most_steps(robot, jerk_max, period), int(box)
        work = stop_kernels.StopWork()
        arrays = {
            name: wp.zeros((size, robot.n), dtype=wp.float64, device="cpu")
            for name in _CABLE_BUFFERS
        }
        arrays |= {
            k: wp.zeros(size, dtype=wp.vec3d, device="cpu") for k in ("position", "sent_position")
        }
        arrays["outside"] = wp.zeros(size, dtype=wp.float64, device="cpu")
        arrays["use_actual"] = wp.zeros(1, dtype=wp.int32, device="cpu")
        for name, array in arrays.items():
            setattr(work, name, array)
        self._views: dict[str, NDArray[Any]] = {k: a.numpy() for k, a in arrays.items()}
        self._launches = {
            kernel.key: wp.launch(kernel, size, inputs=[work, rules], device="cpu", record_cmd=True)
            for kernel in (
                braking_kernels.limit_step, braking_kernels.brake_all, braking_kernels.look_ahead
            )
        }  # fmt: skip

    def limit(
        self, motion: WinchMotion, asked: Array, pace: Array, pace_change: Array,
        actual: Array | None,
    ) -> WinchMotion:  # fmt: skip
        """Return the asked step if it is admissible and can be kept, else one as far towards it.

        Args:
            motion: Current motion of the winches, admissible.
            asked: Lengths [m], shape (B, n).
            pace: Speed of the asked lengths [m/s], shape (B, n).
            pace_change: Their acceleration [m/s^2], shape (B, n).
            actual: Measured lengths [m], shape (B, n), or None: the jump limit does not count.

        Returns:
            The motion after the step.
        """
        self._put(motion)
        self._views["asked"][...] = asked
        self._views["pace"][...] = pace
        self._views["pace_change"][...] = pace_change
        self._views["use_actual"][...] = actual is not None
        if actual is not None:
            self._views["actual"][...] = actual
        self._launches["limit_step"].launch()
        return self._sent()

    def stop(self, motion: WinchMotion) -> WinchMotion:
        """Return the next step of the controlled stop."""
        self._put(motion)
        self._launches["brake_all"].launch()
        return self._sent()

    def look_ahead(self, motion: WinchMotion) -> Extremes:
        """Return the extremes of a motion until it is at rest.

        A row that exceeds a speed or an acceleration now is looked at where it is now only.
        """
        self._put(motion)
        self._launches["look_ahead"].launch()
        return Extremes(*(self._views[name].copy() for name in ("low", "high", "peak", "outside")))

    def _put(self, motion: WinchMotion) -> None:
        """Copy a motion in."""
        for name, value in zip(_MOTION_FIELDS, motion, strict=True):
            self._views[name][...] = value

    def _sent(self) -> WinchMotion:
        """Copy the motion after a step out."""
        return WinchMotion(*(self._views[f"sent_{name}"].copy() for name in _MOTION_FIELDS))


def box_slack(robot: Robot) -> float:
    """Return by how much a straight-line position may be outside the workspace box [m]."""
    return BOX_SLACK.of(Scales(robot).ratios)


def most_steps(robot: Robot, jerk_max: float, period: float) -> int:
    """Return a bound on the periods that any controlled stop needs from within the limits."""
    jump, a_max = jerk_max * period, robot.acceleration_max
    speed = 2.0 * robot.speed_max + a_max * (a_max / jump + 2.0) * period  # after ramping a down
    ramps = 2.0 * a_max / jump + 2.0 * np.sqrt(2.0 * speed / (jump * period))
    return int(np.ceil(2.0 * (ramps + speed / (a_max * period)).max())) + 100


def _fill_rules(rules: Any, robot: Robot, slack: Slack) -> None:
    """Fill in geometry, limits of the robot and slacks, for the kernels."""
    for name in ("exit_points", "anchor_points", "swivel_axis"):
        setattr(rules, name, wp.array(getattr(robot, name), dtype=wp.vec3d, device="cpu"))
    for name in ("pulley_radius", "length_min", "length_max", "speed_max", "acceleration_max"):
        setattr(rules, name, wp.array(getattr(robot, name), dtype=wp.float64, device="cpu"))
    rules.rotation = wp.mat33d(robot.home_rotation)
    rules.box_min, rules.box_max = wp.vec3d(robot.workspace_min), wp.vec3d(robot.workspace_max)
    rules.length_slack, rules.speed_slack = slack.length, slack.speed
    rules.acceleration_slack, rules.jerk_slack = slack.acceleration, slack.jerk
    rules.settle_slack, rules.box_slack = SETTLE_ROUNDINGS * slack.length, box_slack(robot)
