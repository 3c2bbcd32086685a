"""An ADS server over TCP: symbols by name and handle, read and written as a TwinCAT runtime does.

Sources: Beckhoff Information System, "ADS/AMS Specification" (TE1000) and "TwinCAT ADS return
codes". Device notifications and sum commands are not offered.
"""

from __future__ import annotations

import contextlib
import random
import socket
import struct
import sys
import threading
import time

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.base.local_peer import Address, is_another_user, is_loopback, socket_owner
from carosac_toolkit.plc.emulator.symbols import WRONG_SIZE, Refused, Symbols
from carosac_toolkit.robot.hardware import ADS_TCP_PORT

REQUEST_BYTES_MAX = 1 << 16  # longer requests are no ADS
AMS_HEADER = struct.Struct("<6sH6sHHHIII")  # of an AMS packet
THREAD_END_TIMEOUT_S = 2.0

_INFO, READ, WRITE, _STATE, READ_WRITE = 1, 2, 3, 4, 9
HANDLE_BY_NAME, VALUE_BY_HANDLE, _RELEASE_HANDLE = 0xF003, 0xF005, 0xF006
_UNSUPPORTED, _WRONG_GROUP = 0x701, 0x702
_STATE_RUN = 5  # ADS state of a running PLC


class AmsServer:
    """A server of ADS requests, with one thread for each connection.

    Attributes:
        ip: Address on which it listens.
        allow_others: Whether other users of this machine and other machines are served.
        delay: Delay of every answer, as in a slow network [s].
        jitter: Largest further delay, drawn at random [s].
        requests: Number of requests answered.
        refused: Number of connections of other users that were closed at once.
    """

    def __init__(self, symbols: Symbols, ip: str, *, allow_others: bool = False) -> None:
        """Listen on the TCP port of ADS; requests wait until `start`.

        Args:
            symbols: Symbols to serve.
            ip: Address to listen on.
            allow_others: Whether to serve other users of this machine and other machines too.

        Raises:
            CarosacError: The address is not of this machine, or in use.
        """
        self.symbols = symbols
        self.ip = ip
        self.delay = 0.0
        self.jitter = 0.0
        self.requests = 0
        self.refused = 0
        self.allow_others = allow_others
        self._running = False
        self._open: set[socket.socket] = set()
        self._threads: list[threading.Thread] = []
        self._lock = threading.Lock()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._socket.bind((ip, ADS_TCP_PORT))
            self._socket.listen(8)
        except OSError as error:
            self._socket.close()
            raise CarosacError(
                f"plc: cannot listen on {ip}:{ADS_TCP_PORT}: {error.strerror or error}; "
                "is another PLC or a TwinCAT router running there?"
            ) from error

    def start(self) -> None:
        """Start to answer requests."""
        self._running = True
        self._accepting = threading.Thread(target=self._accept, name="ads-accept", daemon=True)
        self._accepting.start()

    def close(self) -> None:
        """Close all connections and end all threads; safe to call twice."""
        self._running = False
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        with self._lock:
            for connection in self._open:
                with contextlib.suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)
        threads = [*self._threads, *([self._accepting] if hasattr(self, "_accepting") else [])]
        for thread in threads:
            thread.join(THREAD_END_TIMEOUT_S)

    def _accept(self) -> None:
        while self._running:
            try:
                connection, peer = self._socket.accept()
            except OSError:
                return
            if not self.allow_others and not _is_own(connection, peer):
                self._refuse(connection, peer)
                continue
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with self._lock:
                self._open.add(connection)
            thread = threading.Thread(
                target=self._serve, args=(connection,), name="ads-connection", daemon=True
            )
            self._threads = [t for t in self._threads if t.is_alive()] + [thread]
            thread.start()

    def _refuse(self, connection: socket.socket, peer: Address) -> None:
        """Close a connection; name another user the first time."""
        owner = socket_owner("tcp", peer, connection.getsockname())
        connection.close()
        if owner is None:  # closed by now, as ADS clients do with a first one to probe
            return
        self.refused += 1
        if self.refused == 1:
            text = f"refused a connection of the user with uid {owner}"
            print(f"carosac plc: {text}; --allow-others admits others", file=sys.stderr)

    def _serve(self, connection: socket.socket) -> None:
        """Answer one connection until it ends; close it at data that are no ADS."""
        try:
            while self._running:
                head = receive_exactly(connection, 6)
                size = int.from_bytes(head[2:], "little")
                if not AMS_HEADER.size <= size <= REQUEST_BYTES_MAX:
                    return
                packet = receive_exactly(connection, size)
                if self.delay or self.jitter:
                    time.sleep(self.delay + random.uniform(0.0, self.jitter))
                answer = self._answer(packet)
                connection.sendall(b"\0\0" + len(answer).to_bytes(4, "little") + answer)
                self.requests += 1
        except OSError:
            return
        finally:
            with self._lock:
                self._open.discard(connection)
            connection.close()

    def _answer(self, packet: bytes) -> bytes:
        """Return the answer to one request, with its header."""
        header = AMS_HEADER.unpack_from(packet)
        target, port, source, source_port, command, flags, _, _, number = header
        body = packet[AMS_HEADER.size :]
        try:
            data = struct.pack("<I", 0) + self._do(command, body)
        except Refused as refused:
            data = struct.pack("<I", refused.code)
            data += bytes(4) if command in (READ, READ_WRITE) else b""
        except struct.error:
            data = struct.pack("<I", WRONG_SIZE)
        return AMS_HEADER.pack(
            source, source_port, target, port, command, flags | 1, len(data), 0, number
        ) + data  # fmt: skip

    def _do(self, command: int, body: bytes) -> bytes:
        """Carry out a request; return the answer without its return code."""
        if command == _INFO:
            return struct.pack("<BBH16s", 3, 1, 0, b"carosac plc")
        if command == _STATE:
            return struct.pack("<HH", _STATE_RUN, 0)
        if command not in (READ, WRITE, READ_WRITE):
            raise Refused(_UNSUPPORTED)
        group, offset, size = struct.unpack_from("<III", body)
        if command == READ and group == VALUE_BY_HANDLE:
            return _sized(self.symbols.read_handle(offset)[:size])
        if command == WRITE and group == VALUE_BY_HANDLE:
            self.symbols.write_handle(offset, body[12 : 12 + size])
            return b""
        if command == WRITE and group == _RELEASE_HANDLE:
            return b""
        if command == READ_WRITE and group == HANDLE_BY_NAME:
            size = struct.unpack_from("<IIII", body)[3]
            name = body[16 : 16 + size].split(b"\0")[0].decode("latin-1")
            return _sized(struct.pack("<I", self.symbols.handle(name)))
        raise Refused(_WRONG_GROUP)


def _is_own(connection: socket.socket, peer: Address) -> bool:
    """Return whether a peer is a process of this user, or of root, on this machine."""
    return is_loopback(peer[0]) and not is_another_user("tcp", peer, connection.getsockname())


def _sized(data: bytes) -> bytes:
    return struct.pack("<I", len(data)) + data


def receive_exactly(connection: socket.socket, size: int) -> bytes:
    """Receive this many bytes, however the network splits them."""
    parts = bytearray()
    while len(parts) < size:
        part = connection.recv(size - len(parts))
        if not part:
            raise ConnectionError("closed")
        parts += part
    return bytes(parts)
