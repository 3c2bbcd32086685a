"""The emulated PLC in real time: cycle by cycle, with ADS in front and a simulated robot behind."""

from __future__ import annotations

import socket
import time
from typing import Any

import numpy as np

from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.plc import blocks
from carosac_toolkit.plc.blocks import Injection
from carosac_toolkit.plc.emulator.ams_server import AmsServer
from carosac_toolkit.plc.emulator.machine import Machine
from carosac_toolkit.plc.emulator.settings import PlcSettings, limits_of
from carosac_toolkit.plc.emulator.symbols import Symbols
from carosac_toolkit.plc.emulator.world import World
from carosac_toolkit.plc.imu_udp import imu_line
from carosac_toolkit.robot.hardware import LOOPBACK, TCP_PORT, Hardware
from carosac_toolkit.robot.robot import Robot

_WARM = 3  # cycles before anybody is heard: the first ones load kernels
_CATCH_UP = 4  # cycles in a row without waiting; more are lost time, as where a PLC stands still


class Emulator:
    """A PLC with its robot; `run` is its task.

    Its clock is the number of its cycles: where the process did not get to run, the clock, the
    watchdog and the robot stood still together, and `lost_time` says for how long.

    Attributes:
        machine: The program.
        server: What answers ADS.
        ip: Where it listens.
        world: The robot.
        overruns: Cycles that came late.
        lost_time: [s].
    """

    def __init__(
        self, plant: Robot, nominal: Robot, settings: PlcSettings, *, seed: int = 0,
        ip: str | None = None, port: int = TCP_PORT,
    ) -> None:  # fmt: skip
        """Listen, and set the robot down.

        Args:
            plant: The robot that is simulated.
            nominal: What the PLC knows: limits and units.
            settings: Of both.
            seed: Of everything random.
            ip: Where to listen; None: this machine only, at the address of the robot file if that
                is of this machine.
            port: TCP port; clients know only that of ADS.

        Raises:
            CarosacError: The address cannot be used.
            InvalidField: The robot cannot rest at its start.
        """
        n = nominal.n
        self.hardware = nominal.hardware or Hardware.loopback(n)
        self._settings = settings
        self.world = World(plant, self.hardware, settings, seed)
        start = nominal.home_position if settings.start_position is None else (
            np.array(settings.start_position, dtype=np.float64)
        )  # fmt: skip
        self.world.place(start)
        self.machine = Machine(
            limits_of(nominal, self.hardware, settings), cycle=settings.cycle,
            watchdog=settings.watchdog, encoder_check=settings.encoder_check,
        )  # fmt: skip
        self._stand()
        self._blocks = {
            "from_host": blocks.from_host(n), "to_host": blocks.to_host(n),
            "control": blocks.control(), "diagnosis": blocks.diagnosis(n),
            "truth": blocks.truth(n),
        }  # fmt: skip
        self._names = {
            "from_host": self.hardware.ads.from_host, "to_host": self.hardware.ads.to_host,
            "control": blocks.CONTROL, "diagnosis": blocks.DIAGNOSIS,
            "truth": blocks.TRUTH,
        }  # fmt: skip
        self._symbols = Symbols()
        for key, name in self._names.items():
            writable = key in ("from_host", "control")
            self._symbols.add(name, self._blocks[key].size, writable=writable)
        self._n, self._cycles, self.overruns, self.lost_time = n, 0, 0, 0.0
        self._control, self._refused = 0, 0
        self._imu: socket.socket | None = None
        self._sent_imu = 0
        if self.hardware.imu is not None:
            self._imu = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._running = True
        for _ in range(_WARM):
            self.step()
        named = self.hardware.ads.ip
        self.ip = ip or (named if named.startswith("127.") else LOOPBACK)
        self.server = AmsServer(self._symbols, self.ip, port)
        self.server.start()

    def run(self, duration: float | None = None) -> None:
        """Run in real time, until `stop` or for so long [s]."""
        cycle = self._settings.cycle
        origin, done = time.monotonic(), 0
        while self._running and (duration is None or done * cycle < duration):
            self.step()
            done += 1
            late = time.monotonic() - origin - done * cycle
            if late < 0.0:
                time.sleep(-late)
                continue
            self.overruns += late > cycle
            if late > _CATCH_UP * cycle:
                self.lost_time += late
                origin += late

    def step(self) -> None:
        """One PLC cycle."""
        self._obey_control()
        data = self._symbols.read(self._names["from_host"])
        host: dict[str, Any] | None = self._blocks["from_host"].unpack(data)
        try:
            blocks.whole(self._blocks["from_host"], host or {}, self._n)
        except blocks.WrongBlock:
            host = None
        machine = self.machine
        machine.cycle(host, self.world.inputs)
        self.world.advance(machine.winches.position - machine.reference)
        self._cycles += 1
        self._publish()
        self._send_imu()

    def stop(self) -> None:
        """End `run` after this cycle."""
        self._running = False

    def close(self) -> None:
        """Let go of the network; safe to call twice."""
        self.stop()
        self.server.close()
        if self._imu is not None:
            self._imu.close()

    def inject(
        self, kind: Injection, axis: int = 0, value: float = 1.0, second: float = 0.0,
        position: Any = (0.0, 0.0, 0.0),
    ) -> None:  # fmt: skip
        """Do something to the machine; arguments as in `blocks.control`.

        Raises:
            InvalidField: No such cable, or a position where the robot cannot rest.
            CarosacError: It cannot be done in this state.
        """
        wires, on = self.machine.wires, value != 0.0
        if kind in (Injection.TRIP, Injection.JUMP) and not 1 <= axis <= self._n:
            raise InvalidField("axis", axis, f"1 to {self._n}")
        if kind == Injection.TRIP:
            wires.tripped[axis - 1] = on
        elif kind == Injection.JUMP:
            self.world.jump(axis - 1, value)
        elif kind == Injection.FREEZE_COUNTER:
            wires.freeze_counter = on
        elif kind == Injection.FREEZE_DATA:
            wires.freeze_data = on
        elif kind == Injection.NETWORK:
            self.server.delay, self.server.jitter = max(0.0, value), max(0.0, second)
        elif kind == Injection.ESTOP:
            wires.estop = on
        elif kind == Injection.PLACE:
            self._place(position)
        elif kind == Injection.CLEAR:
            wires.tripped[:] = False
            wires.estop = wires.freeze_counter = wires.freeze_data = False
            self.server.delay = self.server.jitter = 0.0
        else:
            raise InvalidField("kind", int(kind), f"one of {[int(k) for k in Injection][1:]}")

    def diagnosis(self) -> dict[str, Any]:
        """What the PLC counted."""
        counters, winches = self.machine.counters, self.machine.winches
        found = {name: getattr(counters, name, 0) for name in blocks.COUNTS}
        return found | {
            "cycles": self._cycles, "overruns": self.overruns, "lost_time": self.lost_time,
            "control_done": self._control, "control_refused": self._refused,
            "set_speed": winches.speed, "speed_peak": winches.speed_peak,
            "acceleration_peak": winches.acceleration_peak,
        } | {f"worst_{name}": value for name, value in counters.worst.items()}  # fmt: skip

    def _obey_control(self) -> None:
        """Carry out what a client injected."""
        asked = self._blocks["control"].unpack(self._symbols.read(self._names["control"]))
        if asked["number"] == self._control:
            return
        self._control = asked["number"]
        try:
            kind = Injection(asked["kind"])
            self.inject(kind, asked["axis"], asked["value"], asked["second"], asked["position"])
        except (CarosacError, ValueError):
            self._refused = asked["number"]

    def _place(self, position: Any) -> None:
        """Set the platform down elsewhere."""
        if self.machine.state.value not in ("connected", "fault", "estop"):
            raise CarosacError("plc: the drives are on; disable them first")
        self.world.place(np.asarray(position, dtype=np.float64))
        self._stand()

    def _stand(self) -> None:
        """The set points are where the winches stand."""
        machine = self.machine
        machine.place(self.world.inputs.length)
        machine.reference = machine.winches.position - self.world.standing

    def _publish(self) -> None:
        """Write what clients read."""
        inputs, state = self.world.inputs, self.world.truth()
        n = self._n
        self._write("to_host", self.machine.output(inputs))
        self._write("diagnosis", self.diagnosis())
        self._write("truth", {
            "time": self.machine.time, "position": state.position[0],
            "rotation": state.rotation[0].ravel(),
            "twist": np.zeros(6) if state.twist is None else state.twist[0],
            "length": np.zeros(n) if state.unstrained_length is None else (
                state.unstrained_length[0]),
            "tension": np.zeros(n) if state.tension is None else state.tension[0],
        })  # fmt: skip

    def _write(self, key: str, values: dict[str, Any]) -> None:
        self._symbols.write(self._names[key], self._blocks[key].pack(values))

    def _send_imu(self) -> None:
        """One datagram for each sample of the IMU, by the clock of the PLC."""
        samples = self.world.imu_samples()
        imu = self.hardware.imu
        if self._imu is None or imu is None:
            return
        for taken, sample in samples:
            self._sent_imu += 1
            clock = self.machine.time - (self.world.time - taken)
            line = imu_line(self._sent_imu, clock, sample[:3], sample[3:])
            self._imu.sendto(line.encode(), (imu.ip, imu.port))
