"""The driver of a robot behind a TwinCAT PLC: one structure read and one written a cycle over ADS.

It moves data: lengths in metres become numbers of the PLC and back. Nothing is ever written unless
`AdsSettings.motion` says so, and then from `enable` or `reset_fault` until the PLC has let go only.
The winches move only after `home` and `enable`. What may be sent
is limited here as in every driver, and by the PLC again; faults are watched by the guard
(`carosac_toolkit.drivers.guarded`) and by the PLC.
"""

from __future__ import annotations

import contextlib
import time
from dataclasses import replace

import numpy as np

from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.numbers import check_period
from carosac_toolkit.drivers.guard_inner import homing_lengths
from carosac_toolkit.drivers.ticks import TickSchedule
from carosac_toolkit.loop.drive_state import DriveState, Fault
from carosac_toolkit.loop.values import Command, LimitHit, State
from carosac_toolkit.plc import reader
from carosac_toolkit.plc.blocks import Answer, DriveStatus, Request
from carosac_toolkit.plc.exchange import AdsLink
from carosac_toolkit.plc.imu_udp import ImuListener
from carosac_toolkit.plc.reader import AdsReader
from carosac_toolkit.plc.settings import AdsSettings, Point
from carosac_toolkit.robot.robot import Robot

__all__ = ["AdsDriver", "AdsSettings"]

_HOMING = 10  # readings of which the mean is homed
_AFTER_STOP = 1.0  # [s] beyond what braking from full speed takes
_ON = (DriveState.ENABLED, DriveState.FOLLOWING)


