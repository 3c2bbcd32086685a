"""What is read of a robot behind a PLC: state, faults, measurements, truth of an emulated one."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.drivers.ticks import TickSchedule
from carosac_toolkit.loop.drive_state import DriveState, Fault, fault_of, state_of
from carosac_toolkit.loop.values import Measurement, Stamped, State
from carosac_toolkit.plc.blocks import DriveStatus
from carosac_toolkit.plc.exchange import AdsLink
from carosac_toolkit.plc.imu_udp import ImuListener
from carosac_toolkit.plc.reading import LinkCounters, Reading
from carosac_toolkit.plc.settings import DESK, PLANT, AdsSettings
from carosac_toolkit.robot.hardware import Hardware
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.safety.limiter import Limiter

ANSWER = 1.0  # [s] in which the PLC must answer a request


class AdsReader:
    """The half of `carosac_toolkit.plc.driver.AdsDriver` that writes nothing.

    The clock is that of this host, from `connect` on. The lengths of a measurement are the newest
    that came; when the PLC measured them is the time of `length_rate`.

    Attributes:
        link: The connection; None before `connect` and after `close`.
        link_counters: What happened on it, also after `close`.
    """

    Settings: ClassVar[type[AdsSettings]] = AdsSettings
    name: ClassVar[str] = "ads"

    def __init__(self, robot: Robot, settings: AdsSettings | None = None) -> None:
        """Set up; nothing is connected yet."""
        self._robot = robot
        self._settings = settings or AdsSettings()
        self._named = robot.hardware or Hardware.loopback(robot.n)
        if self._settings.ip is not None:
            ads = replace(self._named.ads, ip=self._settings.ip, net_id=f"{self._settings.ip}.1.1")
            self._named = replace(self._named, ads=ads)
        self._hardware = self._named
        self.link: AdsLink | None = None
        self.link_counters = LinkCounters()
        self._imu: ImuListener | None = None
        self._limiter = Limiter(robot, self._settings.limits, period=self._settings.period)
        self._homed = self._enabled = self._stopped = False
        self._restarts = 0
        self._ticks = TickSchedule(self._settings.period)

    @property
    def overruns(self) -> int:
        """Ticks of the wall clock that were missed since `connect`."""
        return self._ticks.missed

    def status(self) -> str:
        """State of the drive system in one word, as `DriveState`."""
        return str(self.state)

    @property
    def state(self) -> DriveState:
        """Where the drive system stands."""
        link = self.link
        if link is None or link.reading is None:
            return DriveState.DISCONNECTED
        if self.link_fault is not Fault.NONE:
            return DriveState.FAULT
        said = state_of(link.reading.values["state"])
        return DriveState.HOMED if said is DriveState.CONNECTED and self._homed else said

    @property
    def lost_after(self) -> float:
        """Silence after which the connection counts as lost [s]."""
        asked = self._settings.lost_after
        if asked is not None:
            return asked
        return DESK if self.link is not None and self.link.emulated else PLANT

    @property
    def fault(self) -> Fault:
        """What is wrong, by the connection to the PLC or by the PLC."""
        own, link = self.link_fault, self.link
        if own is not Fault.NONE or link is None or link.reading is None:
            return own
        return fault_of(link.reading.values["fault"])

    @property
    def link_fault(self) -> Fault:
        """What is wrong with the connection; the PLC may hold the same word of an earlier one."""
        link = self.link
        if link is None or link.reading is None:
            return Fault.NONE
        if link.age > self.lost_after:
            return Fault.LOST_CONNECTION
        if link.counters.restarts != self._restarts:
            return Fault.LOST_CONNECTION
        if time.monotonic() - link.reading.advanced > self.lost_after:
            return Fault.STALE_DATA
        if self._enabled and link.other:
            return Fault.OWNER
        return Fault.NONE

    @property
    def fault_text(self) -> str:
        """The same for people, with the cable where it is that of one."""
        link, fault = self.link, self.fault
        if link is None or link.reading is None:
            return "not connected"
        if self.link_fault is Fault.LOST_CONNECTION:
            if link.age <= self.lost_after:
                return "lost connection: the PLC was started anew; home again"
            return f"lost connection: no answer for {link.age:.2f} s ({link.error})"
        axis = link.reading.values["fault_axis"]
        names = self._robot.cable_names
        where = f" of cable {names[axis - 1]}" if 1 <= axis <= len(names) else ""
        number = link.reading.values["fault"] if fault is Fault.UNKNOWN else ""
        return f"{fault}{number}{where}: {fault.meaning}"

    def measure(self) -> Measurement:
        """The newest data that came from the PLC."""
        reading, hardware = self._reading(), self._hardware
        values = reading.values
        stamp = np.array([self._ticks.since(reading.measured)])
        rate = hardware.unit * values["rate"]
        tension = None
        if values["has_tension"]:
            tension = Stamped(time=stamp, value=values["tension"][None])
        return Measurement(
            time=np.array([self._ticks.elapsed]),
            unstrained_length=hardware.length(values["length"])[None],
            length_rate=Stamped(time=stamp, value=rate[None]),
            tension=tension,
            imu=None if self._imu is None else self._imu.take(self._ticks.origin),
            drive_status=tuple(_drive(x) for x in values["drive_status"]),
        )

    def truth(self) -> State | None:
        """The state of the robot of an emulated PLC at its newest cycle; None of a real one."""
        link = self._connected()
        if not link.emulated:
            return None
        if not link.wants_truth:
            link.wants_truth = True
            link.wait_for_data(time.monotonic() + self._settings.io_period, ANSWER)
        reading = self._reading()
        known = reading.truth
        if known is None:
            return None
        return State(
            time=np.array([self._ticks.since(reading.received)]),
            position=known["position"][None],
            rotation=known["rotation"].reshape(1, 3, 3),
            twist=known["twist"][None],
            unstrained_length=known["length"][None],
            tension=known["tension"][None],
        )

    def _connected(self) -> AdsLink:
        """Refuse to work before `connect` and after `close`."""
        if self.link is None:
            raise CarosacError(f"{self.name}: not connected; call connect() first")
        return self.link

    def _reading(self) -> Reading:
        """The newest data."""
        reading = self._connected().reading
        assert reading is not None  # `connect` waited for it
        return reading


def _drive(number: Any) -> str:
    """Status of a drive in one word."""
    return DriveStatus(int(number)).name.lower() if int(number) <= max(DriveStatus) else "unknown"
