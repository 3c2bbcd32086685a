"""Checks of every measurement and command; each finding names its fault."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.loop.drive_state import Fault
from carosac_toolkit.loop.values import Belief, Command, Measurement
from carosac_toolkit.physics.cable import straight_line
from carosac_toolkit.physics.motion.braking import WinchMotion
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.homing import DEGREES_OF_FREEDOM
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.safety.guard.settings import GuardSettings

STALE_TIME_S = 0.08  # eight periods of 10 ms
SAMPLE_AGE_S = 0.05  # allowed for in `GuardSettings.step`, beside the lag of the winches
LINK_MARGIN_PERIODS = 3.0  # cycles are counted, and those of a start come early
LAG_SPREAD = 0.6  # share of the longest lag by which lags differ, besides the age of a sample
TENSION_MEAN_TIME = Scaled(0.5, "s")  # the platform tilts to and fro at some Hz
FAULT_DURATION_S = 0.03  # three periods of 10 ms: one wrong sample stops nobody


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Evidence of a fault.

    Attributes:
        fault: Name of the fault.
        text: Evidence, and the allowed range.
        cable: Index of the cable, or None.
        lasting: Time that it must last until it counts [s].
    """

    fault: Fault
    text: str
    cable: int | None = None
    lasting: float = 0.0


