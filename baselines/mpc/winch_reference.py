r"""Winch motion, tick by tick, and the commands that produce it.

A winch follows a held command by a first-order lag T. On average, a command is held for half a
period h longer than it is new, so that the command of a tick at time t leads by T + h/2:

.. math:: c = L(t + h) + (T - h/2)\, \dot L(t + h)

for the length L it should have. Within a tick the acceleration of L is constant. Taking L at the
end of the tick matters: then the motion that belongs to a given command is well damped, whereas at
its middle that motion would grow from tick to tick, and with it every command at a limit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

REST_SPEED_MAX = Scaled(5e-3, "m/s")
LIMIT_MARGIN = 1e-3  # of the limits, kept clear of rounding
JERK_LIMIT_MARGIN = 0.02  # of the jerk limit: at the start, lengths are known to some micrometres


@dataclass(frozen=True, kw_only=True, eq=False)
class WinchRange:
    """Range of the next command.

    Attributes:
        low: [m], shape (n,).
        high: [m], shape (n,).
    """

    low: Array
    high: Array


class WinchReference:
    """Length and rate that the winches have at the next tick if all goes as planned.

    Attributes:
        length: Unstrained [m], shape (n,).
        rate: [m/s], shape (n,).
        held: Whether the last command was changed to keep it within limits.
    """

    def __init__(self, robot: Robot, *, period: float, jerk_max: float) -> None:
        self._robot, self._period, self._jerk_max = robot, period, jerk_max
        self._rest_speed = REST_SPEED_MAX.of(Scales(robot).ratios)
        self._lead = np.maximum(robot.winch_lag - 0.5 * period, 0.25 * period)

    def reset(self, length: Array) -> None:
        """Let the winches rest at a length [m], shape (n,)."""
        self.length = np.array(length)
        self.rate = np.zeros_like(self.length)
        self.held = False
        self._sent = np.array(length)
        self._speed = np.zeros_like(self.length)
        self._acceleration = np.zeros_like(self.length)
        self._before = self._state()
        self._range: WinchRange | None = None

    @property
    def at_rest(self) -> bool:
        """True if they have all but stopped."""
        return bool(np.abs(self.rate).max() < self._rest_speed)

    @property
    def braked(self) -> Array:
        """The next command if the winches are to rest as soon as they can [m], shape (n,)."""
        change = self._robot.acceleration_max * self._period * (1.0 - LIMIT_MARGIN)
        speed = self._speed - _within(self._speed, -change, change)
        return np.asarray(self._sent + self._period * speed)

    def command_range(self) -> WinchRange:
        """Return the commands within all limits; that of acceleration goes first."""
        if self._range is None:  # once a tick
            self._range = self._allowed()
        return self._range

    def _allowed(self) -> WinchRange:
        robot, h, keep = self._robot, self._period, 1.0 - LIMIT_MARGIN
        change = self._jerk_max * h * (1.0 - JERK_LIMIT_MARGIN)
        most = robot.acceleration_max * keep
        low = np.maximum(-most, np.minimum(self._acceleration - change, most))
        high = np.minimum(most, np.maximum(self._acceleration + change, -most))
        speed = keep * robot.speed_max
        # Lead to the limits smoothly: what jerk takes to end an acceleration is kept free.
        room = 0.5 * self._acceleration * np.abs(self._acceleration) / self._jerk_max
        low_speed = _within((-speed - self._speed - np.minimum(room, 0.0)) / h, low, high)
        high_speed = _within((speed - self._speed - np.maximum(room, 0.0)) / h, low, high)
        ahead = self._sent + h * self._speed
        low_length, high_length = ahead + h * h * low_speed, ahead + h * h * high_speed
        return WinchRange(
            low=_within(robot.length_min, low_length, high_length),
            high=_within(robot.length_max, low_length, high_length),
        )

    def acceleration_range(self) -> WinchRange:
        """Return the length accelerations in this tick that keep the command in range [m/s^2]."""
        allowed = self.command_range()
        base, gain = self._response()
        return WinchRange(low=(allowed.low - base) / gain, high=(allowed.high - base) / gain)

    def follow(self, length: Array, rate: Array) -> Array:
        """Return the command that brings the winches to a length and rate by the next tick.

        Args:
            length: [m], shape (n,).
            rate: [m/s], shape (n,).

        Returns:
            The command [m], shape (n,).
        """
        wanted = length + self._lead * rate
        allowed = self.command_range()
        command = _within(wanted, allowed.low, allowed.high)
        cut = np.abs(command - wanted) > 1e-9
        self.held = bool(cut.any())
        self._before = self._state()
        if self.held:
            drifted, forced = self._answer(command)
            length, rate = np.where(cut, drifted, length), np.where(cut, forced, rate)
        self._keep(command, np.array(length), np.array(rate))
        return command

    def note(self, command: Array) -> None:
        """Take note of a command [m] (n,) of someone else in this tick."""
        self._before = self._state()
        self._keep(command, *self._answer(command))

    def instead(self, command: Array) -> None:
        """Take note of a command [m] (n,) that was sent in place of the last one."""
        self.length, self.rate, self._sent, self._speed, self._acceleration = self._before
        self.note(command)

    def _state(self) -> tuple[Array, Array, Array, Array, Array]:
        return self.length, self.rate, self._sent, self._speed, self._acceleration

    def _answer(self, command: Array) -> tuple[Array, Array]:
        """Return length and rate at the end of the tick that follow from a command."""
        base, gain = self._response()
        forced = self.rate + self._period * (command - base) / gain
        return self.length + 0.5 * self._period * (self.rate + forced), forced

    def _keep(self, command: Array, length: Array, rate: Array) -> None:
        self.length, self.rate = length, rate
        speed = (command - self._sent) / self._period
        self._acceleration = (speed - self._speed) / self._period
        self._speed, self._sent, self._range = speed, command, None

    def accelerate(self, acceleration: Array) -> Array:
        """Return the command for a length acceleration in this tick [m/s^2], shape (n,)."""
        h = self._period
        rate = self.rate + h * acceleration
        return self.follow(self.length + 0.5 * h * (self.rate + rate), rate)

    def _response(self) -> tuple[Array, Array]:
        """Return the command without acceleration, and its change per acceleration."""
        h, lead = self._period, self._lead
        return self.length + (h + lead) * self.rate, 0.5 * h * h + h * lead


def _within(values: Array, low: Array, high: Array) -> Array:
    """Return values within bounds, as `numpy.clip`, which takes its time with small arrays."""
    return np.asarray(np.minimum(np.maximum(values, low), high))
