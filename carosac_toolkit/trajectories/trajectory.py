"""A timed path of the platform origin that can be sampled at any time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from carosac_toolkit.base.arrays import Array, batch, frozen_array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.values import Reference
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.trajectories.curves import Curve
from carosac_toolkit.trajectories.peaks import highest

BOX_MARGIN_M = 1e-9  # [m], rounding of positions


@dataclass(frozen=True, kw_only=True, eq=False)
class TrajectorySamples:
    """A trajectory at some times, all in world frame W.

    Attributes:
        time: [s], shape (B,).
        position: Platform origin [m], shape (B, 3).
        velocity: [m/s], shape (B, 3).
        acceleration: [m/s^2], shape (B, 3).
        jerk: [m/s^3], shape (B, 3).
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    jerk: Array


class Leaving(NamedTuple):
    """Where a trajectory leaves a workspace box most on one axis.

    Attributes:
        time: [s].
        field: Trajectory, axis and time in words.
        value: The coordinate with its unit.
        allowed: The box on this axis.
    """

    time: float
    field: str
    value: str
    allowed: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    """A curve run through in `duration`; before and after it the platform rests at its ends.

    Attributes:
        name: Kind of trajectory.
        curve: Over nominal time, which is stretched uniformly to the duration.
        duration: [s].
        points: Points that it passes, in W [m], shape (K, 3), or None.
        moved: How far the curve was moved onto positions at which the robot can rest, at most [m].
    """

    name: str
    curve: Curve
    duration: float
    points: Array | None = None
    moved: float = 0.0

    def __post_init__(self) -> None:
        """Freeze the points and check the duration."""
        if not 0.0 < self.duration < np.inf:
            raise InvalidField("duration", f"{self.duration} s", "a finite duration > 0")
        if self.points is not None:
            points = frozen_array("points", self.points, (len(self.points), 3))
            object.__setattr__(self, "points", points)

    @property
    def time_scale(self) -> float:
        """Duration over the curve's nominal duration."""
        return self.duration / float(self.curve.breaks[-1])

    @cached_property
    def peak_speed(self) -> float:
        """Highest speed [m/s]."""
        return peak_of_order(self.curve, 1) / self.time_scale

    @cached_property
    def peak_acceleration(self) -> float:
        """Highest norm of the acceleration [m/s^2]."""
        return peak_of_order(self.curve, 2) / self.time_scale**2

    @property
    def peak_times(self) -> tuple[float, float]:
        """Times of the highest speed and of the highest acceleration [s]."""
        speed, acceleration = (_peak(self.curve, order)[1] for order in (1, 2))
        return speed * self.time_scale, acceleration * self.time_scale

    def sample(self, time: ArrayLike) -> TrajectorySamples:
        """Evaluate at any times; outside [0, duration] it is at rest.

        Args:
            time: Since the start [s], shape (B,).
        """
        when = batch("time", time, ())
        scale, end = self.time_scale, float(self.curve.breaks[-1])
        values = self.curve.derivatives(np.clip(when / scale, 0.0, end))
        moving = ((when >= 0.0) & (when <= self.duration))[:, None]
        velocity, acceleration, jerk = (
            np.where(moving, values[:, order] / scale**order, 0.0) for order in (1, 2, 3)
        )
        return TrajectorySamples(
            time=when, position=values[:, 0], velocity=velocity,
            acceleration=acceleration, jerk=jerk,
        )  # fmt: skip

    def window(self, time: float, horizon: float, period: float) -> Reference:
        """Return the reference from now on.

        Args:
            time: Now [s]; row 0 is there.
            horizon: Time to look ahead [s]; 0 gives row 0 alone.
            period: Distance of the rows [s].

        Returns:
            A batch of one with N = 1 + floor(horizon / period) rows; the rotation is free.
        """
        if not period > 0.0:
            raise InvalidField("period", f"{period} s", "period > 0")
        if not 0.0 <= horizon < np.inf:
            raise InvalidField("horizon", f"{horizon} s", "a finite horizon >= 0")
        rows = 1 + int(np.floor(horizon / period + 1e-9))
        samples = self.sample(time + period * np.arange(rows))
        return Reference(
            time=samples.time[None],
            position=samples.position[None],
            velocity=samples.velocity[None],
            acceleration=samples.acceleration[None],
        )

    def within(self, robot: Robot) -> Trajectory:
        """Return the trajectory if all of it lies in the robot's workspace box.

        Raises:
            InvalidField: It leaves the box; names the axis, the place and the time.
        """
        leaving = self.leaving(robot)
        if leaving is not None:
            raise InvalidField(leaving.field, leaving.value, leaving.allowed)
        return self

    def leaving(self, robot: Robot) -> Leaving | None:
        """Return where the trajectory leaves the robot's workspace box, or None if it does not."""
        lower, upper = bounds(self.curve)
        low, high = robot.workspace_min, robot.workspace_max
        for axis, name in enumerate("xyz"):
            for (value, when), out in (
                (lower[axis], lower[axis][0] < low[axis] - BOX_MARGIN_M),
                (upper[axis], upper[axis][0] > high[axis] + BOX_MARGIN_M),
            ):
                if out:
                    time = when * self.time_scale
                    allowed = f"{low[axis]:g} m to {high[axis]:g} m, the box of {robot.name!r}"
                    return Leaving(
                        time, f"{self.name}: {name} at {time:.3f} s", f"{value:.4f} m", allowed
                    )
        return None


def bounds(curve: Curve) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
    """Return the lowest and the highest coordinate of each axis [m], with its nominal time [s]."""

    def extreme(axis: int, sign: float) -> tuple[float, float]:
        value, when = highest(lambda time: sign * curve.derivatives(time)[:, 0, axis], curve.breaks)
        return sign * value, when

    return [extreme(axis, -1.0) for axis in range(3)], [extreme(axis, 1.0) for axis in range(3)]


def peak_of_order(curve: Curve, order: int) -> float:
    """Return the highest norm of a derivative over nominal time [m/s^order]."""
    return _peak(curve, order)[0]


def _peak(curve: Curve, order: int) -> tuple[float, float]:
    """Return the highest norm of a derivative [m/s^order], and its nominal time [s]."""

    def norm(time: Array) -> Array:
        return np.asarray(np.linalg.norm(curve.derivatives(time)[:, order], axis=1))

    return highest(norm, curve.breaks)
