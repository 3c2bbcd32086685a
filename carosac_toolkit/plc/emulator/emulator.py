"""The emulated PLC in real time, with ADS in front and a simulated robot behind."""

from __future__ import annotations

import socket
import threading
import time
from typing import Any

import numpy as np

from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.plc import blocks
from carosac_toolkit.plc.blocks import Injection
from carosac_toolkit.plc.emulator.ams_server import AmsServer
from carosac_toolkit.plc.emulator.machine import Machine
from carosac_toolkit.plc.emulator.settings import EmulatorSettings, winch_limits
from carosac_toolkit.plc.emulator.symbols import Symbols
from carosac_toolkit.plc.emulator.world import World
from carosac_toolkit.plc.identity import machine_values
from carosac_toolkit.plc.imu_udp import imu_line
from carosac_toolkit.robot.hardware import LOOPBACK_ADDRESS, Hardware
from carosac_toolkit.robot.robot import Robot

WARM_UP_CYCLES = 3  # before it listens: the first ones load kernels
CATCH_UP_CYCLES_MAX = 4  # run at once after a delay; the rest of a longer one is lost time


class Emulator:
    """A PLC with its robot; `run` is its task.

    Its clock is the number of its cycles: while the process did not get to run, the clock, the
    watchdog and the robot stood still together; `lost_time` adds these times up, and one longer
    than the watchdog's counts as silence of the host.

    Attributes:
        machine: Program of the PLC.
        symbols: Shared memory, which `server` and servers of other wires read and write.
        symbol_names: Name of the symbol of each block.
        server: ADS server.
        ip: Address on which it listens.
        world: Simulated robot.
        overruns: Number of cycles that came late.
        lost_time: Time that the clock lost [s].
    """

    def __init__(
        self, plant: Robot, nominal: Robot, settings: EmulatorSettings, *, seed: int = 0,
        ip: str | None = None, allow_others: bool = False,
    ) -> None:  # fmt: skip
        """Listen, and set the robot down.

        Args:
            plant: Robot that is simulated.
            nominal: Robot that the PLC knows: limits and units; a host needs its file.
            settings: Settings of PLC and machine.
            seed: Seed of everything random.
            ip: Address on which to listen; None: one of this machine only, that of the robot file
                if it is one.
            allow_others: Whether other users of this machine, and other machines where `ip` lets
                them, may move the robot and inject faults as well.

        Raises:
            CarosacError: The address is not of this machine, or in use.
            InvalidField: The robot cannot rest at its start.
        """
        n = nominal.n
        self._whole_cycle = threading.RLock()  # control lines come from another thread
        self.hardware = nominal.hardware or Hardware.loopback(n)
        self._settings = settings
        self.world = World(plant, self.hardware, settings, seed)
        start = nominal.home_position if settings.start_position is None else (
            np.array(settings.start_position, dtype=np.float64)
        )  # fmt: skip
        self.world.place(start)
        constants = machine_values(nominal)
        self.machine = Machine(
            winch_limits(nominal, self.hardware), cycle=settings.cycle,
            watchdog=settings.watchdog, identity=constants["hash"],
            encoder_check=settings.encoder_check,
        )  # fmt: skip
        self._take_over_positions()
        self._blocks = {
            blocks.FROM_HOST: blocks.from_host(n), blocks.TO_HOST: blocks.to_host(n),
            blocks.CONTROL: blocks.control(), blocks.DIAGNOSIS: blocks.diagnosis(n),
            blocks.TRUTH: blocks.truth(n), blocks.MACHINE: blocks.machine(n),
        }  # fmt: skip
        ads = self.hardware.ads
        names = {
            blocks.FROM_HOST: ads.from_host, blocks.TO_HOST: ads.to_host,
            blocks.MACHINE: ads.machine,
        }  # fmt: skip
        self.symbol_names = {name: names.get(name, name) for name in self._blocks}
        self.symbols = Symbols()
        for name, block in self._blocks.items():
            writable = name in (blocks.FROM_HOST, blocks.CONTROL)
            self.symbols.add(
                self.symbol_names[name], block.size, writable=writable,
                readable=name != blocks.FROM_HOST,  # the session in it is secret
            )  # fmt: skip
        self._write(blocks.MACHINE, constants)
        self._n, self._cycles, self.overruns, self.lost_time = n, 0, 0, 0.0
        self._control, self._refused = 0, 0
        self._imu: socket.socket | None = None
        self._sent_imu = 0
        if self.hardware.imu is not None:
            self._imu = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._running = True
        for _ in range(WARM_UP_CYCLES):
            self.step()
        self.ip = ip or (ads.ip if ads.ip.startswith("127.") else LOOPBACK_ADDRESS)
        self.server = AmsServer(self.symbols, self.ip, allow_others=allow_others)
        self.server.start()

    def run(self, duration: float | None = None) -> None:
        """Run in real time until `stop`, or for this duration [s]."""
        cycle = self._settings.cycle
        origin, done = time.monotonic(), 0
        while self._running and (duration is None or done * cycle < duration):
            with self._whole_cycle:
                self.step()
            done += 1
            late = time.monotonic() - origin - done * cycle
            if late < 0.0:
                time.sleep(-late)
                continue
            self.overruns += late > cycle
            if late > CATCH_UP_CYCLES_MAX * cycle:
                self.lost_time += late
                origin += late
                with self._whole_cycle:
                    self.machine.held_up(late)

    def step(self) -> None:
        """Run one PLC cycle."""
        self._obey_control()
        host: dict[str, Any] | None = self._read(blocks.FROM_HOST)
        try:
            blocks.whole(self._blocks[blocks.FROM_HOST], host or {}, self._n)
        except blocks.WrongBlock:
            host = None
        machine = self.machine
        machine.cycle(host, self.world.inputs)
        self.world.advance(machine.winches.position - machine.reference)
        self._cycles += 1
        self._publish()
        self._send_imu()

    def stop(self) -> None:
        """Have `run` return after this cycle."""
        self._running = False

    def close(self) -> None:
        """Close all sockets; safe to call twice."""
        self.stop()
        self.server.close()
        if self._imu is not None:
            self._imu.close()

    def inject(
        self, kind: Injection, axis: int = 0, value: float = 1.0, second: float = 0.0,
        position: Any = (0.0, 0.0, 0.0),
    ) -> None:  # fmt: skip
        """Do something to the machine; arguments as in `carosac_toolkit.plc.injection`.

        Raises:
            InvalidField: No such cable, or a position at which the robot has no equilibrium.
            CarosacError: The state of the PLC does not allow it.
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
        """Return the counters of the PLC, as in `blocks.diagnosis`."""
        counters, winches = self.machine.counters, self.machine.winches
        counts = {name: getattr(counters, name, 0) for name in blocks.COUNTER_FIELDS}
        return counts | {
            "cycles": self._cycles, "overruns": self.overruns, "lost_time": self.lost_time,
            "control_done": self._control, "control_refused": self._refused,
            "set_speed": winches.speed, "speed_peak": winches.speed_peak,
            "acceleration_peak": winches.acceleration_peak,
        } | {f"worst_{name}": value for name, value in counters.worst.items()}  # fmt: skip

    def _obey_control(self) -> None:
        """Carry out a new injection of a client."""
        order = self._read(blocks.CONTROL)
        if order["number"] == self._control:
            return
        self._control = order["number"]
        try:
            kind = Injection(order["kind"])
            self.inject(kind, order["axis"], order["value"], order["second"], order["position"])
        except (CarosacError, ValueError):
            self._refused = order["number"]

    def _place(self, position: Any) -> None:
        """Set the platform down at rest elsewhere."""
        if self.machine.state.value not in ("connected", "fault", "estop"):
            raise CarosacError("plc: the drives are on; disable them first")
        with self._whole_cycle:
            self.world.place(np.asarray(position, dtype=np.float64))
            self._take_over_positions()

    def _take_over_positions(self) -> None:
        """Set the set positions to where the winches stand."""
        machine = self.machine
        machine.place(self.world.inputs.length)
        machine.reference = machine.winches.position - self.world.standing

    def _publish(self) -> None:
        """Write the blocks that clients read."""
        inputs, state = self.world.inputs, self.world.truth()
        n = self._n
        self._write(blocks.TO_HOST, self.machine.output(inputs))
        self._write(blocks.DIAGNOSIS, self.diagnosis())
        self._write(blocks.TRUTH, {
            "time": self.machine.time, "position": state.position[0],
            "rotation": state.rotation[0].ravel(),
            "twist": np.zeros(6) if state.twist is None else state.twist[0],
            "length": np.zeros(n) if state.unstrained_length is None else (
                state.unstrained_length[0]),
            "tension": np.zeros(n) if state.tension is None else state.tension[0],
        })  # fmt: skip

    def _read(self, block: str) -> dict[str, Any]:
        return self._blocks[block].unpack(self.symbols.read(self.symbol_names[block]))

    def _write(self, block: str, values: dict[str, Any]) -> None:
        self.symbols.write(self.symbol_names[block], self._blocks[block].pack(values))

    def _send_imu(self) -> None:
        """Send one datagram for each sample of the IMU, with the time by the clock of the PLC."""
        samples = self.world.imu_samples()
        imu = self.hardware.imu
        if self._imu is None or imu is None:
            return
        for taken, sample in samples:
            self._sent_imu += 1
            clock = self.machine.time - (self.world.time - taken)
            line = imu_line(self._sent_imu, clock, sample[:3], sample[3:])
            self._imu.sendto(line.encode(), (imu.ip, imu.port))