class Checks:
    """Checks of one robot of n cables; call `sent` with each command.

    Attributes:
        robot: Robot description with the limits.
        patience: Time for which measurements may stay the same [s].
        position: Platform position by the newest lengths in W [m], shape (3,), or None.
        tension: Equilibrium tension there [N], shape (n,), or None.
        first_way: Whether the robot is on the first way after a new home, which is gone slowly.
    """

    def __init__(self, robot: Robot, settings: GuardSettings) -> None:
        """Set up for a driver that waits for its robot no longer than the checks do."""
        self.robot = robot
        self._settings = settings
        self._step = settings.step(robot)
        self._lag_spread = LAG_SPREAD * float(robot.winch_lag.max())
        self._tension_mean_time = TENSION_MEAN_TIME.of(Scales(robot).ratios)
        self._speed_max = settings.slowed(robot).speed_max
        self.first_way = False
        self.restart(link_patience=0.0)

    def restart(self, *, link_patience: float) -> None:
        """Forget all samples; `link_patience`: how long the driver waits for its robot [s]."""
        asked = self._settings.stale_time
        if link_patience > 0.0:  # the driver says first whether its link is lost or data stale
            link_patience += LINK_MARGIN_PERIODS * self._settings.period
        self.patience = max(STALE_TIME_S, link_patience) if asked is None else asked
        self._last: Measurement | None = None
        self._newest: Measurement | None = None  # the last one whose samples were new
        self._held = False
        self._silent = 0
        self._count: Counter[Fault] = Counter()
        self._shares: list[Array] = []  # newest measured tensions over equilibrium tensions
        self._usual: Array | None = None  # their mean at the start
        self._equilibrium: statics.Equilibrium | None = None
        self.position: Array | None = None
        self.tension: Array | None = None
        self._origin: Array | None = None
        self.standing(None)

    def prepare(self) -> None:
        """Load the kernels of the checks, which may take seconds, before time counts."""
        robot = self.robot
        position, rotation = robot.home_position[None], robot.home_rotation[None]
        lengths = straight_line.inverse_kinematics(robot, position, rotation)
        straight_line.forward_kinematics(robot, lengths)
        fixed = rotation if robot.n >= DEGREES_OF_FREEDOM else None
        statics.inverse_kinematics(robot, position, fixed)
        if robot.n <= DEGREES_OF_FREEDOM:
            statics.forward_kinematics(robot, lengths)

    def standing(self, length: Array | None) -> None:
        """Take where the winches stand and are commanded to [m], shape (n,); None: no command."""
        self._expected = None if length is None else length.copy()
        self._before: Array | None = None  # what was expected at the newest sample
        self._periods = 0  # since then
        self._start: tuple[Array, Array] | None = None  # where it was told to be, and was
        self._speed = np.zeros(self.robot.n)
        self._count.clear()

    def sent(self, motion: WinchMotion) -> None:
        """Predict where the winches should be after a period with this command."""
        if self._expected is None:
            return
        share = -np.expm1(-self._settings.period / self.robot.winch_lag)
        self._expected = self._expected + share * (motion.length[0] - self._expected)
        self._speed = motion.speed[0]
        self._periods += 1

    def measured(
        self, measurement: Measurement, *, homed: bool, held: bool = False
    ) -> Finding | None:
        """Return the surest finding of a measurement that has lasted long enough, or None.

        Args:
            measurement: Newest measurement.
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
        return self._ripe([finding for finding in findings if finding is not None])

    def command(self, command: Command, standing: Array, *, first: bool) -> Finding | None:
        """Return why a command must not be sent, or None; lengths [m] of shape (1, n)."""
        robot, settings = self.robot, self._settings
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
        # a late sample is no fault of the controller; one that is too late has a name of its own
        late = max(self._age(self._last) - SAMPLE_AGE_S, 0.0)
        limit, which = self._step + late * self._speed_max, "a command"
        if first:
            limit, which = np.minimum(settings.first_max, self._step), "the first command"
        if (k := _worst(far - limit)) is not None:
            text = f"{which} is {far[k]:.3f} m from where the winch stands; allowed: {limit[k]:g} m"
            return Finding(fault=Fault.COMMAND, text=text, cable=k)
        return None

    def belief(self, belief: Belief) -> Finding | None:
        """Return a finding where a belief is far from the position of the lengths."""
        if self.position is None:
            return None
        far = float(np.linalg.norm(belief.position[0] - self.position))
        if far <= self._settings.belief_max:
            return None
        text = f"the estimated position is {far:.2f} m from that of the lengths; allowed: "
        return Finding(fault=Fault.ESTIMATOR, text=text + f"{self._settings.belief_max:g} m")

    def _stale(self, measurement: Measurement) -> Finding | None:
        """Require new samples."""
        last, settings = self._last, self._settings
        advanced = last is None or _sampled(measurement) > _sampled(last)
        self._silent = 0 if advanced else self._silent + 1
        silent = self._silent * settings.period
        if self._silent < 2 or silent <= self.patience:
            return None
        text = f"no new sample for {silent:.3f} s; allowed: {self.patience:g} s"
        return Finding(fault=Fault.STALE_DATA, text=text)

    def _jump(self, measurement: Measurement, *, still: bool) -> Finding | None:
        """Require lengths to change as commanded, and no faster than a winch turns."""
        newest, before, expected = self._newest, self._before, self._expected
        passed = 0.0 if newest is None else _sampled(measurement) - _sampled(newest)
        span = self._periods * self._settings.period
        if newest is None or passed > 0.0:  # what is expected counts since the newest sample
            self._newest, self._before, self._periods = measurement, expected, 0
        if newest is None:
            return None
        change = (measurement.unstrained_length - newest.unstrained_length)[0]
        allowed = np.full(self.robot.n, self._settings.jump_max)
        if expected is None or before is None:
            allowed += (0.0 if still else max(passed, 0.0)) * self.robot.speed_max
        elif passed > 0.0:
            asked, period = expected - before, self._settings.period
            uneven = abs(passed - max(span, period)) + 0.5 * period  # samples come when they come
            change = change - asked
            allowed += uneven * np.maximum(np.abs(self._speed), np.abs(asked) / max(span, period))
        else:  # the clock of the samples stands still
            allowed += np.abs(expected - before)
        if (i := _worst(np.abs(change) - allowed)) is None:
            return None
        text = f"the length jumped by {change[i]:+.3f} m; allowed: {allowed[i]:.3f} m"
        return Finding(fault=Fault.ENCODER_JUMP, text=text, cable=i)

    def _direction(self, measurement: Measurement) -> Finding | None:
        """Require winches to turn the way they were commanded to, since they stood."""
        if self._expected is None:
            return None
        measured = measurement.unstrained_length[0]
        if self._start is None:
            self._start = (self._expected.copy(), measured.copy())
        asked, done = self._expected - self._start[0], measured - self._start[1]
        allowed = self._settings.direction_max + self._late(measurement)
        against = np.where(asked * done < 0.0, np.minimum(np.abs(asked), np.abs(done)), 0.0)
        if (i := _worst(against - allowed)) is None:
            return None
        text = (
            f"told to change by {asked[i]:+.3f} m, and changed by {done[i]:+.3f} m: it turns the "
            "other way"
        )
        return Finding(fault=Fault.FOLLOWING_ERROR, text=text, cable=i, lasting=FAULT_DURATION_S)

    def _late(self, measurement: Measurement) -> Array:
        """Return motion that differing lags and the age of a sample explain [m], shape (n,)."""
        return np.asarray((self._lag_spread + self._age(measurement)) * np.abs(self._speed))

    def _age(self, measurement: Measurement | None) -> float:
        """Return the age of a sample [s], as far as it may go unnoticed."""
        if measurement is None:
            return 0.0
        return float(np.clip(measurement.time[0] - _sampled(measurement), 0.0, self.patience))

    def _following(self, measurement: Measurement) -> Finding | None:
        """Require winches to be where they were commanded to be, after their lag."""
        if self._expected is None:
            return None
        error = np.abs(measurement.unstrained_length[0] - self._expected)
        allowed = self._settings.following_max + self._late(measurement)
        if (i := _worst(error - allowed)) is None:
            return None
        text = f"{error[i]:.3f} m from where the winch should be; allowed: {allowed[i]:.3f} m"
        return Finding(fault=Fault.FOLLOWING_ERROR, text=text, cable=i, lasting=FAULT_DURATION_S)

    def _pose(self, measurement: Measurement) -> list[Finding | None]:
        """Check closure, tensions and workspace."""
        lengths = measurement.unstrained_length
        try:
            closure = self._closure(lengths)
            if self.robot.n <= DEGREES_OF_FREEDOM:
                self._rest(lengths)
        except InvalidField as error:  # not a length
            return [Finding(fault=Fault.CLOSURE, text=str(error))]
        shift = self._tension_shift(measurement)
        self._end_first_way()
        return [closure, shift, self._tension(measurement), self._workspace()]

    def _closure(self, lengths: Array) -> Finding | None:
        """Require one straight-line pose that explains all lengths."""
        fit = straight_line.forward_kinematics(self.robot, lengths)
        self.position = fit.position[0]
        residual, limit = float(fit.residual[0]), self._settings.closure_max
        if fit.converged[0] and residual <= limit:
            return None
        text = f"{residual:.3f} m (rms) of the lengths fit no pose; allowed: {limit:g} m"
        return Finding(fault=Fault.CLOSURE, text=text, lasting=FAULT_DURATION_S)

    def _rest(self, lengths: Array) -> None:
        """Find pose and tensions at rest; without any the straight-line position stays."""
        rest = statics.forward_kinematics(self.robot, lengths, guess=self._equilibrium)
        converged = bool(rest.converged[0])
        self._equilibrium = rest if converged else None
        self.tension = rest.tension[0] if converged else None
        if converged:
            self.position = rest.position[0]

    def _tension_shift(self, measurement: Measurement) -> Finding | None:
        """Require measured tensions to go with those of the lengths, where that is asked for.

        Lengths that follow their commands to the millimetre may still be wrong: a winch that turns
        the other way than the robot file says tilts the platform, and loads its cables crosswise.
        """
        settings, measured = self._settings, measurement.tension
        limit = settings.tension_shift_max
        if limit is None and self.first_way:
            limit = settings.first_shift_max
        if limit is None or measured is None or self.tension is None:
            return None
        span = max(1, round(self._tension_mean_time / settings.period))
        self._shares = [*self._shares[1 - span :], measured.value[0] / self.tension]
        mean = np.mean(self._shares, axis=0)
        if self._expected is None or self._usual is None:
            self._usual = mean  # standing still
        change = mean / self._usual - 1.0
        i = int(np.argmax(np.abs(change)))
        if abs(change[i]) <= limit:
            return None
        text = (
            f"the tension of cable '{self.robot.cable_names[i]}' is {100 * change[i]:+.0f} % off "
            f"what the lengths say; allowed: {100 * limit:g} %. Does a winch turn the other way "
            "than its sign in the robot file, or by another scale?"
        )
        return Finding(fault=Fault.CLOSURE, text=text)

    def _end_first_way(self) -> None:
        """End the first way once the platform is far enough from where it stood."""
        if not self.first_way or self.position is None:
            return
        if self._expected is None or self._origin is None:
            self._origin = self.position.copy()
        far = float(np.linalg.norm(self.position - self._origin))
        self.first_way = far < self._settings.first_way

    def _tension(self, measurement: Measurement) -> Finding | None:
        """Check measured tensions, else those of rest where the lengths determine them."""
        low, high = self.robot.tension_min, self.robot.tension_max
        tension, source = self.tension, "estimated"
        if measurement.tension is not None:
            tension, source = measurement.tension.value[0], "measured"
        if tension is None or (i := _worst(np.maximum(low - tension, tension - high))) is None:
            return None
        text = f"{tension[i]:.1f} N {source}; allowed: {low[i]:g} N to {high[i]:g} N"
        lasting = self._settings.slack_time if tension[i] < low[i] else FAULT_DURATION_S
        return Finding(fault=Fault.TENSION, text=text, cable=i, lasting=lasting)

    def _workspace(self) -> Finding | None:
        """Require the platform to stay in its box, but for a margin."""
        robot, position = self.robot, self.position
        if position is None:
            return None
        outside = np.maximum(robot.workspace_min - position, position - robot.workspace_max)
        far, limit = float(outside.max()), self._settings.workspace_margin
        if far <= limit:
            return None
        text = f"the platform is {far:.2f} m outside the workspace box; allowed: {limit:g} m"
        return Finding(fault=Fault.WORKSPACE, text=text, lasting=FAULT_DURATION_S)

    def _ripe(self, findings: list[Finding]) -> Finding | None:
        """Count how long findings last; return the first that has lasted long enough."""
        kinds = {finding.fault for finding in findings}
        self._count = Counter({fault: self._count[fault] + 1 for fault in kinds})
        for finding in findings:
            if self._count[finding.fault] * self._settings.period >= finding.lasting - 1e-9:
                return finding
        return None


def _worst(excess: Array) -> int | None:
    """Return the index of the largest excess over a limit, or None where nothing exceeds it."""
    i = int(np.argmax(excess))
    return None if excess[i] <= 0.0 else i  # what is not a number exceeds it


def _sampled(measurement: Measurement) -> float:
    """Return when the newest lengths were measured [s]."""
    rate = measurement.length_rate
    return float(measurement.time[0] if rate is None else rate.time[0])
