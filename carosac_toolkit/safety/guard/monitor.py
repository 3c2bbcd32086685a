"""Monitor of a guard: measures, judges, latches and journals, on the way to and from the driver."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.drive_state import DriveState, Fault
from carosac_toolkit.loop.protocols import Driver
from carosac_toolkit.loop.values import Command, Measurement
from carosac_toolkit.physics.motion.braking import WinchMotion
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.safety.guard.checks import Checks, Finding
from carosac_toolkit.safety.guard.inner import (
    described,
    error_finding,
    holds_fault,
    inner_finding,
    link_patience,
)
from carosac_toolkit.safety.guard.journal import Journal
from carosac_toolkit.safety.guard.lifecycle import UNHOMING_FAULTS, FaultReport, Lifecycle
from carosac_toolkit.safety.guard.row_queue import RowQueue
from carosac_toolkit.safety.guard.settings import GuardSettings

LOST_AT_REST_S = 1.0  # silence of the driver that is a fault also where nothing moves
WRITE_AHEAD_SHARE = 0.25  # of a period, for which a command waits for its row
LIVE_ONLY_FAULTS = (Fault.TENSION, Fault.FOLLOWING_ERROR)  # no fault of a robot that nobody drives


class Monitor:
    """All that passes between a guard and the driver behind it, for one connection.

    Attributes:
        inner: The driver behind the guard.
        robot: Robot description with the limits.
        settings: Settings of the guard.
        real_time: Whether time is wall-clock time.
        lifecycle: State and latched fault.
        checks: Checks of measurements and commands.
        rows: Queue in front of the journal.
        offset: Lengths that homing adds to readings and takes from commands [m], shape (n,).
        sent: Whether this period has its command.
        unwritten: Count of commands that were sent before their row was written.
        measured: Newest measurement, or None.
        finding: Finding of the last measurement, latched or not, or None.
        held: Fault that the drives hold, by the last measurement or as they were handed it, or
            None; it does not end a dry run.
    """

    def __init__(
        self, inner: Driver, robot: Robot, settings: GuardSettings, *, real_time: bool,
        journal: Callable[[], Journal],
    ) -> None:  # fmt: skip
        """Know nothing of the robot yet; `journal` returns the one to write to."""
        self.inner, self.robot, self.settings = inner, robot, settings
        self.real_time = real_time
        self._journal = journal
        self.lifecycle = Lifecycle(self.event)
        self.checks = Checks(robot, settings)
        self.restart_checks()
        self.rows = RowQueue(
            lag=settings.record_lag, threaded=real_time, describe=_describe_write_error
        )
        self.offset = np.zeros(robot.n)
        self.sent = False
        self.unwritten = 0
        self.measured: Measurement | None = None
        self.finding: Finding | None = None
        self.held: Finding | None = None
        self._lost_time = 0.0

    @property
    def journal(self) -> Journal:
        """The journal to write to, by `note`."""
        return self._journal()

    @property
    def now(self) -> Array:
        """The driver's time [s], shape (1,)."""
        return np.zeros(1) if self.measured is None else np.asarray(self.measured.time)

    def restart_checks(self) -> None:
        """Have the checks forget all samples."""
        self.checks.restart(link_patience=link_patience(self.inner))

    def measure(self) -> Measurement:
        """Return what the driver measures, with the offsets of homing; checked and journaled.

        Raises:
            InvalidField: An impossible measurement, such as a length that is not a number; that is
                latched.
            CarosacError: It cannot measure; that is latched as a lost connection.
        """
        measurement: Measurement = self.call(self.inner.measure)
        check_shape(measurement.unstrained_length, self.robot.n)
        if self.offset.any():
            length = measurement.unstrained_length + self.offset
            measurement = replace(measurement, unstrained_length=length)
        self.measured = measurement
        self._judge(measurement)
        self.note(self.journal.measured, measurement)
        return measurement

    def send(self, command: Command, motion: WinchMotion, asked: Command | None) -> Command:
        """Journal a command, hand it to the driver, and its motion to the checks.

        Its row comes first, so that no length reaches the drives that a killed process would not
        have recorded; a recording that blocks holds it up for `WRITE_AHEAD_SHARE` of a period.
        Where the driver changes the command, a second row of the same time says so.
        """
        self.sent = True
        self.checks.sent(motion)
        self.note(self.journal.sent, asked, command, really=True)
        self.unwritten += not self.rows.written(WRITE_AHEAD_SHARE * self.settings.period)
        shifted = command
        if self.offset.any():
            shifted = replace(command, unstrained_length=command.unstrained_length - self.offset)
        try:
            sent: Command = self.call(self.inner.command, shifted)
        except Exception as error:
            self.event("not_sent", described(error))
            raise
        if sent.limited == command.limited and np.array_equal(
            sent.unstrained_length, shifted.unstrained_length
        ):
            return command
        sent = replace(sent, unstrained_length=sent.unstrained_length + self.offset)
        self.note(self.journal.sent, asked, sent, really=True)
        return sent

    def pass_period(self) -> bool:
        """Let one period pass on the driver; latch the fault that has ended it."""
        self.sent = False
        life = self.lifecycle
        alive = bool(self.call(self.inner.wait, self.settings.period))
        following = life.state is DriveState.FOLLOWING
        finding = None if alive or life.ended else inner_finding(self.inner, following=following)
        if finding is not None and (life.live or self._counts_at_rest(finding)):
            self.latch(finding)
        return alive

    def latch(self, finding: Finding) -> None:
        """Latch a finding as the fault, unless there is one."""
        cable = None if finding.cable is None else self.robot.cable_names[finding.cable]
        report = FaultReport(
            fault=finding.fault, text=finding.text, cable=cable, time=float(self.now[0])
        )
        self.lifecycle.latch(report)

    def call(self, method: Callable[..., Any], *arguments: Any) -> Any:
        """Call the driver; where it fails that is latched.

        An `InvalidField` of `command` is left to the caller, as the command is to blame.
        """
        try:
            return method(*arguments)
        except Exception as error:
            if not (isinstance(error, InvalidField) and method == self.inner.command):
                own = None if isinstance(error, InvalidField) else inner_finding(self.inner)
                self.latch(error_finding(error) if own is None else own)
            raise

    def quietly(self, method: Callable[..., Any], *arguments: Any) -> None:
        """Call where an error must not keep the rest from happening; it is journaled."""
        try:
            method(*arguments)
        except Exception as error:
            self.event("error", described(error))

    def event(self, name: str, text: str) -> None:
        """Journal an event."""
        self.note(self.journal.event, float(self.now[0]), name, text)

    def note(self, method: Callable[..., None], *arguments: Any, **named: Any) -> None:
        """Call a method of the journal; a recording that fails is a fault."""
        self.rows.put(method, *arguments, **named)
        if self.lifecycle.fault is None:
            trouble = self.rows.trouble
            if trouble is not None:
                text = f"the recording failed: {trouble}"
                self.latch(Finding(fault=Fault.RECORDING, text=text))

    def _judge(self, measurement: Measurement) -> None:
        """Latch what is wrong with a measurement, or with the driver that it came from."""
        life = self.lifecycle
        own = inner_finding(self.inner, following=life.state is DriveState.FOLLOWING)
        of_drives = own is not None and holds_fault(self.inner)
        self.held = own if of_drives else None
        if of_drives and not self.settings.motion:
            own = None  # who only reads may look at drives that hold a fault
        at_rest = life.fault is not None and not life.live
        seen = self.checks.measured(measurement, homed=life.homed, held=at_rest)
        self.finding = seen if own is None else own
        lost = own is not None and own.fault is Fault.LOST_CONNECTION and not of_drives
        self._lost_time = self._lost_time + self.settings.period if lost else 0.0
        if own is not None and (life.live or of_drives or self._counts_at_rest(own)):
            self.latch(own)
        if seen is not None and (life.live or self._counts_at_rest(seen)):
            if own is None or seen.fault in UNHOMING_FAULTS:
                self.latch(seen)

    def _counts_at_rest(self, finding: Finding) -> bool:
        """Return whether a finding is a fault where nobody drives the winches."""
        if finding.fault is Fault.LOST_CONNECTION:
            return self._lost_time > LOST_AT_REST_S
        return finding.fault not in LIVE_ONLY_FAULTS


def check_shape(lengths: Array, n: int) -> None:
    """Refuse another number of robots or cables."""
    if lengths.shape != (1, n):
        raise InvalidField("unstrained_length", f"shape {lengths.shape}", f"shape (1, {n})")


def _describe_write_error(error: Exception) -> str:
    """Return the text of an error of a journal, that of the system where there is one."""
    system_text = error.strerror if isinstance(error, OSError) else None
    return system_text or described(error)
