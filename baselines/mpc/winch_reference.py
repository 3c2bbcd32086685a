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
from typing import Any, NamedTuple

import numpy as np

from baselines.mpc.arithmetic import NUMBERS, Arithmetic
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

REST_SPEED_MAX = Scaled(5e-3, "m/s")
LIMIT_MARGIN = 1e-3  # of the limits, kept clear of rounding
JERK_LIMIT_MARGIN = 0.02  # of the jerk limit: at the start, lengths are known to some micrometres
CUT_MIN = 1e-9  # [m] by which a command within limits differs from the one that was wanted


@dataclass(frozen=True, kw_only=True, eq=False)
class WinchRange:
    """Range of the next command, or of an acceleration.

    Attributes:
        low: [m] or [m/s^2], shape (n,).
        high: The same.
    """

    low: Any
    high: Any


class WinchState(NamedTuple):
    """Of winches at a tick: arrays (n,), or expressions of CasADi.

    Attributes:
        length: That they have if all goes as planned, unstrained [m].
        rate: [m/s].
        sent: The last command [m].
        speed: By which it differs from the one before [m/s].
        acceleration: By which that differs from the speed before [m/s^2].
    """

    length: Any
    rate: Any
    sent: Any
    speed: Any
    acceleration: Any


class WinchFormulas:
    """What winches do in a tick, of arrays or of expressions."""

    def __init__(
        self, robot: Robot, *, period: float, jerk_max: float, arithmetic: Arithmetic = NUMBERS
    ) -> None:
        """Take the robot, the time between two commands [s], and the jerk limit [m/s^3]."""
        self._do, self._period, self._jerk_max = arithmetic, period, jerk_max
        constant = arithmetic.constant
        self._speed_max = constant((1.0 - LIMIT_MARGIN) * robot.speed_max)
        self._most = constant((1.0 - LIMIT_MARGIN) * robot.acceleration_max)
        self._length_min, self._length_max = constant(robot.length_min), constant(robot.length_max)
        self._lead = constant(np.maximum(robot.winch_lag - 0.5 * period, 0.25 * period))
        self._change = jerk_max * period * (1.0 - JERK_LIMIT_MARGIN)

    def command_range(self, state: WinchState) -> WinchRange:
        """Return the commands within all limits; that of acceleration goes first."""
        do, h, most, speed = self._do, self._period, self._most, self._speed_max
        now = state.acceleration
        low = do.most(-most, do.least(now - self._change, most))
        high = do.least(most, do.most(now + self._change, -most))
        # Lead to the limits smoothly: what jerk takes to end an acceleration is kept free.
        room = 0.5 * now * do.size(now) / self._jerk_max
        low_speed = do.within((-speed - state.speed - do.least(room, 0.0)) / h, low, high)
        high_speed = do.within((speed - state.speed - do.most(room, 0.0)) / h, low, high)
        ahead = state.sent + h * state.speed
        low_length, high_length = ahead + h * h * low_speed, ahead + h * h * high_speed
        return WinchRange(
            low=do.within(self._length_min, low_length, high_length),
            high=do.within(self._length_max, low_length, high_length),
        )

    def acceleration_range(self, state: WinchState, allowed: WinchRange) -> WinchRange:
        """Return the length accelerations in this tick that keep the command in range [m/s^2]."""
        base, gain = self._response(state)
        return WinchRange(low=(allowed.low - base) / gain, high=(allowed.high - base) / gain)

    def follow(
        self, state: WinchState, allowed: WinchRange, length: Any, rate: Any
    ) -> tuple[WinchState, Any]:
        """Return the state that comes of a length and rate to have by the next tick.

        Args:
            state: Now.
            allowed: Commands within all limits.
            length: [m], shape (n,).
            rate: [m/s], shape (n,).

        Returns:
            The state, whose `sent` is the command, and which of these were cut, shape (n,).
        """
        wanted = length + self._lead * rate
        command = self._do.within(wanted, allowed.low, allowed.high)
        cut = self._do.size(command - wanted) > CUT_MIN
        drifted, forced = self._answer(state, command)
        choose = self._do.choose
        return (
            self._next(state, command, choose(cut, drifted, length), choose(cut, forced, rate)),
            cut,
        )

    def note(self, state: WinchState, command: Any) -> WinchState:
        """Return the state that comes of a command [m]."""
        return self._next(state, command, *self._answer(state, command))

    def _answer(self, state: WinchState, command: Any) -> tuple[Any, Any]:
        """Return length and rate at the end of the tick that follow from a command."""
        base, gain = self._response(state)
        forced = state.rate + self._period * (command - base) / gain
        return state.length + 0.5 * self._period * (state.rate + forced), forced

    def _next(self, state: WinchState, command: Any, length: Any, rate: Any) -> WinchState:
        speed = (command - state.sent) / self._period
        return WinchState(
            length=length, rate=rate, sent=command, speed=speed,
            acceleration=(speed - state.speed) / self._period,
        )  # fmt: skip

    def _response(self, state: WinchState) -> tuple[Any, Any]:
        """Return the command without acceleration, and its change per acceleration."""
        h, lead = self._period, self._lead
        return state.length + (h + lead) * state.rate, 0.5 * h * h + h * lead


