"""What a guard knows: the driver behind it, its state and fault, what is measured and recorded."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.loop.drive_state import DriveState, Fault
from carosac_toolkit.loop.protocols import TruthSource
from carosac_toolkit.loop.values import Belief, Command, Measurement, State
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.safety.guard.checks import Checks, Finding
from carosac_toolkit.safety.guard.commander import Commander
from carosac_toolkit.safety.guard.inner import described, error_finding, holds_fault, inner_finding
from carosac_toolkit.safety.guard.journal import Journal, Silence
from carosac_toolkit.safety.guard.lifecycle import UNHOMED, FaultReport, Lifecycle
from carosac_toolkit.safety.guard.row_queue import Scribe
from carosac_toolkit.safety.guard.settings import GuardSettings
from carosac_toolkit.safety.guard.timing import Punctuality, Watchdog

GONE = 1.0  # silence of the driver behind that is a fault also where nothing moves [s]
LIVE_ONLY = (Fault.TENSION, Fault.FOLLOWING_ERROR)  # no fault of a robot that nobody drives


class GuardCore:
    """A driver and what is known of it; the base of `carosac_toolkit.safety.guard.guard`.

    Attributes:
        inner: The driver behind the guard.
        settings: As they were given.
        real_time: Whether the clock on the wall counts.
        journal: Hears of everything; set it before `connect`. In real time it is called from a
            thread of its own: one that blocks holds nobody up, and is a fault after `record_lag`.
        finding: What the last measurement showed, latched or not.
        held: The fault that the drives hold, by the last measurement or as they were handed it, or
            None; it does not end a dry run.
        cleared: What the drives held when `connect` reset them, or None.
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
        self.cleared: Finding | None = None
        self.held: Finding | None = None
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
            check_shape(got.unstrained_length, self._robot.n)
            if self._out.offset.any():
                got = replace(got, unstrained_length=got.unstrained_length + self._out.offset)
            self._measured = got
            self._judge(got)
            self._note(self.journal.measured, got)
            return got

    def truth(self) -> State | None:
        """The truth, where the driver behind knows it."""
        with self._lock:
            return self.inner.truth() if isinstance(self.inner, TruthSource) else None

    def end(self, reason: str) -> None:
        """Have `wait` say False, so that the loop stops; safe in a signal handler.

        The first reason is the one that counts.
        """
        self.ending = self.ending or reason

    def end_recording(self) -> None:
        """Give the journal some seconds for its last rows; nothing is recorded afterwards."""
        self.unrecorded = self._scribe.end()

    def believe(self, belief: Belief) -> None:
        """Latch a belief that is far from what the lengths say."""
        with self._lock:
            self._note(self.journal.believed, belief)
            found = self._checks.belief(belief) if self._life.homed else None
            if found is not None:
                self.latch(found)

    def fail(self, part: str, error: BaseException) -> None:
        """Latch what the estimator, the controller or, while the winches follow, all else raised.

        Whatever is to blame is known already where a fault is latched.
        """
        if part == "program" and not self._live:
            return
        fault = Fault.ESTIMATOR if part == "estimator" else Fault.CONTROLLER
        named = getattr(error, "field", "").partition("[")[0]
        if part != "estimator" and named in ("unstrained_length", "length_rate"):
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

    def _check_connected(self) -> None:
        """Refuse to work before `connect` and after `close`."""
        if self._life.state is DriveState.DISCONNECTED:
            raise CarosacError(f"{self.name}: not connected; call connect() first")

    def _judge(self, got: Measurement) -> None:
        """Latch what is wrong with a measurement, or with the driver that it came from."""
        said = inner_finding(self.inner, following=self._life.state is DriveState.FOLLOWING)
        of_drives = said is not None and holds_fault(self.inner)
        self.held = said if of_drives else None
        if of_drives and not self.settings.motion:
            said = None  # who only reads may look at drives that hold a fault
        held = self.fault is not None and not self._live
        seen = self._checks.measured(got, homed=self._life.homed, held=held)
        self.finding = seen if said is None else said
        lost = said is not None and said.fault is Fault.LOST_CONNECTION and not of_drives
        self._gone = self._gone + self.settings.period if lost else 0.0
        if said is not None and (self._live or of_drives or self._counts_at_rest(said)):
            self.latch(said)
        if seen is not None and (self._live or self._counts_at_rest(seen)):
            if said is None or seen.fault in UNHOMED:
                self.latch(seen)

    def _counts_at_rest(self, found: Finding) -> bool:
        """Whether a finding is a fault where nobody drives the winches."""
        if found.fault is Fault.LOST_CONNECTION:
            return self._gone > GONE
        return found.fault not in LIVE_ONLY

    def _now(self) -> Array:
        """The driver's time [s], shape (1,)."""
        return np.zeros(1) if self._measured is None else np.asarray(self._measured.time)

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

    def _send(self, command: Command) -> Command:
        """Hand a command to the driver behind."""
        self._checks.sent(self._out.motion)
        sent: Command = self._call(self.inner.command, command)
        return sent


def _why_not_written(error: Exception) -> str:
    """An error of a journal in words, those of the system where it has some."""
    return getattr(error, "strerror", None) or described(error)


def check_shape(lengths: Array, n: int) -> None:
    """Refuse another number of robots or cables."""
    if lengths.shape != (1, n):
        raise InvalidField("unstrained_length", f"shape {lengths.shape}", f"shape (1, {n})")
