"""Everything that takes messages of a wire, with sound examples to damage."""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from carosac_toolkit.loop.drive_state import fault_of, state_of
from carosac_toolkit.plc import blocks
from carosac_toolkit.plc.emulator.ams_server import (
    AMS_HEADER,
    HANDLE_BY_NAME,
    READ,
    READ_WRITE,
    VALUE_BY_HANDLE,
    WRITE,
)
from carosac_toolkit.plc.emulator.emulator import Emulator
from carosac_toolkit.plc.emulator.settings import EmulatorSettings
from carosac_toolkit.plc.imu_udp import ImuListener, imu_line
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.robot.hardware import ImuSource
from tests.fuzz.mutators import MUTATORS_OF_BYTES, MUTATORS_OF_TEXT, Mutator
from tests.plc_process import own_address

WORDS = (0, 1, 2, 5, 6, 7, 8, 9, 255, 2**31, 2**32 - 1)
NUMBERS = (0.0, -1.0, 1e-300, 1e6, 1e300, -1e300, np.nan, np.inf, -np.inf)


@dataclass(frozen=True)
class Wire:
    """A receiver of messages.

    Attributes:
        name: What it takes.
        seeds: Sound messages.
        take: Takes one; whatever it raises but `CarosacError` is a fault of it.
        mutators: Kinds of damage.
    """

    name: str
    seeds: Sequence[bytes]
    take: Callable[[bytes], object]
    mutators: tuple[Mutator, ...]


def field_changed(block: blocks.Block) -> Mutator:
    """Return a mutator that sets one member of a block to an extreme."""

    def change(data: bytes, rng: np.random.Generator) -> bytes:
        if len(data) != block.size:
            return data
        record: Any = np.frombuffer(data, block.dtype).copy()
        name = block.fields[rng.integers(len(block.fields))].name
        place = record[name].reshape(-1)
        choice = NUMBERS if place.dtype.kind == "f" else WORDS
        place[rng.integers(place.size)] = choice[rng.integers(len(choice))]
        return bytes(record.tobytes())

    return change


class EmulatedWires:
    """An emulated PLC in this process, and what can be sent to it and to a host."""

    def __init__(self) -> None:
        self.robot = load_robot("carosac")
        self.emulator = Emulator(self.robot, self.robot, EmulatorSettings(), ip=own_address())
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        self.imu = ImuListener(ImuSource(ip="127.0.0.1", port=port))
        self.to_host = blocks.to_host(self.robot.n)

    def close(self) -> None:
        self.imu.close()
        self.emulator.close()

    def wires(self) -> tuple[Wire, ...]:
        from_host, control = blocks.from_host(self.robot.n), blocks.control()
        return (
            Wire("AMS requests", self._requests(), self._request, MUTATORS_OF_BYTES),
            Wire("FROM_HOST", [self._command(from_host)], self._writer(blocks.FROM_HOST),
                 (*MUTATORS_OF_BYTES, field_changed(from_host), field_changed(from_host))),
            Wire("CONTROL", [control.pack({"number": k, "kind": k}) for k in range(9)],
                 self._writer(blocks.CONTROL), (*MUTATORS_OF_BYTES, field_changed(control))),
            Wire("TO_HOST", [self._read(blocks.TO_HOST)], self._received,
                 (*MUTATORS_OF_BYTES, field_changed(self.to_host), field_changed(self.to_host))),
            Wire("IMU datagrams", [imu_line(7, 1.5, [0.1] * 3, [0, 0, 9.81]).encode()],
                 self._sampled, MUTATORS_OF_TEXT),
        )  # fmt: skip

    def _read(self, block: str) -> bytes:
        return bytes(self.emulator.symbols.read(self.emulator.symbol_names[block]))

    def _command(self, block: blocks.Block) -> bytes:
        length = np.array(self.to_host.unpack(self._read(blocks.TO_HOST))["length"])
        return block.pack(
            {"layout": blocks.BLOCK_LAYOUT, "cables": self.robot.n, "sequence": 3, "session": 9,
             "request": 1, "request_number": 1, "follow": 1, "command": 1, "period": 0.02,
             "length": length, "sequence_end": 3}
        )  # fmt: skip

    def _requests(self) -> list[bytes]:
        name = self.emulator.symbol_names[blocks.TO_HOST].encode() + b"\0"
        handle = self.emulator.symbols.handle(self.emulator.symbol_names[blocks.FROM_HOST])
        bodies = {
            READ: struct.pack("<III", VALUE_BY_HANDLE, handle, 100),
            WRITE: struct.pack("<III", VALUE_BY_HANDLE, handle, 8) + bytes(8),
            READ_WRITE: struct.pack("<IIII", HANDLE_BY_NAME, 0, 4, len(name)) + name,
        }
        return [
            AMS_HEADER.pack(bytes(6), 851, bytes(6), 3, kind, 4, len(body), 0, 1) + body
            for kind, body in bodies.items()
        ]

    def _request(self, data: bytes) -> None:
        """Answer as the thread of a connection does: shorter requests are cut off there."""
        if len(data) >= AMS_HEADER.size:
            answer = self.emulator.server._answer(data)
            assert len(answer) >= AMS_HEADER.size + 4

    def _writer(self, block: str) -> Callable[[bytes], None]:
        name = self.emulator.symbol_names[block]
        size = len(self._read(block))

        def write(data: bytes) -> None:
            if len(data) == size:  # the symbols refuse others, which "AMS requests" tries
                self.emulator.symbols.write(name, data)
            self.emulator.step()
            published = self.to_host.unpack(self._read(blocks.TO_HOST))
            assert np.isfinite(published["length"]).all() and np.isfinite(published["rate"]).all()

        return write

    def _received(self, data: bytes) -> None:
        values = self.to_host.unpack(data)
        blocks.whole(self.to_host, values, self.robot.n)
        state_of(values["state"]), fault_of(values["fault"])

    def _sampled(self, data: bytes) -> None:
        self.imu._take(data, 0.0)
        samples = self.imu.take(0.0)
        assert samples is None or np.isfinite(samples.time).all()