class WinchReference:
    """Length and rate that the winches have at the next tick if all goes as planned.

    Attributes:
        state: Now.
        held: Whether the last command was changed to keep it within limits.
    """

    def __init__(self, robot: Robot, *, period: float, jerk_max: float) -> None:
        self._robot, self._period = robot, period
        self._formulas = WinchFormulas(robot, period=period, jerk_max=jerk_max)
        self._rest_speed = REST_SPEED_MAX.of(Scales(robot).ratios)

    def reset(self, length: Array) -> None:
        """Let the winches rest at a length [m], shape (n,)."""
        still = np.zeros(len(length))
        length = np.array(length)
        self.held = False
        self.state = self._before = WinchState(
            length=length, rate=still, sent=length, speed=still, acceleration=still
        )
        self._range: WinchRange | None = None

    @property
    def length(self) -> Array:
        """Unstrained [m], shape (n,)."""
        return np.asarray(self.state.length)

    @property
    def rate(self) -> Array:
        """[m/s], shape (n,)."""
        return np.asarray(self.state.rate)

    @property
    def at_rest(self) -> bool:
        """True if they have all but stopped."""
        return bool(np.abs(self.rate).max() < self._rest_speed)

    @property
    def braked(self) -> Array:
        """The next command if the winches are to rest as soon as they can [m], shape (n,)."""
        change = self._robot.acceleration_max * self._period * (1.0 - LIMIT_MARGIN)
        speed = self.state.speed - NUMBERS.within(self.state.speed, -change, change)
        return np.asarray(self.state.sent + self._period * speed)

    def command_range(self) -> WinchRange:
        """Return the commands within all limits; that of acceleration goes first."""
        if self._range is None:  # once a tick
            self._range = self._formulas.command_range(self.state)
        return self._range

    def acceleration_range(self) -> WinchRange:
        """Return the length accelerations in this tick that keep the command in range [m/s^2]."""
        return self._formulas.acceleration_range(self.state, self.command_range())

    def follow(self, length: Array, rate: Array) -> Array:
        """Return the command that brings the winches to a length and rate by the next tick.

        Args:
            length: [m], shape (n,).
            rate: [m/s], shape (n,).

        Returns:
            The command [m], shape (n,).
        """
        state, cut = self._formulas.follow(self.state, self.command_range(), length, rate)
        self.take(state, held=bool(cut.any()))
        return np.asarray(state.sent)

    def take(self, state: WinchState, *, held: bool) -> None:
        """Take the state that comes of a command in this tick."""
        self._before, self.state, self.held, self._range = self.state, state, held, None

    def note(self, command: Array) -> None:
        """Take note of a command [m] (n,) of someone else in this tick."""
        self.take(self._formulas.note(self.state, command), held=self.held)

    def instead(self, command: Array) -> None:
        """Take note of a command [m] (n,) that was sent in place of the last one."""
        self.state = self._before
        self.note(command)

    def accelerate(self, acceleration: Array) -> Array:
        """Return the command for a length acceleration in this tick [m/s^2], shape (n,)."""
        h = self._period
        rate = self.rate + h * acceleration
        return self.follow(self.length + 0.5 * h * (self.rate + rate), rate)
