"""The driver `guarded`: lifecycle and safety on top of any other driver, simulated or real.

Without `motion` a run is dry: commands are checked, limited and journaled, and not sent. A fault is
latched: all cables brake together along the path that they are on (`CoordinatedStop`), `wait` says
False, and nothing moves again before `reset_fault`, `enable`, and, where the fault took the homing
with it, `home`.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from carosac_toolkit.arrays import Array
from carosac_toolkit.drivers.drive_state import DriveState, Fault
from carosac_toolkit.drivers.guard_checks import Checks, Finding
from carosac_toolkit.drivers.guard_commander import Commander, changed
from carosac_toolkit.drivers.guard_inner import (
    build_inner,
    described,
    error_finding,
    homing_lengths,
    inner_finding,
)
from carosac_toolkit.drivers.guard_settings import GuardSettings
from carosac_toolkit.drivers.guard_watch import Punctuality, Watchdog
from carosac_toolkit.drivers.journal import Journal, Silence
from carosac_toolkit.drivers.lifecycle import UNHOMED, FaultReport, Lifecycle, NotReady
from carosac_toolkit.drivers.scribe import Scribe
from carosac_toolkit.errors import CarosacError, InvalidField
from carosac_toolkit.number_checks import check_period
from carosac_toolkit.protocols import TruthSource
from carosac_toolkit.robot import Robot
from carosac_toolkit.values import Belief, Command, Measurement, State

SETTLE = 4.0  # winch lags after the last command of a stop until the winches count as at rest
GONE = 1.0  # silence of the driver behind that is a fault also where nothing moves [s]
LIVE_ONLY = (Fault.TENSION, Fault.FOLLOWING_ERROR)  # no fault of a robot that nobody drives
DRIVEN = (DriveState.ENABLED, DriveState.FOLLOWING)


class GuardedDriver:
    """One guarded robot of n cables; a `carosac_toolkit.protocols.MotionDriver`.

    Every call on the driver behind it holds one lock, as a watchdog brakes where the controller
    does not come back. `stop` ends a run; to move again after it, connect anew.

    Attributes:
        inner: The driver behind the guard.
        settings: As they were given.
        real_time: Whether the clock on the wall counts.
        journal: Hears of everything; set it before `connect`. In real time it is called from a
            thread of its own: one that blocks holds nobody up, and is a fault after `record_lag`.
        finding: What the last measurement showed, latched or not.
        home_change: By how much the last homing changed the readings [m], shape (n,), or None.
        refused: What would have been a fault in a dry run, counted by text.
        ending: Why `end` was called, or None.
        on_hang: Called by the watchdog once it has stopped the winches of a hanging controller.
        unrecorded: What the journal never heard of [rows]; counted in `close`.
    """

    Settings: ClassVar[type[GuardSettings]] = GuardSettings
    name: ClassVar[str] = "guarded"

    def __init__(
        self, inner: Any, robot: Robot, settings: GuardSettings, *, real_time: bool
    ) -> None:
        """Guard a driver; `robot` says the limits, `real_time` whether a clock runs."""
        self.inner = inner
        self.settings = settings
        self._robot, self.real_time = robot, real_time
        self._lock = threading.RLock()
        self._life = Lifecycle(self._event)
        self.journal: Journal = Silence()
        self.on_hang: Callable[[], None] | None = None
        self._forget()

    @classmethod
    def build(
        cls, robot: Robot, settings: GuardSettings | None = None, *, seed: int = 0
    ) -> GuardedDriver:
        """Make the driver behind it by name, for the same robot and seed.

        Raises:
            InvalidField: A driver that replays, or settings that it does not have.
        """
        chosen = settings or cls.Settings()
        inner, real_time = build_inner(robot, chosen, seed)
        return cls(inner, robot, chosen, real_time=real_time)

    def _forget(self) -> None:
        """Know nothing of the robot."""
        self._life.fault = None
        self._checks = self._new_checks()
        self._out = Commander(self._robot, self.settings, self._send)
        self._time = Punctuality(self.settings, real_time=self.real_time)
        self._measured: Measurement | None = None
        self._watchdog: Watchdog | None = None
        self._live = self._ended = False
        self._gone = 0.0
        self._scribe = Scribe(
            lag=self.settings.record_lag, threaded=self.real_time, describe=_why_not_written
        )
        self.unrecorded = 0
        self.finding: Finding | None = None
        self.home_change: Array | None = None
        self.ending: str | None = None
        self.refused: dict[str, int] = {}

    def _new_checks(self) -> Checks:
        """Checks that know nothing yet."""
        checks = Checks(self._robot, self.settings)
        if self.settings.stale_time is None:
            checks.patience = max(checks.patience, getattr(self.inner, "lost_after", 0.0))
        return checks

    @property
    def state(self) -> DriveState:
        """Where the lifecycle stands; `ESTOP` where the driver behind says so."""
        state = self._life.state
        if state is DriveState.FAULT and hasattr(self.inner, "status"):
            return DriveState.ESTOP if self.inner.status() == DriveState.ESTOP else state
        return state

    def status(self) -> str:
        """The same in one word."""
        return str(self.state)

    @property
    def fault(self) -> FaultReport | None:
        """What was latched first, or None."""
        return self._life.fault

    @property
    def overruns(self) -> int:
        """Cycles since `connect` whose command took longer than a period, in real time."""
        return self._time.late

    # --- Lifecycle -------------------------------------------------------------------------------

    def connect(self) -> None:
        """Connect the driver behind; homed and enabled at once where the settings say so.

        Raises:
            IllegalTransition: It is connected.
            CarosacError: What the driver behind says, or why it cannot be enabled.
        """
        with self._lock:
            self._life.allow("connect")
            self._forget()
            self._checks.prepare()
            self.inner.connect()
            self._checks = self._new_checks()  # the driver now knows how patient it must be
            self._life.go(DriveState.CONNECTED)
            try:
                if self.settings.reset_at_once and self.settings.motion:
                    self._reset_inner()
                self.measure()
                if self.settings.enable_at_once and self.settings.motion:
                    self._check_held()
                    self.home(self._start(), anew=self.settings.home_anew)
                    self.enable()
                elif self.settings.rehearse and not self.settings.motion:
                    self.home(self._start(), anew=self.settings.home_anew)
                    self._ready_to_enable()
            except BaseException:
                self.close()
                raise
            if self.real_time:
                period = self.settings.period
                self._watchdog = Watchdog(
                    period, lambda: self._time.waited, self._miss, self._miss_failed
                )
                self._watchdog.start()

    def _reset_inner(self) -> None:
        """Clear the fault that the driver behind holds from an earlier run; it must be homed."""
        held = inner_finding(self.inner)
        if held is not None and hasattr(self.inner, "reset_fault"):
            self._event("reset", f"{held.fault}: {held.text}")
            self.inner.reset_fault()

    def _check_held(self) -> None:
        """Refuse to move drives that hold a fault, as one of an earlier run or case."""
        held = inner_finding(self.inner)
        if held is not None:
            raise NotReady(
                f"enable: the drives hold a fault of before: {held.fault}: {held.text}. "
                f"{held.fault.meaning} Find out why, then reset it (--reset, reset_at_once=True)"
            )

    def home(self, position: State, *, anew: bool = False) -> None:
        """Find the offset of each cable; the platform stands still at this pose.

        Args:
            position: A batch of one. Its lengths count if it has some; else those of the statics:
                with six cables or more at its rotation, with fewer at that of rest.
            anew: Whether offsets may change by more than `GuardSettings.home_change_max`, such as
                where they were never found before; only for a pose that was measured.

        Raises:
            IllegalTransition: Not connected, or enabled.
            NotReady: The lengths change, there is a fault, or an offset would change by too much.
            InvalidField: No pose of rest.
        """
        with self._lock:
            self._life.allow("home")
            lengths = homing_lengths(self._robot, position)
            standing = self._standing_still()
            if not anew:
                self._check_home(lengths - standing)
            if hasattr(self.inner, "home"):
                self.inner.home(replace(position, unstrained_length=lengths[None]))
            else:
                self._out.offset = self._out.offset + (lengths - standing)
            self._checks = self._new_checks()
            self._life.go(DriveState.HOMED)
            self.home_change = lengths - standing
            said = ", ".join(f"{x:+.4f}" for x in self.home_change)
            self._event("home", f"readings changed by {said} m")
            self.measure()

    def enable(self) -> None:
        """Let commands through, from where the winches stand.

        Raises:
            IllegalTransition: Not homed.
            NotReady: The settings forbid motion, the lengths change, or a check finds something.
            InvalidField: The winches stand outside their limits.
            CarosacError: What the driver behind says.
        """
        with self._lock:
            self._life.allow("enable")
            if not self.settings.motion:
                raise NotReady("enable: this guard is read only; set motion=True on purpose")
            standing = self._ready_to_enable()
            if hasattr(self.inner, "enable"):
                self.inner.enable()
            self._checks.standing(standing)
            self._time.warm_up()
            self._live, self._ended = True, False
            self._life.go(DriveState.ENABLED)

    def _ready_to_enable(self) -> Array:
        """Where the winches stand [m], shape (n,), once nothing speaks against enabling."""
        standing = self._standing_still()
        if self.finding is not None:
            raise NotReady(f"enable: {self.finding.fault}: {self.finding.text}")
        self._out.start(standing)
        return standing

    def disable(self) -> None:
        """Come to rest along the path and let no command through; `enable` may follow."""
        with self._lock:
            self._life.allow("disable")
            self._run_down()

    def reset_fault(self) -> None:
        """Clear the latched fault, once its cause is gone and the winches are at rest.

        Raises:
            IllegalTransition: There is no fault.
            NotReady: The cause is still there; the fault stays.
            CarosacError: What the driver behind says; the fault stays.
        """
        with self._lock:
            self._life.allow("reset_fault")
            self._run_down()
            if hasattr(self.inner, "reset_fault"):
                self.inner.reset_fault()
            self.measure()  # a length that jumped since the last one costs the homing
            latched, self._life.fault = self._life.fault, None
            self._checks = self._new_checks()
            try:
                self._standing_still()
                if self.finding is not None:
                    raise NotReady(f"{self.finding.fault}: {self.finding.text}")
            except CarosacError as error:
                self._life.fault = latched
                raise NotReady(f"reset_fault: {error}; the fault stays") from error
            self._life.release()

    # --- The cycle -------------------------------------------------------------------------------

    def measure(self) -> Measurement:
        """What the driver behind measures, with the offsets of homing; checked.

        Raises:
            InvalidField: It measured what cannot be, such as a length that is not a number; that is
                latched.
            CarosacError: It cannot measure; that is latched as a lost connection.
        """
        with self._lock:
            self._check_connected()
            got: Measurement = self._call(self.inner.measure)
            _check_shape(got.unstrained_length, self._robot.n)
            if self._out.offset.any():
                got = replace(got, unstrained_length=got.unstrained_length + self._out.offset)
            self._measured = got
            self._judge(got)
            self._note(self.journal.measured, got)
            return got

    def command(self, command: Command) -> Command:
        """Check, limit and send a command.

        Returns:
            What was really sent, with every limit hit: ``not_enabled`` where nothing was,
            ``warm_up`` in the first cycles, ``stop`` or the name of the fault where the winches
            brake instead.

        Raises:
            InvalidField: Another shape.
            CarosacError: This cycle has its command already.
        """
        with self._lock:
            self._check_connected()
            _check_shape(command.unstrained_length, self._robot.n)
            measured = self._measured if self._measured is not None else self.measure()
            if self._life.state in DRIVEN:
                first = self._life.state is DriveState.ENABLED
                standing = self._out.motion.length if first else measured.unstrained_length
                found = self._checks.command(command, standing[0], first=first)
                if found is not None:
                    self.latch(found)
                elif not self._time.warming:
                    return self._follow(command, measured)
            if self._live:
                return self._brake(command)
            return self._dry_run(command, np.asarray(measured.unstrained_length))

    def wait(self, duration: float) -> bool:
        """Wait to the next tick; a cycle without a command slows down along the path.

        Returns:
            False at a latched fault, after `stop` or `end`, and where the driver behind says so.

        Raises:
            InvalidField: Another duration than the period, for which the limits count.
        """
        with self._lock:
            self._check_connected()
            check_period(duration, self.settings.period, "guard")
            if self._live and not self._out.sent:
                self._brake(None)
            found = self._time.end_cycle()
            if found is not None and self._live:
                self.latch(found)
            alive = self._pass_period()
            self._time.begin()
            return alive and not self._ended and self.ending is None and self.fault is None

    def stop(self, reason: str) -> None:
        """Bring all cables to rest along their path, wait for it, and disable; ends the run."""
        with self._lock:
            if self._life.state is DriveState.DISCONNECTED:
                return
            self._brake_at_once()
            if not self._ended:
                self._event("stop", self.ending or reason)
            self._run_down()
            self._ended = True
            self._quietly(self.inner.stop, reason)

    def close(self) -> None:
        """Come to rest and let go."""
        watchdog = self._watchdog
        try:
            with self._lock:
                self._watchdog = None
                try:
                    self._run_down()
                finally:
                    self._let_go()
        finally:
            if watchdog is not None:
                watchdog.end()
            self.end_recording()

    def end_recording(self) -> None:
        """Give the journal some seconds for its last rows; nothing is recorded afterwards."""
        self.unrecorded = self._scribe.end()

    def end(self, reason: str) -> None:
        """Have `wait` say False, so that the loop stops; safe in a signal handler.

        The first reason is the one that counts.
        """
        self.ending = self.ending or reason

    def truth(self) -> State | None:
        """The truth, where the driver behind knows it."""
        with self._lock:
            return self.inner.truth() if isinstance(self.inner, TruthSource) else None

    # --- Those who command -----------------------------------------------------------------------

    def believe(self, belief: Belief) -> None:
        """Latch a belief that is far from what the lengths say."""
        with self._lock:
            self._note(self.journal.believed, belief)
            found = self._checks.belief(belief) if self._life.homed else None
            if found is not None:
                self.latch(found)

    def fail(self, part: str, error: BaseException) -> None:
        """Latch what the estimator or controller raised."""
        fault = Fault.ESTIMATOR if part == "estimator" else Fault.CONTROLLER
        named = getattr(error, "field", "").partition("[")[0]
        if part == "controller" and named in ("unstrained_length", "length_rate"):
            fault = Fault.COMMAND
        text = f"the {part} raised {type(error).__name__}: {error}"
        with self._lock:
            self.latch(Finding(fault=fault, text=text))

    def latch(self, found: Finding) -> None:
        """Latch a finding as the fault, unless there is one."""
        cable = None if found.cable is None else self._robot.cable_names[found.cable]
        with self._lock:
            now = float(self._now()[0])
            self._life.latch(FaultReport(fault=found.fault, text=found.text, cable=cable, time=now))

    def _miss(self) -> None:
        """Called by the watchdog: slow down; stop for good where it takes too long."""
        hung = None
        with self._lock:
            if not self._live:
                return
            moving = self._out.slowing or not self._out.at_rest
            slowing = moving and self._life.state is not DriveState.ENABLED
            waited, settings = self._time.waited, self.settings
            if waited > (settings.hang_time if slowing else settings.hang_time_at_rest):
                text = f"the controller gave no command for {waited:.3f} s"
                self.latch(Finding(fault=Fault.CONTROLLER, text=text))
                self._run_down()
                hung = self.on_hang
            elif slowing:
                self._quietly(self._slow_down)
        if hung is not None:
            hung()

    def _miss_failed(self, error: Exception) -> None:
        """The watchdog could not brake: have the driver behind stop by itself."""
        with self._lock:
            self._quietly(self.inner.stop, "the watchdog failed")
            self._quietly(self.latch, error_finding(error))

    # --- Below -----------------------------------------------------------------------------------

    def _check_connected(self) -> None:
        """Refuse to work before `connect` and after `close`."""
        if self._life.state is DriveState.DISCONNECTED:
            raise CarosacError(f"{self.name}: not connected; call connect() first")

    def _check_home(self, change: Array) -> None:
        """Refuse to change the offsets by more than a homing of every day does."""
        i, most = int(np.argmax(np.abs(change))), self.settings.home_change_max
        if abs(change[i]) > most:
            cable = self._robot.cable_names[i]
            raise NotReady(
                f"home: the offset of cable '{cable}' would change by {change[i]:+.3f} m; allowed: "
                f"{most:g} m. Is the platform at the pose that was given? Where that was measured, "
                "home anew (home_anew, --home-anew)"
            )

    def _judge(self, got: Measurement) -> None:
        """Latch what is wrong with a measurement, or with the driver that it came from."""
        said = inner_finding(self.inner, following=self._life.state is DriveState.FOLLOWING)
        held = self.fault is not None and not self._live
        seen = self._checks.measured(got, homed=self._life.homed, held=held)
        self.finding = seen if said is None else said
        lost = said is not None and said.fault is Fault.LOST_CONNECTION
        self._gone = self._gone + self.settings.period if lost else 0.0
        if said is not None and (self._live or self._counts_at_rest(said)):
            self.latch(said)
        if seen is not None and (self._live or self._counts_at_rest(seen)):
            if said is None or seen.fault in UNHOMED:
                self.latch(seen)

    def _counts_at_rest(self, found: Finding) -> bool:
        """Whether a finding is a fault where nobody drives the winches."""
        if found.fault is Fault.LOST_CONNECTION:
            return self._gone > GONE
        return found.fault not in LIVE_ONLY

    def _start(self) -> State:
        """The pose by which `enable_at_once` homes."""
        robot, point = self._robot, self.settings.start_position
        position = robot.home_position if point is None else np.asarray(point, dtype=float)
        rotation = robot.home_rotation
        return State(
            time=np.zeros(1), position=position.reshape(1, 3), rotation=rotation.reshape(1, 3, 3)
        )

    def _now(self) -> Array:
        """The driver's time [s], shape (1,)."""
        return np.zeros(1) if self._measured is None else np.asarray(self._measured.time)

    def _standing_still(self) -> Array:
        """Mean of some samples of winches that stand [m], shape (n,)."""
        lengths = []
        for _ in range(self.settings.homing_samples):
            lengths.append(self.measure().unstrained_length[0])
            self._pass_period()
            if self.fault is not None:
                raise NotReady(str(self.fault))
        moved = float(np.ptp(lengths, axis=0).max())
        if moved > self.settings.rest_max:
            allowed = f"allowed: {self.settings.rest_max:g} m"
            raise NotReady(f"the winches do not stand still: {moved:.4f} m of change; {allowed}")
        return np.asarray(np.mean(lengths, axis=0))

    def _follow(self, command: Command, measured: Measurement) -> Command:
        """Limit and send."""
        if self._out.sent:
            raise CarosacError(f"{self.name}: one command a cycle; call wait() before the next")
        self._life.go(DriveState.FOLLOWING)
        sent = self._out.follow(command, measured.unstrained_length)
        self._note(self.journal.sent, command, sent, really=True)
        return sent

    def _brake(self, asked: Command | None) -> Command:
        """Send the next command of the stop along the path, and journal it."""
        why = "warm_up" if self._time.warming else "stop"
        if self.fault is not None:
            why = str(self.fault.fault)
        already = self._out.sent
        sent = self._out.brake(self._now() if asked is None else asked.time, asked, why)
        if not already:
            self._note(self.journal.sent, asked, sent, really=True)
        return sent

    def _send(self, command: Command) -> Command:
        """Hand a command to the driver behind."""
        self._checks.sent(self._out.motion)
        sent: Command = self._call(self.inner.command, command)
        return sent

    def _dry_run(self, command: Command, held: Array) -> Command:
        """Limit and journal a command, and say that the winches hold."""
        limited = command
        if self.fault is None and not self._ended:
            found = self._checks.command(command, held[0], first=not self._out.dry)
            try:
                if found is not None:
                    raise InvalidField(str(found.fault), found.text, "what `enable` lets through")
                limited = self._out.would_send(command, held)
                self._note(self.journal.sent, command, limited, really=False)
            except InvalidField as error:
                name, value = error.field, str(error.value)
                self.refused[name] = self.refused.get(name, 0) + 1
                self._event("would_be_refused", f"{name}: {value}")
        hits = (*limited.limited, *changed("not_enabled", command, held))
        return Command(time=command.time, unstrained_length=held, limited=hits)

    def _pass_period(self) -> bool:
        """Let one period pass on the driver behind; latch the fault that has ended it."""
        self._out.sent = False
        alive = bool(self._call(self.inner.wait, self.settings.period))
        following = self._life.state is DriveState.FOLLOWING
        found = None if alive or self._ended else inner_finding(self.inner, following=following)
        if found is not None and (self._live or self._counts_at_rest(found)):
            self.latch(found)
        return alive

    def _slow_down(self) -> bool:
        """One period of a stop."""
        if not self._out.sent:
            self._brake(None)
        return self._pass_period()

    def _brake_at_once(self) -> None:
        """Begin a stop before anybody hears of it."""
        if self._live and not self._out.sent:
            self._quietly(self._brake, None)

    def _run_down(self) -> None:
        """Brake along the path until the winches are at rest, then disable, whatever happens."""
        if not self._live:
            return
        try:
            self._brake_at_once()
            if self.fault is None:
                self._life.go(DriveState.STOPPING)
            self._quietly(self._brake_to_rest)
        finally:
            self._live = False
            if hasattr(self.inner, "disable"):
                self._quietly(self.inner.disable)
            self._checks.standing(None)
        if self.fault is None:
            self._life.go(DriveState.HOMED)

    def _let_go(self) -> None:
        """Close the driver behind."""
        if self._life.state is not DriveState.DISCONNECTED:
            self._quietly(self.inner.close)
            self._life.go(DriveState.DISCONNECTED)

    def _brake_to_rest(self) -> None:
        """All cycles of a stop, blind where the driver fails; gives up after `stop_time_max`."""
        period, blind = self.settings.period, 0
        rest = int(np.ceil(SETTLE * self._robot.winch_lag.max() / period))
        for _ in range(int(np.ceil(self.settings.stop_time_max / period))):
            rest -= self._out.at_rest and self._out.slowing
            if rest < 0:
                self._event("at_rest", f"as told, {blind} cycles unseen" if blind else "")
                return
            began = time.monotonic()
            try:
                if not self._slow_down():
                    self._event("let_go", "the driver behind has stopped by itself")
                    return
                self.measure()
            except Exception as error:  # commands may still arrive
                blind += 1
                self._out.sent = False
                if blind == 1:
                    self._event("error", described(error))
                if self.real_time:
                    time.sleep(max(0.0, began + period - time.monotonic()))
        self._event("not_at_rest", f"given up after {self.settings.stop_time_max:g} s")

    def _call(self, method: Callable[..., Any], *arguments: Any) -> Any:
        """Call the driver behind; where it fails that is latched.

        An `InvalidField` of `command` is left to `fail`, as the command is to blame.
        """
        try:
            return method(*arguments)
        except Exception as error:
            if not (isinstance(error, InvalidField) and method == self.inner.command):
                found = error_finding(error)
                said = None if isinstance(error, InvalidField) else inner_finding(self.inner)
                self.latch(found if said is None else said)
            raise

    def _quietly(self, method: Callable[..., Any], *arguments: Any) -> None:
        """Call where an error must not keep the rest from happening; it is journaled."""
        try:
            method(*arguments)
        except Exception as error:
            self._event("error", described(error))

    def _event(self, name: str, text: str) -> None:
        """Journal an event."""
        self._note(self.journal.event, float(self._now()[0]), name, text)

    def _note(self, method: Callable[..., None], *arguments: Any, **named: Any) -> None:
        """Journal; a recording that is none any more is a fault."""
        self._scribe.put(method, *arguments, **named)
        if self.fault is None:
            trouble = self._scribe.trouble
            if trouble is not None:
                text = f"the recording failed: {trouble}"
                self.latch(Finding(fault=Fault.RECORDING, text=text))


def _why_not_written(error: Exception) -> str:
    """An error of a journal in words, those of the system where it has some."""
    return getattr(error, "strerror", None) or described(error)


def _check_shape(lengths: Array, n: int) -> None:
    """Refuse another number of robots or cables."""
    if lengths.shape != (1, n):
        raise InvalidField("unstrained_length", f"shape {lengths.shape}", f"shape (1, {n})")