class AdsDriver(AdsReader):
    """One robot behind a PLC, in real time.

    The clock is that of this host, from `connect` on. The lengths of a measurement are the newest
    that came; when the PLC measured them is the time of `length_rate`.

    Attributes:
        link: The connection; None before `connect` and after `close`.
        link_counters: What happened on it, also after `close`.
    """

    @classmethod
    def build(
        cls, robot: Robot, settings: AdsSettings | None = None, *, seed: int = 0
    ) -> AdsDriver:
        """Make one; nothing is random here."""
        return cls(robot, settings)

    def connect(self) -> None:
        """Connect to the PLC and read; nothing is enabled, and no offset is homed.

        Raises:
            CarosacError: It does not answer, or has another data block.
            InvalidField: A suite with an IMU, and none in the robot file.
        """
        if self.link is not None:
            raise CarosacError(f"{self.name}: connected already; call close() first")
        settings, address = self._settings, self._named.ads
        if "imu" in settings.suite and self._named.imu is None:
            raise InvalidField("suite", repr(settings.suite), "'lengths': the robot file has no "
                               "hardware.imu")  # fmt: skip
        link = AdsLink(
            address, self._robot.n, period=settings.io_period, writing=settings.motion,
            timeout=settings.timeout or address.timeout,
        )  # fmt: skip
        link.open()
        try:
            if settings.motion and settings.start_position is not None and link.emulated:
                self._place(settings.start_position)
                link.wait_for_data(time.monotonic() + 0.05, reader.ANSWER)
            if "imu" in settings.suite and self._named.imu is not None:
                self._imu = ImuListener(self._named.imu)
        except BaseException:
            link.close()
            raise
        self.link, self.link_counters = link, link.counters
        self._hardware = self._named
        self._homed = self._enabled = self._stopped = False
        self._restarts = link.counters.restarts
        # between connecting and the first cycle any time may pass
        self._ticks = TickSchedule(settings.period, forgiving=True)

    @property
    def emulated(self) -> bool:
        """Whether the PLC is an emulated one."""
        return self._connected().emulated

    def set_down(self, position: Point) -> None:
        """Have an emulated PLC set its robot down somewhere, at rest.

        Args:
            position: In W [m].

        Raises:
            CarosacError: Read only, a real PLC, drives that are on, or no pose of rest.
        """
        link = self._connected()
        if not self._settings.motion or not link.emulated:
            raise CarosacError(f"{self.name}: set_down() wants motion=True and an emulated PLC")
        self._place(position)
        link.wait_for_data(time.monotonic() + 0.05, reader.ANSWER)

    def home(self, position: State) -> None:
        """Find the offset of each cable: the platform stands still at this pose.

        Args:
            position: A batch of one. Its lengths count if it has some; else those of the statics:
                with six cables or more at its rotation, with fewer at that of rest.

        Raises:
            CarosacError: Not connected, no fresh data, or enabled.
            InvalidField: The platform cannot rest there.
        """
        link = self._connected()
        if self._enabled:
            raise CarosacError(f"{self.name}: home() while enabled; call disable() first")
        lengths = homing_lengths(self._robot, position)
        numbers = []
        for _ in range(_HOMING):
            if not link.wait_for_data(time.monotonic(), reader.ANSWER):
                raise CarosacError(f"{self.name}: no data from the PLC to home with: {link.error}")
            numbers.append(self._reading().values["length"])
        said = self._hardware.length(np.mean(numbers, axis=0))
        moved = np.array(self._hardware.offset) + lengths - said
        self._hardware = replace(self._hardware, offset=tuple(moved))
        self._homed = True

    def enable(self) -> None:
        """Have the PLC obey this host and its drives hold; the winches stay where they stand.

        Raises:
            CarosacError: Read only, not homed, a fault, another host, or no answer.
        """
        link = self._connected()
        if not self._settings.motion:
            raise CarosacError(f"{self.name}: read only; set motion=True to let the winches move")
        if not self._homed:
            raise CarosacError(f"{self.name}: not homed; call home() first")
        if self.status() in (DriveState.FAULT, DriveState.ESTOP, DriveState.DISCONNECTED):
            raise CarosacError(f"{self.name}: {self.fault_text}; call reset_fault() first")
        self._alone()
        self._enabled = True  # from here on the PLC may obey, whatever happens
        try:
            self._asked(Request.ENABLE)
            if not link.wait_for_data(time.monotonic(), reader.ANSWER):
                raise CarosacError(f"{self.name}: no data from the PLC: {link.error}")
            held = self._hardware.length(self._reading().values["set_length"])
            self._limiter.reset(held[None])
        except BaseException:
            with contextlib.suppress(CarosacError):
                self.disable()
            raise
        self._stopped = False

    def disable(self) -> None:
        """Ramp to rest, switch the drives off, obey nobody; nothing happens where none is on.

        Where the PLC does not answer, the request stays and the heartbeat ends: its watchdog stops
        the winches.

        Raises:
            CarosacError: The PLC obeys another host, whose winches these are.
        """
        self._let_go(Request.DISABLE)

    def hold_fault(self, fault: Fault) -> None:
        """Disable, and have the PLC hold a fault of this side: nobody moves before a reset.

        Raises:
            CarosacError: As of `disable`, or the PLC has not taken it.
        """
        self._let_go(Request.HOLD, fault)

    def reset_fault(self) -> None:
        """Clear a latched fault of the PLC, or of the connection once it is back.

        Raises:
            CarosacError: Its cause is still there, or the PLC obeys another host.
        """
        link = self._connected()
        if not self._settings.motion:
            raise CarosacError(f"{self.name}: read only; set motion=True to reset the PLC")
        if link.counters.restarts != self._restarts:
            self._restarts = link.counters.restarts
            self._homed = self._enabled = False
        if self.link_fault in (Fault.LOST_CONNECTION, Fault.STALE_DATA):
            raise CarosacError(f"{self.name}: {self.fault_text}")
        self._alone()
        self._wait_for_rest()
        try:
            self._asked(Request.RESET)
            self._enabled = False
        finally:
            if not self._enabled:
                link.quiet()
        link.wait_for_data(time.monotonic(), reader.ANSWER)

    def stop(self, reason: str) -> None:
        """Have the PLC ramp all winches to rest together; no command passes until `enable`."""
        if self.link is None or not self._settings.motion or self._stopped:
            self._stopped = self._stopped or self.link is not None
            return
        self._stopped = True
        if self._enabled:
            self.link.request(Request.STOP)

    def close(self) -> None:
        """Come to rest and let go; safe to call twice."""
        link = self.link
        if link is None:
            return
        try:
            self.disable()
        finally:
            self.link = None
            self._homed = self._enabled = False
            link.close()
            if self._imu is not None:
                self._imu.close()
                self._imu = None

    def command(self, command: Command) -> Command:
        """Limit a command and send it at once.

        Returns:
            What was sent. Where the PLC is stopped or has a fault nothing is: the lengths are
            those measured, and `limited` names ``stopped``.

        Raises:
            CarosacError: Read only, or not enabled.
        """
        link = self._connected()
        shape, wanted = command.unstrained_length.shape, (1, self._robot.n)
        if shape != wanted:
            raise InvalidField("unstrained_length", f"shape {shape}", f"shape {wanted}")
        if not self._enabled:
            raise CarosacError(f"{self.name}: not enabled; call home() and enable() first")
        values = self._reading().values
        actual = self._hardware.length(values["length"])[None]
        if self._stopped or self.state not in _ON:
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
        sent = self._limiter.apply(command, actual)
        rate = self._limiter.motion.speed[0] if sent.length_rate is None else sent.length_rate[0]
        hardware = self._hardware
        link.send(
            hardware.number(sent.unstrained_length[0]), rate / hardware.unit, self._settings.period
        )
        return sent

    def wait(self, duration: float) -> bool:
        """Wait for the next tick of an absolute schedule.

        Returns:
            False once stopped, and where the PLC does not answer, or has a fault and is not only
            read.

        Raises:
            InvalidField: Another duration than the period, for which the limits count.
        """
        self._connected()
        check_period(duration, self._settings.period, "driver")
        self._ticks.wait()
        if not self._settings.motion:  # what reads only may look on at drives that hold a fault
            return not self._stopped and self.link_fault is Fault.NONE
        return not self._stopped and self.state not in (DriveState.FAULT, DriveState.ESTOP)

    def _let_go(self, request: Request, fault: Fault = Fault.NONE) -> None:
        """Disable where the drives may be on, or hold a fault, be they on or not."""
        link = self.link
        if link is None or not self._settings.motion:
            return
        if request is Request.DISABLE and not self._enabled:
            return
        self._enabled = False
        if not link.other:
            answer = link.request(request, reader.ANSWER, fault=fault.number)
            if answer not in (Answer.NONE, Answer.NOT_OWNER):
                self._wait_for_rest()
            if answer is not Answer.NONE:
                link.quiet()
            if request is Request.HOLD and answer is not Answer.DONE:
                raise CarosacError(f"{self.name}: the PLC does not hold {fault}: {_WHY[answer]}")
            if answer is Answer.NONE:
                return
        self._alone()

    def _alone(self) -> None:
        """Refuse to write where the PLC obeys another host."""
        link = self._connected()
        if link.other:  # perhaps it has let go since
            link.wait_for_data(time.monotonic(), reader.ANSWER)
        other = link.other
        if other:
            raise CarosacError(
                f"{self.name}: the PLC obeys another host, session {other}; disable it there first"
            )

    def _asked(self, request: Request) -> None:
        """Ask the PLC; refuse everything but that it is done."""
        answer = self._connected().request(request, reader.ANSWER)
        if answer is Answer.DONE:
            return
        raise CarosacError(
            f"{self.name}: the PLC refused to {request.name.lower()}: {_WHY[answer]}; it is "
            f"{self.status()}, and obeys session {self._reading().values['owner']}"
        )

    def _wait_for_rest(self) -> None:
        """Wait until the drives of the PLC no longer move, as long as braking can take."""
        robot, link = self._robot, self._connected()
        end = time.monotonic() + float((robot.speed_max / robot.acceleration_max).max())
        while time.monotonic() < end + _AFTER_STOP:
            status = self._reading().values["drive_status"]
            if not (status == DriveStatus.MOVING).any() and self._reading().values["state"] != (
                DriveState.STOPPING.number
            ):
                return
            if not link.wait_for_data(time.monotonic(), reader.ANSWER):
                return

    def _place(self, position: Point) -> None:
        """Have an emulated PLC set its robot down."""
        from carosac_toolkit.plc.blocks import Injection
        from carosac_toolkit.plc.emulator.client import PlcClient

        with PlcClient(self._robot.n, self._named.ads.ip) as client:
            client.inject(Injection.PLACE, position=position)


_WHY = {
    Answer.NONE: "no answer",
    Answer.NOT_OWNER: "it obeys another host",
    Answer.WRONG_STATE: "not in this state",
    Answer.CAUSE_REMAINS: "the cause of the fault is still there",
    Answer.UNKNOWN: "it does not know this request",
}
