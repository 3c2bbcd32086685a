"""A small ADS client of the emulated PLC that injects faults and reads counters beside a driver."""

from __future__ import annotations

import socket
import struct
from typing import Any

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.plc import blocks
from carosac_toolkit.plc.blocks import Injection
from carosac_toolkit.plc.emulator.ams_server import (
    AMS_HEADER,
    HANDLE_BY_NAME,
    READ,
    READ_WRITE,
    VALUE_BY_HANDLE,
    WRITE,
    receive_exactly,
)
from carosac_toolkit.plc.injection import inject, read_diagnosis
from carosac_toolkit.robot.hardware import ADS_TCP_PORT, LOOPBACK_ADDRESS

CALL_TIMEOUT_S = 2.0


class PlcClient:
    """A connection to an emulated PLC, separate from that of a driver; a context manager."""

    def __init__(self, n: int, ip: str = LOOPBACK_ADDRESS) -> None:
        """Connect.

        Args:
            n: Number of cables.
            ip: IP address of the PLC.

        Raises:
            CarosacError: No PLC answers there.
        """
        self._n, self._number = n, 0
        try:
            self._socket = socket.create_connection((ip, ADS_TCP_PORT), CALL_TIMEOUT_S)
        except OSError as error:
            raise CarosacError(f"PLC at {ip}:{ADS_TCP_PORT}: {error.strerror or error}") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._handles: dict[str, int] = {}

    def __enter__(self) -> PlcClient:
        """Return the open connection."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the connection."""
        self.close()

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()

    def inject(
        self, kind: Injection, axis: int = 0, value: float = 1.0, second: float = 0.0,
        position: Any = (0.0, 0.0, 0.0),
    ) -> None:  # fmt: skip
        """Do something to the emulated machine and wait until it is done.

        Args, returns and errors are those of `carosac_toolkit.plc.injection.inject`.
        """
        inject(self, self._n, kind, axis, value, second, position)

    def diagnosis(self) -> dict[str, Any]:
        """Return the counters of the PLC."""
        return read_diagnosis(self, self._n)

    def truth(self) -> dict[str, Any]:
        """Return the true state of the simulated robot."""
        block = blocks.truth(self._n)
        return block.unpack(self.read(blocks.TRUTH, block.size))

    def read(self, name: str, size: int) -> bytes:
        """Return the bytes of a symbol."""
        body = struct.pack("<III", VALUE_BY_HANDLE, self._handle(name), size)
        return self._ask(READ, body)[4:]

    def write(self, name: str, data: bytes) -> None:
        """Write the bytes of a symbol."""
        head = struct.pack("<III", VALUE_BY_HANDLE, self._handle(name), len(data))
        self._ask(WRITE, head + data)

    def _handle(self, name: str) -> int:
        """Return the handle of a symbol, asked for once."""
        if name not in self._handles:
            text = name.encode("latin-1") + b"\0"
            body = struct.pack("<IIII", HANDLE_BY_NAME, 0, 4, len(text)) + text
            self._handles[name] = struct.unpack("<I", self._ask(READ_WRITE, body)[4:8])[0]
        return self._handles[name]

    def _ask(self, command: int, body: bytes) -> bytes:
        """Send one request; return its answer without the return code."""
        self._number += 1
        net = bytes((127, 0, 0, 1, 1, 1))
        head = AMS_HEADER.pack(net, 851, net, 40000, command, 4, len(body), 0, self._number)
        packet = head + body
        try:
            self._socket.sendall(b"\0\0" + struct.pack("<I", len(packet)) + packet)
            size = struct.unpack("<I", receive_exactly(self._socket, 6)[2:])[0]
            answer = receive_exactly(self._socket, size)[AMS_HEADER.size :]
        except OSError as error:
            raise CarosacError(f"PLC: {error.strerror or error}") from error
        code = struct.unpack_from("<I", answer)[0]
        if code:
            raise CarosacError(f"PLC: ADS code {code:#x}")
        return answer[4:]
