"""A second wire to a PLC, for tests: a datagram each way for every call, over real sockets.

A request is an operation (0 ask for a block, 1 read, 2 write), a number, the length of the block's
name, the name, and for a write the data. The answer repeats the number and says whether the block
exists and the operation succeeded; that of a read carries the data.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import ClassVar

from carosac_toolkit.plc.emulator.emulator import Emulator
from carosac_toolkit.plc.emulator.symbols import Refused
from carosac_toolkit.plc.link import LinkError
from carosac_toolkit.robot.hardware import LOOPBACK_ADDRESS, Hardware

ASK, READ, WRITE = range(3)
REQUEST, ANSWER = struct.Struct("<BIB"), struct.Struct("<IB")
BLOCKS = (
    "from_host", "to_host", "machine", "Emulator.control", "Emulator.diagnosis", "Emulator.truth",
)  # fmt: skip
DATAGRAM_BYTES_MAX = 4096


@dataclass(frozen=True, kw_only=True)
class UdpSettings:
    ip: str = LOOPBACK_ADDRESS
    port: int = 48900
    timeout: float = 0.2


class UdpLink:
    """A link that another distribution could bring; it imports nothing of the driver."""

    Settings: ClassVar[type[UdpSettings]] = UdpSettings

    def __init__(self, settings: UdpSettings) -> None:
        self.address = f"udp {settings.ip}:{settings.port}"
        self.timeout = settings.timeout
        self._peer = (settings.ip, settings.port)
        self._socket: socket.socket | None = None
        self._number = 0

    @classmethod
    def build(cls, hardware: Hardware, settings: UdpSettings | None = None) -> UdpLink:
        return cls(settings or UdpSettings())

    def connect(self, *, writing: bool) -> None:
        self.close()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(self.timeout)
        self._blocks = {block for block in BLOCKS if self._ask(ASK, block)[0]}
        if not {"from_host", "to_host", "machine"} <= self._blocks:
            raise LinkError("cannot find the data block")

    def has(self, block: str) -> bool:
        return block in self._blocks

    def read(self, block: str, size: int) -> bytes:
        return self._done(READ, block)

    def write(self, block: str, data: bytes) -> None:
        self._done(WRITE, block, data)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _done(self, operation: int, block: str, data: bytes = b"") -> bytes:
        done, answer = self._ask(operation, block, data)
        if not done:
            raise LinkError(f"{self.address}: refused operation {operation} on {block}")
        return answer

    def _ask(self, operation: int, block: str, data: bytes = b"") -> tuple[bool, bytes]:
        if self._socket is None:
            raise LinkError(f"{self.address}: not connected")
        self._number = (self._number + 1) % 2**32
        name = block.encode()
        request = REQUEST.pack(operation, self._number, len(name)) + name + data
        try:
            self._socket.sendto(request, self._peer)
            while True:
                answer = self._socket.recv(DATAGRAM_BYTES_MAX)
                number, done = ANSWER.unpack_from(answer)
                if number == self._number:  # else late: the answer to a call that was given up
                    return bool(done), answer[ANSWER.size :]
        except OSError as error:
            raise LinkError(f"{self.address}: {error}") from error


class UdpServer:
    """The other end of the wire, on the shared memory of an emulated PLC; `cut` unplugs it."""

    def __init__(self, emulator: Emulator) -> None:
        self.cut = False
        self._emulator = emulator
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((LOOPBACK_ADDRESS, 0))
        self.port = self._socket.getsockname()[1]
        self._thread = threading.Thread(target=self._serve, name="udp-server", daemon=True)
        self._thread.start()

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._thread.join(2.0)
        self._socket.close()

    def _serve(self) -> None:
        while True:
            try:
                request, peer = self._socket.recvfrom(DATAGRAM_BYTES_MAX)
            except OSError:
                return
            if not request:
                return
            if not self.cut:
                operation, number, length = REQUEST.unpack_from(request)
                name = request[REQUEST.size : REQUEST.size + length].decode()
                data = self._answer(operation, name, request[REQUEST.size + length :])
                answer = ANSWER.pack(number, data is not None) + (data or b"")
                self._socket.sendto(answer, peer)

    def _answer(self, operation: int, block: str, data: bytes) -> bytes | None:
        symbols = self._emulator.symbols
        try:
            handle = symbols.handle(self._emulator.symbol_names.get(block, ""))
            if operation == WRITE:
                symbols.write_handle(handle, data)
            return symbols.read_handle(handle) if operation == READ else b""
        except Refused:
            return None


@contextmanager
def udp_server(emulator: Emulator) -> Iterator[UdpServer]:
    server = UdpServer(emulator)
    try:
        yield server
    finally:
        server.close()
