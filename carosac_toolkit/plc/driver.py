"""The driver of a robot behind a PLC: one block read and one written a cycle, over any link.

It moves data: lengths in metres become numbers of the PLC and back. Nothing is ever written unless
`PlcDriverSettings.motion` allows it, and then only from `enable` or `reset_fault` until the PLC has
let go. The winches move only after `home` and `enable`. Commands are limited here as in every
driver, and by the PLC again; the guard and the PLC watch for faults.
"""

from __future__ import annotations

import contextlib
import time
from dataclasses import replace

import numpy as np

from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.numbers import check_period
from carosac_toolkit.drivers.ticks import TickSchedule
from carosac_toolkit.loop.drive_state import DriveState, Fault, state_of
from carosac_toolkit.loop.protocols import (
    FaultSource,
    FaultTextSource,
    LinkPatience,
    LinkWatch,
    MotionDriver,
    SupportsFaultHold,
    SupportsSetDown,
)
from carosac_toolkit.loop.values import Command, LimitHit, State
from carosac_toolkit.physics.rest.homing import homing_lengths
from carosac_toolkit.plc import reader
from carosac_toolkit.plc.blocks import Answer, DriveStatus, Injection, Request
from carosac_toolkit.plc.exchange import PlcExchange
from carosac_toolkit.plc.identity import machine_values
from carosac_toolkit.plc.imu_udp import ImuListener
from carosac_toolkit.plc.injection import inject
from carosac_toolkit.plc.link import build_link
from carosac_toolkit.plc.reader import PlcReader
from carosac_toolkit.plc.settings import PlcDriverSettings, Point
from carosac_toolkit.robot.robot import Robot

__all__ = ["PlcDriver", "PlcDriverSettings"]

HOMING_READINGS = 10  # their mean is homed: a third of the noise of one
REST_MARGIN_S = 1.0  # beyond what braking from full speed takes
SETTLING_S = 0.05  # ten cycles of an emulated PLC: data that arrive later are from after a move
_DRIVES_ON = (DriveState.ENABLED, DriveState.FOLLOWING)


