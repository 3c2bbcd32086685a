"""What the guard checks at every measurement and before every command; each finding has a name."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.drivers.guard_settings import STALE, GuardSettings
from carosac_toolkit.loop.drive_state import Fault
from carosac_toolkit.loop.values import Belief, Command, Measurement
from carosac_toolkit.physics.cable import straight_line
from carosac_toolkit.physics.motion.braking import WinchMotion
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.robot.robot import Robot

DELAY = 0.03  # motion that differing lags may explain [s], besides the age of a sample
STEADY = 0.5  # [s] over which tensions are averaged: the platform tilts to and fro at some Hz
FREE = 6  # cables up to which lengths and weight say the tensions


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Something that must not be.

    Attributes:
        fault: Its name.
        text: What was found and what is allowed.
        cable: Index of the cable, or None.
        lasting: How long it must last until it counts [s].
    """

    fault: Fault
    text: str
    cable: int | None = None
    lasting: float = 0.0


class Checks:
    """Watches one robot of n cables; what is sent is told by `sent`.

    Attributes:
        patience: How long measurements may stay the same [s].
        position: Of the platform by the newest lengths in W [m], shape (3,), or None.
        tension: Of the cables at rest there [N], shape (n,), or None.
    """

    def __init__(self, robot: Robot, settings: GuardSettings) -> None:
        self._robot = robot
        self._settings = settings
        self.patience = STALE if settings.stale_time is None else settings.stale_time
        self._last: Measurement | None = None
        self._held = False
        self._silent = 0
        self._count: Counter[Fault] = Counter()
        self._expected: Array | None = None
        self._before: Array | None = None
        self._start: tuple[Array, Array] | None = None  # where it was told to be, and was
        self._shares: list[Array] = []  # newest measured tensions over those of rest
        self._usual: Array | None = None  # their mean at the start
        self._speed = np.zeros(robot.n)
        self._equilibrium: statics.Equilibrium | None = None
        self.position: Array | None = None
        self.tension: Array | None = None

    def prepare(self) -> None:
        """Load what the checks compute with, which may take seconds, before time counts."""
        robot = self._robot
        position, rotation = robot.home_position[None], robot.home_rotation[None]
        lengths = straight_line.inverse_kinematics(robot, position, rotation)
        straight_line.forward_kinematics(robot, lengths)
        statics.inverse_kinematics(robot, position, rotation if robot.n >= FREE else None)
        if robot.n <= FREE:
            statics.forward_kinematics(robot, lengths)

    def standing(self, length: Array | None) -> None:
        """The winches now stand there and are told to, lengths [m] of shape (n,); None: untold."""
        self._expected = None if length is None else length.copy()
        self._before = None
        self._start = None
        self._speed = np.zeros(self._robot.n)
        self._count.clear()

    def sent(self, motion: WinchMotion) -> None:
        """One period passes with this command: where the winches should be after it."""
        if self._expected is None:
            return
        share = -np.expm1(-self._settings.period / self._robot.winch_lag)
        self._expected = self._expected + share * (motion.length[0] - self._expected)
        self._speed = motion.speed[0]

    def measured(
        self, measurement: Measurement, *, homed: bool, held: bool = False
    ) -> Finding | None:
        """What is wrong with a measurement, in the order of how sure the guard can be.

        Args:
            measurement: The newest.
            homed: Whether lengths belong to poses.
            held: Whether a fault holds the winches at rest.
        """
        still = held and self._held
        findings = [
            self._stale(measurement),
            self._jump(measurement, still=still),
            self._direction(measurement),
            self._following(measurement),
        ]
        if homed:
            findings += self._pose(measurement)
        self._last, self._held = measurement, held
        return self._ripe([found for found in findings if found is not None])

    def command(self, command: Command, standing: Array, *, first: bool) -> Finding | None:
        """Why a command must not be sent, lengths [m] of shape (1, n)."""
        robot, settings = self._robot, self._settings
        asked = np.asarray(command.unstrained_length)
        rate = command.length_rate
        if not np.isfinite(asked).all() or (rate is not None and not np.isfinite(rate).all()):
            return Finding(fault=Fault.COMMAND, text="a command that is not a number")
        low, high = robot.length_min, robot.length_max
        outside = np.maximum(low - asked[0], asked[0] - high)
        i = int(np.argmax(outside))
        if outside[i] > settings.range_margin:
            text = f"{asked[0, i]:.3f} m asked; allowed: {low[i]:g} m to {high[i]:g} m"
            return Finding(fault=Fault.COMMAND, text=text, cable=i)
        far = np.abs(asked[0] - standing)
        most, which = settings.step(robot), "a command"
        if first:
            most, which = np.minimum(settings.first_max, most), "the first command"
        i = int(np.argmax(far - most))
        if far[i] > most[i]:
            text = f"{which} is {far[i]:.3f} m from where the winch stands; allowed: {most[i]:g} m"
            return Finding(fault=Fault.COMMAND, text=text, cable=i)
        return None

    def belief(self, belief: Belief) -> Finding | None:
        """Whether a belief is far from what the lengths say."""
        if self.position is None:
            return None
        far = float(np.linalg.norm(belief.position[0] - self.position))
        if far <= self._settings.belief_max:
            return None
        text = f"the believed position is {far:.2f} m from that of the lengths; allowed: "
        return Finding(fault=Fault.ESTIMATOR, text=text + f"{self._settings.belief_max:g} m")

    def _stale(self, measurement: Measurement) -> Finding | None:
        """Samples must go on."""
        last, settings = self._last, self._settings
        advanced = last is None or _sampled(measurement) > _sampled(last)
        self._silent = 0 if advanced else self._silent + 1
        silent = self._silent * settings.period
        if self._silent < 2 or silent <= self.patience:
            return None
        text = f"no new sample for {silent:.3f} s; allowed: {self.patience:g} s"
        return Finding(fault=Fault.STALE_DATA, text=text)

    def _jump(self, measurement: Measurement, *, still: bool) -> Finding | None:
        """Lengths must not change faster than a winch turns, or otherwise than it was told to."""
        last, before = self._last, self._before
        self._before = self._expected
        if last is None:
            return None
        change = (measurement.unstrained_length - last.unstrained_length)[0]
        passed = max(_sampled(measurement) - _sampled(last), 0.0)
        if self._expected is not None and before is not None:
            change = change - (self._expected - before)
            period = self._settings.period
            uneven = abs(passed - period) + 0.5 * period  # samples come when they come
            allowed = self._settings.jump_max + uneven * np.abs(self._speed)
        else:
            allowed = self._settings.jump_max + (0.0 if still else passed) * self._robot.speed_max
        over = np.abs(change) - allowed
        i = int(np.argmax(over))
        if over[i] <= 0.0:
            return None
        text = f"the length jumped by {change[i]:+.3f} m; allowed: {allowed[i]:.3f} m"
        return Finding(fault=Fault.ENCODER_JUMP, text=text, cable=i)

    def _direction(self, measurement: Measurement) -> Finding | None:
        """Winches must turn the way they were told to, since they stood."""
        if self._expected is None:
            return None
        measured = measurement.unstrained_length[0]
        if self._start is None:
            self._start = (self._expected.copy(), measured.copy())
        told, done = self._expected - self._start[0], measured - self._start[1]
        allowed = self._settings.direction_max + self._late(measurement)
        against = np.where(told * done < 0.0, np.minimum(np.abs(told), np.abs(done)), 0.0)
        i = int(np.argmax(against - allowed))
        if against[i] <= allowed[i]:
            return None
        text = f"told to change by {told[i]:+.3f} m, and changed by {done[i]:+.3f} m: it turns the "
        return Finding(
            fault=Fault.FOLLOWING_ERROR, text=text + "other way", cable=i,
            lasting=self._settings.lasting,
        )  # fmt: skip

    def _late(self, measurement: Measurement) -> Array:
        """Motion that differing lags and the age of a sample may explain [m], shape (n,)."""
        age = max(float(measurement.time[0]) - _sampled(measurement), 0.0)
        return np.asarray((DELAY + age) * np.abs(self._speed))

    def _following(self, measurement: Measurement) -> Finding | None:
        """Winches must be where they were told to be, after their lag."""
        if self._expected is None:
            return None
        error = np.abs(measurement.unstrained_length[0] - self._expected)
        allowed = self._settings.following_max + self._late(measurement)
        i = int(np.argmax(error - allowed))
        if error[i] <= allowed[i]:
            return None
        text = f"{error[i]:.3f} m from where the winch should be; allowed: {allowed[i]:.3f} m"
        return Finding(
            fault=Fault.FOLLOWING_ERROR, text=text, cable=i, lasting=self._settings.lasting
        )

    def _pose(self, measurement: Measurement) -> list[Finding | None]:
        """Closure, tensions and workspace."""
        lengths = measurement.unstrained_length
        try:
            closure = self._closure(lengths)
            if self._robot.n <= FREE:
                self._rest(lengths)
        except InvalidField as error:  # no length at all
            return [Finding(fault=Fault.CLOSURE, text=str(error))]
        shift = self._tension_shift(measurement)
        return [closure, shift, self._tension(measurement), self._workspace()]

    def _closure(self, lengths: Array) -> Finding | None:
        """One straight-line pose must explain all lengths."""
        fit = straight_line.forward_kinematics(self._robot, lengths)
        self.position = fit.position[0]
        residual = float(fit.residual[0])
        if fit.converged[0] and residual <= self._settings.closure_max:
            return None
        text = f"{residual:.3f} m (rms) of the lengths fit no pose; allowed: "
        text += f"{self._settings.closure_max:g} m"
        return Finding(fault=Fault.CLOSURE, text=text, lasting=self._settings.lasting)

    def _rest(self, lengths: Array) -> None:
        """Pose and tensions at rest; the straight-line position stays where there are none."""
        found = statics.forward_kinematics(self._robot, lengths, guess=self._equilibrium)
        good = bool(found.converged[0])
        self._equilibrium = found if good else None
        self.tension = found.tension[0] if good else None
        if good:
            self.position = found.position[0]

    def _tension_shift(self, measurement: Measurement) -> Finding | None:
        """Measured tensions must go with those of the lengths, where somebody wants to know.

        Lengths that follow their commands to the millimetre may still be wrong: a winch that turns
        the other way than the robot file says tilts the platform, and loads its cables crosswise.
        """
        most, measured = self._settings.tension_shift_max, measurement.tension
        if most is None or measured is None or self.tension is None:
            return None
        span = max(1, round(STEADY / self._settings.period))
        self._shares = [*self._shares[1 - span :], measured.value[0] / self.tension]
        mean = np.mean(self._shares, axis=0)
        if self._expected is None or self._usual is None:
            self._usual = mean  # standing still
        change = mean / self._usual - 1.0
        i = int(np.argmax(np.abs(change)))
        if abs(change[i]) <= most:
            return None
        text = (
            f"the tension of cable '{self._robot.cable_names[i]}' is {100 * change[i]:+.0f} % off "
            f"what the lengths say; allowed: {100 * most:g} %. Does a winch turn the other way "
            "than its sign in the robot file, or by another scale?"
        )
        return Finding(fault=Fault.CLOSURE, text=text)

    def _tension(self, measurement: Measurement) -> Finding | None:
        """Measured tensions, or those of rest where lengths and weight determine them."""
        robot = self._robot
        measured = measurement.tension is not None
        tension = self.tension if measurement.tension is None else measurement.tension.value[0]
        if tension is None:
            return None
        outside = np.maximum(robot.tension_min - tension, tension - robot.tension_max)
        i = int(np.argmax(outside))
        if outside[i] <= 0.0:
            return None
        how = "measured" if measured else "estimated"
        low, high = robot.tension_min[i], robot.tension_max[i]
        text = f"{tension[i]:.1f} N {how}; allowed: {low:g} N to {high:g} N"
        slack = tension[i] < low
        lasting = self._settings.slack_time if slack else self._settings.lasting
        return Finding(fault=Fault.TENSION, text=text, cable=i, lasting=lasting)

    def _workspace(self) -> Finding | None:
        """The platform must stay in its box, but for a margin."""
        robot, position = self._robot, self.position
        if position is None:
            return None
        outside = np.maximum(robot.workspace_min - position, position - robot.workspace_max)
        far = float(outside.max())
        if far <= self._settings.workspace_margin:
            return None
        text = f"the platform is {far:.2f} m outside the workspace box; allowed: "
        text += f"{self._settings.workspace_margin:g} m"
        return Finding(fault=Fault.WORKSPACE, text=text, lasting=self._settings.lasting)

    def _ripe(self, findings: list[Finding]) -> Finding | None:
        """The first finding that counts; those that must last are counted."""
        kinds = {found.fault for found in findings}
        self._count = Counter({fault: self._count[fault] + 1 for fault in kinds})
        for found in findings:
            if self._count[found.fault] * self._settings.period >= found.lasting - 1e-9:
                return found
        return None


def _sampled(measurement: Measurement) -> float:
    """When the newest lengths were measured [s]."""
    rate = measurement.length_rate
    return float(measurement.time[0] if rate is None else rate.time[0])
