"""The reading half of the PLC driver: state, faults, measurements, truth of an emulated robot."""

from __future__ import annotations

import time
from typing import Any, ClassVar

import numpy as np

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.drivers.ticks import TickSchedule
from carosac_toolkit.loop.drive_state import DriveState, Fault, fault_of, state_of
from carosac_toolkit.loop.values import Measurement, Stamped, State
from carosac_toolkit.plc.blocks import DriveStatus
from carosac_toolkit.plc.exchange import PlcExchange
from carosac_toolkit.plc.imu_udp import ImuListener
from carosac_toolkit.plc.plausible import check_plausible
from carosac_toolkit.plc.reading import LinkCounters, Reading
from carosac_toolkit.plc.settings import (
    EMULATED_SILENCE_MAX_S,
    SILENCE_MAX_S,
    PlcDriverSettings,
)
from carosac_toolkit.robot.hardware import Hardware
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.safety.limiter import Limiter

ANSWER_TIMEOUT_S = 1.0  # the PLC answers a request within a cycle of 10 ms


class PlcReader:
    """The half of `carosac_toolkit.plc.driver.PlcDriver` that writes nothing.

    The clock is that of this host, from `connect` on. The lengths of a measurement are the newest
    that came; the time of its `length_rate` is when the PLC measured them.

    Attributes:
        exchange: The exchange with the PLC; None before `connect` and after `close`.
        link_counters: Counts of that exchange, also after `close`.
    """

    Settings: ClassVar[type[PlcDriverSettings]] = PlcDriverSettings
    name: ClassVar[str] = "plc"

    def __init__(self, robot: Robot, settings: PlcDriverSettings | None = None) -> None:
        """Set up; nothing is connected yet."""
        self._robot = robot
        self._settings = settings or PlcDriverSettings()
        self._hardware = robot.hardware or Hardware.loopback(robot.n)
        self._hardware_of_file = self._hardware
        self.exchange: PlcExchange | None = None
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
        """Return the state of the drive system in one word, as `DriveState`."""
        return str(self.state)

    @property
    def state(self) -> DriveState:
        """State of the drive system."""
        exchange = self.exchange
        if exchange is None or exchange.reading is None:
            return DriveState.DISCONNECTED
        if self.link_fault is not Fault.NONE:
            return DriveState.FAULT
        state = state_of(exchange.reading.values["state"])
        return DriveState.HOMED if state is DriveState.CONNECTED and self._homed else state

    @property
    def lost_after(self) -> float:
        """Silence after which the connection counts as lost [s]."""
        if self._settings.lost_after is not None:
            return self._settings.lost_after
        emulated = self.exchange is not None and self.exchange.emulated
        return EMULATED_SILENCE_MAX_S if emulated else SILENCE_MAX_S

    @property
    def fault(self) -> Fault:
        """Fault of the connection, else the one that the PLC holds."""
        own, exchange = self.link_fault, self.exchange
        if own is not Fault.NONE or exchange is None or exchange.reading is None:
            return own
        return fault_of(exchange.reading.values["fault"])

    @property
    def link_fault(self) -> Fault:
        """Fault of the connection; the PLC may hold the same one from an earlier run."""
        exchange = self.exchange
        if exchange is None or exchange.reading is None:
            return Fault.NONE
        if exchange.age > self.lost_after:
            return Fault.LOST_CONNECTION
        if exchange.counters.restarts != self._restarts:
            return Fault.LOST_CONNECTION
        if time.monotonic() - exchange.reading.advanced > self.lost_after:
            return Fault.STALE_DATA
        if self._enabled and exchange.other:
            return Fault.OWNER
        return Fault.STALE_DATA if self._imu_lost else Fault.NONE

    @property
    def link_silent(self) -> bool:
        """True if the data of the PLC do not come or do not advance, and it was not restarted."""
        exchange = self.exchange
        if exchange is None or exchange.reading is None:
            return False
        since = max(exchange.age, time.monotonic() - exchange.reading.advanced)
        return since > self.lost_after and exchange.counters.restarts == self._restarts

    @property
    def _imu_lost(self) -> bool:
        """True if the IMU that the suite asks for is silent."""
        return self._imu is not None and self._imu.silence > self._settings.imu_lost_after

    @property
    def fault_text(self) -> str:
        """Fault in words, with the cable if it is the fault of one."""
        exchange, fault = self.exchange, self.fault
        if exchange is None or exchange.reading is None:
            return "not connected"
        if self.link_fault is Fault.LOST_CONNECTION:
            if exchange.age <= self.lost_after:
                return "lost connection: the PLC was started anew; home again"
            return f"lost connection: no answer for {exchange.age:.2f} s ({exchange.error})"
        if self._imu is not None and self.link_fault is Fault.STALE_DATA and self._imu_lost:
            return (
                f"stale data: no sample of the IMU for {self._imu.silence:.2f} s; allowed: "
                f"{self._settings.imu_lost_after:g} s ({self._imu.received} came, "
                f"{self._imu.foreign} datagrams of others were refused)"
            )
        axis = exchange.reading.values["fault_axis"]
        names = self._robot.cable_names
        cable = f" of cable {names[axis - 1]}" if 1 <= axis <= len(names) else ""
        number = exchange.reading.values["fault"] if fault is Fault.UNKNOWN else ""
        return f"{fault}{number}{cable}: {fault.meaning}"

    def measure(self) -> Measurement:
        """Return the newest data that came from the PLC.

        Raises:
            InvalidField: A number that is not finite, or beyond what winches can do.
        """
        reading, hardware = self._reading(), self._hardware
        values = reading.values
        check_plausible(values, self._robot, hardware)
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
            drive_status=tuple(_drive_word(number) for number in values["drive_status"]),
        )

    def truth(self) -> State | None:
        """Return the true state of an emulated robot at its newest cycle; None of a real one."""
        exchange = self._connected()
        if not exchange.emulated:
            return None
        if not exchange.wants_truth:
            exchange.wants_truth = True
            end = time.monotonic() + self._settings.io_period
            exchange.wait_for_data(end, ANSWER_TIMEOUT_S)
        reading = self._reading()
        values = reading.truth
        if values is None:
            return None
        return State(
            time=np.array([self._ticks.since(reading.received)]),
            position=values["position"][None],
            rotation=values["rotation"].reshape(1, 3, 3),
            twist=values["twist"][None],
            unstrained_length=values["length"][None],
            tension=values["tension"][None],
        )

    def _connected(self) -> PlcExchange:
        """Refuse to work before `connect` and after `close`."""
        if self.exchange is None:
            raise CarosacError(f"{self.name}: not connected; call connect() first")
        return self.exchange

    def _reading(self) -> Reading:
        """Return the newest data."""
        reading = self._connected().reading
        assert reading is not None  # `connect` waited for it
        return reading


def _drive_word(number: Any) -> str:
    """Return the status of a drive in one word."""
    return DriveStatus(int(number)).name.lower() if int(number) <= max(DriveStatus) else "unknown"