class PlcDriver(
    PlcReader, MotionDriver, FaultSource, FaultTextSource, LinkWatch, LinkPatience,
    SupportsFaultHold, SupportsSetDown,
):  # fmt: skip
    """One robot behind a PLC, in real time.

    The clock is that of this host, from `connect` on. The lengths of a measurement are the newest
    that came; the time of its `length_rate` is when the PLC measured them.

    Attributes:
        exchange: The exchange with the PLC; None before `connect` and after `close`.
        link_counters: Counts of that exchange, also after `close`.
    """

    @classmethod
    def build(
        cls, robot: Robot, settings: PlcDriverSettings | None = None, *, seed: int = 0
    ) -> PlcDriver:
        """Make a driver; nothing is random here, so that `seed` has no effect."""
        return cls(robot, settings)

    def connect(self) -> None:
        """Connect to the PLC and read; enable nothing, and home no offset.

        Raises:
            CarosacError: The PLC does not answer, has other data blocks, or is of another robot.
            InvalidField: No such link, a suite with an IMU that the robot file does not have, or
                with tensions that the PLC does not measure.
        """
        if self.exchange is not None:
            raise CarosacError(f"{self.name}: connected already; call close() first")
        settings, source = self._settings, self._hardware_of_file.imu
        if "imu" in settings.suite and source is None:
            raise InvalidField("suite", repr(settings.suite), "'lengths': the robot file has no "
                               "hardware.imu")  # fmt: skip
        link = build_link(settings.link, self._hardware_of_file, settings.for_link)
        exchange = PlcExchange(
            link, machine_values(self._robot), period=settings.io_period, writing=settings.motion
        )
        reading = exchange.open()
        try:
            if "tension" in settings.suite and not reading.values["has_tension"]:
                allowed = "one without tension: the PLC has no load cells (has_tension is 0)"
                raise InvalidField("suite", repr(settings.suite), allowed)
            if settings.motion and settings.start_position is not None and exchange.emulated:
                self._set_down(exchange, settings.start_position)
            if "imu" in settings.suite and source is not None:
                self._imu = ImuListener(source)
        except BaseException:
            exchange.close()
            raise
        self.exchange, self.link_counters = exchange, exchange.counters
        self._hardware = self._hardware_of_file
        self._homed = self._enabled = self._stopped = False
        self._restarts = exchange.counters.restarts
        # any time may pass between connecting and the first cycle
        self._ticks = TickSchedule(settings.period, forgiving=True)

    @property
    def emulated(self) -> bool:
        """True if the PLC is an emulated one, which can set its robot down."""
        return self._connected().emulated

    @property
    def sets_down(self) -> bool:
        """True if the PLC is an emulated one and `PlcDriverSettings.set_down` is set."""
        return self._settings.set_down and self.exchange is not None and self.exchange.emulated

    def set_down(self, position: Point) -> None:
        """Have an emulated PLC set its robot down somewhere, at rest.

        Args:
            position: In W [m].

        Raises:
            CarosacError: Read only, a real PLC, drives that are on, or no equilibrium there.
        """
        exchange = self._connected()
        if not self._settings.motion or not exchange.emulated:
            raise CarosacError(f"{self.name}: set_down() needs motion=True and an emulated PLC")
        self._set_down(exchange, position)

    def home(self, position: State) -> None:
        """Find the offset of each cable from the pose at which the platform stands still.

        Args:
            position: A batch of one. Its lengths count if it has any; else those of equilibrium,
                with six cables or more at its rotation, with fewer at the one it takes by itself.

        Raises:
            CarosacError: Not connected, no fresh data, or enabled.
            InvalidField: The platform cannot rest there.
        """
        exchange = self._connected()
        if self._enabled:
            raise CarosacError(f"{self.name}: home() while enabled; call disable() first")
        lengths = homing_lengths(self._robot, position)
        numbers = []
        for _ in range(HOMING_READINGS):
            if not exchange.wait_for_data(time.monotonic(), reader.ANSWER_TIMEOUT_S):
                raise CarosacError(
                    f"{self.name}: no data from the PLC to home with: {exchange.error}"
                )
            numbers.append(self._reading().values["length"])
        measured = self._hardware.length(np.mean(numbers, axis=0))
        offset = np.array(self._hardware.offset) + lengths - measured
        self._hardware = replace(self._hardware, offset=tuple(offset))
        self._homed = True

    def enable(self) -> None:
        """Have the PLC obey this host and its drives hold; the winches stay where they stand.

        Raises:
            CarosacError: Read only, not homed, a fault, another host, or no answer.
        """
        exchange = self._connected()
        if not self._settings.motion:
            raise CarosacError(f"{self.name}: read only; set motion=True to let the winches move")
        if not self._homed:
            raise CarosacError(f"{self.name}: not homed; call home() first")
        if self.status() in (DriveState.FAULT, DriveState.ESTOP, DriveState.DISCONNECTED):
            raise CarosacError(f"{self.name}: {self.fault_text}; call reset_fault() first")
        self._refuse_other_host()
        self._enabled = True  # from here on the PLC may obey, whatever happens
        try:
            self._request(Request.ENABLE)
            if not exchange.wait_for_data(time.monotonic(), reader.ANSWER_TIMEOUT_S):
                raise CarosacError(f"{self.name}: no data from the PLC: {exchange.error}")
            held = self._hardware.length(self._reading().values["set_length"])
            self._limiter.reset(held[None])
        except BaseException:
            with contextlib.suppress(CarosacError):
                self.disable()
            raise
        self._stopped = False

    def disable(self) -> None:
        """Have the PLC ramp to rest, switch the drives off and release this host.

        Nothing happens if the drives are off. If the PLC does not answer, the request stays and
        the heartbeat ends, so that its watchdog stops the winches and latches a fault.

        Raises:
            CarosacError: No answer, or the PLC obeys another host, which owns the winches.
        """
        self._let_go(Request.DISABLE)

    def hold_fault(self, fault: Fault) -> None:
        """Disable, and have the PLC latch a fault that this host has seen.

        Raises:
            CarosacError: As of `disable`, or the PLC has not latched it.
        """
        self._let_go(Request.HOLD, fault)

    def reset_fault(self) -> None:
        """Clear a latched fault of the PLC, or of a connection that works again.

        Raises:
            CarosacError: The cause is still there, or the PLC obeys another host.
        """
        exchange = self._connected()
        if not self._settings.motion:
            raise CarosacError(f"{self.name}: read only; set motion=True to reset the PLC")
        if exchange.counters.restarts != self._restarts:
            self._restarts = exchange.counters.restarts
            self._homed = self._enabled = False
        if self.link_fault in (Fault.LOST_CONNECTION, Fault.STALE_DATA):
            raise CarosacError(f"{self.name}: {self.fault_text}")
        self._refuse_other_host()
        self._wait_for_rest()
        try:
            self._request(Request.RESET)
            self._enabled = False
        finally:
            if not self._enabled:
                exchange.quiet()
        exchange.wait_for_data(time.monotonic(), reader.ANSWER_TIMEOUT_S)

    def stop(self, reason: str) -> None:
        """Have the PLC ramp all winches to rest together; no command passes until `enable`."""
        if self.exchange is None or not self._settings.motion or self._stopped:
            self._stopped = self._stopped or self.exchange is not None
            return
        self._stopped = True
        if self._enabled:
            self.exchange.request(Request.STOP)

    def close(self) -> None:
        """Come to rest and let go; safe to call twice."""
        exchange = self.exchange
        if exchange is None:
            return
        try:
            self.disable()
        finally:
            self.exchange = None
            self._homed = self._enabled = False
            exchange.close()
            if self._imu is not None:
                self._imu.close()
                self._imu = None

    def command(self, command: Command) -> Command:
        """Limit a command and send it at once.

        Returns:
            The command as sent. If the PLC is stopped or has a fault, nothing is sent: the
            lengths are those measured, and `limited` names ``stopped``. While its data do not
            come, commands go on: a stop of this host must not have a gap when they come again.

        Raises:
            CarosacError: Read only, or not enabled.
        """
        exchange = self._connected()
        shape, wanted = command.unstrained_length.shape, (1, self._robot.n)
        if shape != wanted:
            raise InvalidField("unstrained_length", f"shape {shape}", f"shape {wanted}")
        if not self._enabled:
            raise CarosacError(f"{self.name}: not enabled; call home() and enable() first")
        values = self._reading().values
        actual = self._hardware.length(values["length"])[None]
        silent = self.link_silent
        state = state_of(values["state"]) if silent else self.state
        if self._stopped or state not in _DRIVES_ON:
            hits = tuple(
                LimitHit(limit="stopped", cable=i, asked=float(asked), sent=float(held))
                for i, (asked, held) in enumerate(
                    zip(command.unstrained_length[0], actual[0], strict=True)
                )
                if asked != held
            )
            return Command(
                time=command.time, unstrained_length=actual, limited=(*command.limited, *hits)
            )
        sent = self._limiter.apply(command, None if silent else actual)
        rate = self._limiter.motion.speed[0] if sent.length_rate is None else sent.length_rate[0]
        hardware = self._hardware
        exchange.send(
            hardware.number(sent.unstrained_length[0]), rate / hardware.unit, self._settings.period
        )
        return sent

    def wait(self, duration: float) -> bool:
        """Wait for the next tick of an absolute schedule.

        Returns:
            False once stopped, if the PLC does not answer, and, with `motion`, if it has a fault.

        Raises:
            InvalidField: A duration other than the period, by which the limits are computed.
        """
        self._connected()
        check_period(duration, self._settings.period, "driver")
        self._ticks.wait()
        if not self._settings.motion:  # reading goes on while the drives hold a fault
            return not self._stopped and self.link_fault is Fault.NONE
        return not self._stopped and self.state not in (DriveState.FAULT, DriveState.ESTOP)

    def _let_go(self, request: Request, fault: Fault = Fault.NONE) -> None:
        """Disable if the drives may be on, or hold a fault in any case."""
        exchange = self.exchange
        if exchange is None or not self._settings.motion:
            return
        if request is Request.DISABLE and not self._enabled:
            return
        self._enabled = False
        if not exchange.other:
            answer = exchange.request(request, reader.ANSWER_TIMEOUT_S, fault=fault.number)
            if answer not in (Answer.NONE, Answer.NOT_OWNER):
                self._wait_for_rest()
            if answer is not Answer.NONE:
                exchange.quiet()
            what = "disable" if request is Request.DISABLE else f"hold {fault}"
            if answer is Answer.NONE or (request is Request.HOLD and answer is not Answer.DONE):
                raise CarosacError(f"{self.name}: the PLC does not {what}: {_REFUSALS[answer]}")
        self._refuse_other_host()

    def _refuse_other_host(self) -> None:
        """Refuse to write while the PLC obeys another host."""
        exchange = self._connected()
        if exchange.other:  # it may have been released since
            exchange.wait_for_data(time.monotonic(), reader.ANSWER_TIMEOUT_S)
        other = exchange.other
        if other:
            raise CarosacError(
                f"{self.name}: the PLC obeys another host, number {other}; disable it there first"
            )

    def _request(self, request: Request) -> None:
        """Send a request and refuse every answer but `Answer.DONE`."""
        answer = self._connected().request(request, reader.ANSWER_TIMEOUT_S)
        if answer is Answer.DONE:
            return
        raise CarosacError(
            f"{self.name}: the PLC refused to {request.name.lower()}: {_REFUSALS[answer]}; it is "
            f"{self.status()}, and obeys host number {self._reading().values['owner']}"
        )

    def _wait_for_rest(self) -> None:
        """Wait until no drive moves, at most as long as braking can take."""
        robot, exchange = self._robot, self._connected()
        end = time.monotonic() + float((robot.speed_max / robot.acceleration_max).max())
        while time.monotonic() < end + REST_MARGIN_S:
            status = self._reading().values["drive_status"]
            if not (status == DriveStatus.MOVING).any() and self._reading().values["state"] != (
                DriveState.STOPPING.number
            ):
                return
            if not exchange.wait_for_data(time.monotonic(), reader.ANSWER_TIMEOUT_S):
                return

    def _set_down(self, exchange: PlcExchange, position: Point) -> None:
        """Have an emulated PLC set its robot down, and wait for data from after that."""
        inject(exchange, self._robot.n, Injection.PLACE, position=position)
        end = time.monotonic() + SETTLING_S
        exchange.wait_for_data(end, reader.ANSWER_TIMEOUT_S)


_REFUSALS = {
    Answer.NONE: "no answer",
    Answer.NOT_OWNER: "it obeys another host",
    Answer.WRONG_STATE: "not in this state",
    Answer.CAUSE_REMAINS: "the cause of the fault is still there",
    Answer.UNKNOWN: "it does not know this request",
    Answer.ANOTHER_ROBOT: "it is of another robot than the robot file",
}
