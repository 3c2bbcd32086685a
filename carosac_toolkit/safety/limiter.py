r"""Limits on the commands of every moving driver, with a report of what was changed.

Lengths commanded at a fixed period h define speed, acceleration and jerk of each cable by
differences (`carosac_toolkit.physics.motion.braking`). Nothing leaves `Limiter.apply` from which
the controlled stop could not bring all cables to rest within every limit: length, speed,
acceleration and jerk of each cable, and the workspace box. The braking distance counts at the
length limits and at the box.

Order of precedence:

1. What is asked passes, bit by bit, where it keeps all limits and leaves room to stop. Cables that
   were elsewhere join it only where the next two steps can keep them with it.
2. Else the cables go together, by one common factor, along the straight line in length space to
   what is asked, as far as that is admissible and does not end beyond it. The line starts at the
   step in which they match its pace with jerks and accelerations in proportion, so that motions in
   proportion stay so; where that step is not admissible, at the next step of the controlled stop.
3. The controlled stop is always allowed. It comes before the jump limit: where a winch is stuck and
   stopping leads farther from the measured length than `jump_max`, the cables brake, and the hit is
   reported at every call. Only commands that close that gap go through until it is closed.

Acceleration and jerk are never exceeded to keep another limit. The box is that of the straight-line
position at the home rotation (`straight_line`), followed from where `reset` found it: weight and
stretch of the cables, sway and tilt are not in it. Keep the box inside what must not be touched by
that much: sag and stretch (compare `statics.forward_kinematics` with the straight line), the
amplitude of sway, and the motion of the outermost point under tilt.

The limits hold at each period. Between two commands the winches interpolate. The controlled stop
brakes each cable on its own; with more cables than degrees of freedom its tensions are not bounded.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from carosac_toolkit.base.arrays import Array, batch
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.values import Command, LimitHit
from carosac_toolkit.physics.cable.straight_line import forward_kinematics
from carosac_toolkit.physics.motion.braking import Brakes, Slack, WinchMotion, box_slack
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.safety.limits_report import limit_hits, rate_hits

DELAY_LAGS = 0.2  # delay of the encoders in lags of a winch: 10 ms for 50 ms
PLANT_LAG_SHARE = 0.5  # of the lag of a plant, by which its nominal robot may be quicker


@dataclass(frozen=True, kw_only=True)
class LimitSettings:
    """Limits that are not in the robot file.

    A plant drawn at random has winches of another lag than the nominal robot. Where two drivers
    shall have the same limits, derive them once: ``settings.of(nominal, period=period)``.

    Attributes:
        jerk_max: Largest change of acceleration of a cable [m/s^3]; None: that which takes the
            slowest winch to full acceleration in half its lag, or in a period if that is longer.
        jump_max: Largest distance of a command from the measured length [m]; must exceed the
            lag of the winches at full speed. None: twice what the farthest winch winds at full
            speed in 1.2 lags, which leaves a fifth of a lag for the delay of the encoders, or in
            two periods if that is longer.
        box: True if the straight-line position must stay in the robot's workspace box.
    """

    jerk_max: float | None = None
    jump_max: float | None = None
    box: bool = True

    def __post_init__(self) -> None:
        """Refuse numbers that are not positive."""
        for name, unit in (("jerk_max", "m/s^3"), ("jump_max", "m")):
            value = getattr(self, name)
            if value is not None and (not value > 0.0 or not np.isfinite(value)):
                raise InvalidField(name, f"{value} {unit}", f"{name} > 0, finite")

    def of(self, robot: Robot, *, period: float) -> LimitSettings:
        """Return the settings with both numbers, derived from a robot where they are None.

        Args:
            robot: Robot description, n cables.
            period: Time between two commands [s].

        Raises:
            InvalidField: A `jump_max` by which a winch at full speed would be stopped for its lag.
        """
        return replace(
            self, jerk_max=self.jerk_of(robot, period), jump_max=self.jump_of(robot, period)
        )

    def jerk_of(self, robot: Robot, period: float) -> float:
        """Return the largest change of acceleration for a robot [m/s^3]."""
        return Scales(robot).jerk(period) if self.jerk_max is None else self.jerk_max

    def jump_of(self, robot: Robot, period: float, *, share: float = 1.0) -> float:
        """Return the largest distance from the measured length for a robot [m].

        One that was chosen has to exceed a share of what its winches lag behind.
        """
        scales = Scales(robot)
        if self.jump_max is None:
            delay = np.maximum(DELAY_LAGS * robot.winch_lag, 2.0 * period - robot.winch_lag)
            return 2.0 * scales.reach(delay)
        behind = share * scales.reach(0.0)
        if self.jump_max <= behind:
            part = "" if share == 1.0 else f"{share:.0%} of "
            allowed = f"more than {behind:g} m, {part}the lag of its winches at full speed"
            raise InvalidField("jump_max", f"{self.jump_max} m for robot {robot.name!r}", allowed)
        return self.jump_max


class Limiter:
    """Limiter of the commands to B robots of n cables; each row on its own.

    Each call of `apply` or `brake` stands for one period, whatever the time of the command says:
    it is passed on and not checked, as the clocks of drivers jitter. A driver that misses a tick
    makes no call for it, and its winches hold the last command.

    Attributes:
        robot: Robot description, n cables.
        period: Time between two commands [s].
        jerk_max: Largest change of acceleration of a cable [m/s^3].
        jump_max: Largest distance of a command from the measured length [m].
        box: True if the straight-line position must stay in the robot's workspace box.
    """

    def __init__(
        self, robot: Robot, settings: LimitSettings | None = None, *, period: float
    ) -> None:
        """Set up; call `reset` before anything else.

        Args:
            robot: Robot description, n cables.
            settings: None takes the defaults.
            period: Time between two commands [s].

        Raises:
            InvalidField: A period that is not positive, or so short that the rounding of lengths
                hides the jerk limit; a `jump_max` that is too short for this robot.
        """
        self.robot = robot
        if not period > 0.0 or not np.isfinite(period):
            raise InvalidField("period", f"{period} s", "period > 0, finite")
        settings = settings or LimitSettings()
        self.jerk_max = settings.jerk_of(robot, period)
        # A plant drawn at random has another lag than the robot that its settings were made for.
        self.jump_max = settings.jump_of(robot, period, share=PLANT_LAG_SHARE)
        self.box = settings.box
        if Slack.of(robot, self.jerk_max, period).jerk > 0.01 * self.jerk_max:
            raise InvalidField(
                "period", f"{period} s",
                f"a period at which {self.jerk_max:g} m/s^3 is not lost in rounding",
            )  # fmt: skip
        self.period = float(period)
        self._brakes: Brakes | None = None
        self._size = 0

    @property
    def stopped(self) -> bool:
        """True if all cables are at rest: no speed and no acceleration."""
        motion = self._now()[1]
        return not (motion.speed.any() or motion.acceleration.any())

    @property
    def motion(self) -> WinchMotion:
        """Length, speed and acceleration last sent, as copies."""
        return WinchMotion(*(part.copy() for part in self._now()[1]))

    def reset(self, unstrained_length: ArrayLike, *, time: ArrayLike | None = None) -> None:
        """Start at rest.

        Args:
            unstrained_length: Current lengths of the winches [m], shape (B, n).
            time: Time of the state [s], shape (B,), from which `brake` counts; None is 0.

        Raises:
            InvalidField: Lengths outside the length limits, or, with the box on, lengths whose
                straight-line position is outside the box: move in with the box off.
        """
        length = batch("unstrained_length", unstrained_length, (self.robot.n,))
        size = len(length)
        start = np.zeros(size) if time is None else batch("time", time, ())
        if start.shape != (size,):
            raise InvalidField("time", f"shape {start.shape}", f"shape {(size,)}")
        _check_lengths(self.robot, length)
        position = _check_box(self.robot, length) if self.box else np.zeros((size, 3))
        if self._brakes is None or self._size != size:
            self._brakes = Brakes(
                self.robot, size, period=self.period, jerk_max=self.jerk_max,
                jump_max=self.jump_max, box=self.box,
            )  # fmt: skip
            self._size = size
        rest = np.zeros_like(length)
        self._motion = WinchMotion(length, rest, rest, position)
        self._asked, self._paced = length, rest
        self._time = start

    def begin_path(self) -> None:
        """Forget what was asked last: the next command begins a new path from here."""
        motion = self._now()[1]
        self._asked, self._paced = motion.length, motion.speed

    def apply(self, command: Command, actual: ArrayLike | None = None) -> Command:
        """Limit a command to what may be sent for the next period.

        Args:
            command: Command of a controller; a `length_rate` is kept within the speed limits,
                and follows the lengths where they were changed.
            actual: Measured unstrained lengths [m], shape (B, n); None: no jump limit.

        Returns:
            The command itself where nothing had to change, else what to send instead. `limited`
            lists, row by row, each limit that was in the way with the value asked and the value
            sent, for the step or for the stop that would follow it, whichever breaks the limit:
            ``length`` [m], ``speed`` [m/s], ``acceleration`` [m/s^2], ``jerk`` [m/s^3], ``jump``
            (distance from the measured length [m]), ``box`` (distance outside [m], no cable),
            ``length_rate`` [m/s]; and ``coordination`` [m] for a cable that broke none and was
            changed to stay with the others. Each changed length is in one of them.

        Raises:
            InvalidField: Another shape, or a number that is not finite; nothing has changed then.
        """
        brakes, motion = self._now()
        asked = self._checked("unstrained_length", command.unstrained_length)
        measured = None if actual is None else self._checked("actual", actual)
        pace = self._pace(asked)
        sent = brakes.limit(motion, asked, pace, (pace - self._paced) / self.period, measured)
        hits: list[LimitHit] = []
        changed = (sent.length != asked).any(axis=1)
        far = False
        if measured is not None:
            far = bool((np.abs(sent.length - measured) > self.jump_max).any())
        if far or changed.any():
            hits += limit_hits(
                self.robot, self.jerk_max, self.jump_max, self.period,
                brakes, motion, asked, sent, measured,
            )  # fmt: skip
        rate = command.length_rate
        if rate is not None:
            rate = np.where(changed[:, None], sent.speed, rate)
            rate = np.clip(rate, -self.robot.speed_max, self.robot.speed_max)
            hits += rate_hits(command.length_rate, rate)
        self._motion, self._asked, self._paced, self._time = sent, asked, pace, command.time
        if not hits:
            return command
        return Command(
            time=command.time,
            unstrained_length=sent.length,
            length_rate=rate,
            limited=(*command.limited, *hits),
        )

    def brake(self) -> Command:
        """Return the next command of the controlled stop, one period after the last one.

        Call it until `stopped`; after that it holds the lengths.
        """
        brakes, motion = self._now()
        self._motion = brakes.stop(motion)
        self.begin_path()
        self._time = self._time + self.period
        return Command(time=self._time, unstrained_length=self._motion.length)

    def _now(self) -> tuple[Brakes, WinchMotion]:
        """Return the brakes and the motion; refuse before `reset`."""
        if self._brakes is None:
            raise InvalidField("limiter", "no lengths to start from", "a call of reset() first")
        return self._brakes, self._motion

    def _checked(self, name: str, value: ArrayLike) -> Array:
        """Refuse another shape or numbers that are not finite."""
        array = batch(name, value, (self.robot.n,))
        if len(array) != self._size:
            allowed = f"shape {(self._size, self.robot.n)}, as at reset()"
            raise InvalidField(name, f"shape {array.shape}", allowed)
        return array

    def _pace(self, asked: Array) -> Array:
        """Return the speed of the asked lengths [m/s]; 0 where they jump beyond winch speed."""
        with np.errstate(over="ignore"):  # a jump beyond all numbers is a jump
            pace = (asked - self._asked) / self.period
        return np.where(np.abs(pace) <= self.robot.speed_max, pace, 0.0)


def _check_lengths(robot: Robot, length: Array) -> None:
    """Refuse lengths outside the length limits."""
    bad = (length < robot.length_min) | (length > robot.length_max)
    if bad.any():
        row, i = (int(k) for k in np.argwhere(bad)[0])
        allowed = f"{robot.length_min[i]} m <= length <= {robot.length_max[i]} m"
        raise InvalidField(f"unstrained_length[{row}, {i}]", f"{length[row, i]} m", allowed)


def _check_box(robot: Robot, length: Array) -> Array:
    """Return the straight-line positions [m], (B, 3); refuse any outside the workspace box."""
    fit = forward_kinematics(robot, length)
    slack = box_slack(robot)
    low, high = robot.workspace_min - slack, robot.workspace_max + slack
    inside = ((fit.position >= low) & (fit.position <= high)).all(axis=1)
    bad = ~(inside & fit.converged)
    if bad.any():
        row = int(np.argmax(bad))
        what = "no straight-line position"
        if fit.converged[row]:
            what = f"straight-line position {np.round(fit.position[row], 4).tolist()} m"
        box = f"{robot.workspace_min.tolist()} to {robot.workspace_max.tolist()} m"
        raise InvalidField(f"unstrained_length[{row}]", what, f"in the workspace box {box}")
    return fit.position
