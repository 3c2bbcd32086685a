"""What goes over the wire between host and PLC, seen from outside: a proxy, and a reader beside it.

Nothing of the toolkit is used here, so that neither its counters nor its parsers can hide a fault.
Frames follow Beckhoff's "ADS/AMS Specification" (TE1000); the structures are those that
``docs/plc.md`` declares in Structured Text. The observer is a process of its own.
"""

from __future__ import annotations

import asyncio
import contextlib
import re
import signal
import struct
import time
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np

PORT = 48898  # TCP port of ADS
POLL_S = 0.003  # a PLC cycle takes 5 ms
DELAY_S = 0.3  # of a slow network
AWAY_S = 1.0  # for which a dropped connection cannot be opened again
# Target, port, source, port, command, flags, size, error, number.
HEADER = struct.Struct("<6sH6sHHHIII")
READ, WRITE, READ_WRITE = 2, 3, 9
HANDLE_BY_NAME, VALUE_BY_HANDLE = 0xF003, 0xF005
TYPES = {"UDINT": "<u4", "ULINT": "<u8", "LREAL": "<f8"}
FROM_HOST, TO_HOST = "CaRoSaC.from_host", "CaRoSaC.to_host"
DOCUMENT = Path(__file__).parents[1] / "docs" / "plc.md"


class Disturbance(IntEnum):
    """What the proxy does to the connection."""

    NONE = 0
    LATE = 1  # every frame comes `DELAY_S` late, for `AWAY_S`
    DROPPED = 2  # connections are cut, and refused for `AWAY_S`
    NONSENSE = 3  # the PLC's answers become random bytes of the right length
    CUT_SHORT = 4  # half an answer, then silence
    REPLAYED = 5  # every answer of the PLC is the first one
    DATA_FROZEN = 6  # the same, but the heartbeat of the PLC goes on
    COUNTER_FROZEN = 7  # the heartbeat of the PLC stands still, all else goes on


def layout(name: str, cables: int = 4) -> np.dtype[Any]:
    """Return the layout of a structure from its declaration in the documentation."""
    body = re.search(rf"TYPE {name} :\s*STRUCT(.*?)END_STRUCT", DOCUMENT.read_text(), re.DOTALL)
    assert body is not None, f"no {name} in {DOCUMENT}"
    members = re.findall(r"^\s*(\w+)\s*: (ARRAY\[1\.\.4\] OF )?(\w+);", body[1], re.MULTILINE)
    return np.dtype([(n, TYPES[t], (cables,) if array else ()) for n, array, t in members])


class Observer:
    """A proxy for the host, and a reader of `ST_ToHost` with a connection of its own.

    Every whole `ST_FromHost` that passes, and every new `ST_ToHost`, is kept with the time of the
    monotonic clock at which it passed [s].
    """

    def __init__(self, proxy_ip: str, plc_ip: str, folder: Path, disturbance: Any) -> None:
        """Keep addresses; `run` listens.

        Args:
            proxy_ip: Address at which the host finds the PLC.
            plc_ip: Address of the PLC.
            folder: Where `written.bin` and `read.bin` are kept.
            disturbance: A shared number, one of `Disturbance`.
        """
        self._proxy_ip, self._plc_ip, self._disturbance = proxy_ip, plc_ip, disturbance
        self._files = {n: (folder / f"{n}.bin").open("wb") for n in ("written", "read")}
        self._from_host, self._to_host = layout("ST_FromHost"), layout("ST_ToHost")
        self._since = 0.0
        self._first_answers: dict[Disturbance, bytes] = {}

    def run(self) -> int:
        """Run until SIGTERM; return an exit status."""
        asyncio.run(self._main())
        return 0

    async def _main(self) -> None:
        loop, end = asyncio.get_running_loop(), asyncio.Event()
        loop.add_signal_handler(signal.SIGTERM, end.set)
        server = await asyncio.start_server(self._connection, self._proxy_ip, PORT)
        reading = asyncio.create_task(self._read_plc())
        await end.wait()
        server.close()
        reading.cancel()
        for file in self._files.values():
            file.close()

    def _keep(self, name: str, data: bytes) -> None:
        if not self._files[name].closed:
            self._files[name].write(struct.pack("<d", time.monotonic()) + data)

    def _disturbed(self) -> Disturbance:
        """Return what is done to the connection now; some end by themselves."""
        kind = Disturbance(self._disturbance.value)
        if kind is Disturbance.NONE:
            self._since = 0.0
        elif not self._since:
            self._since = time.monotonic()
        passing = kind in (Disturbance.LATE, Disturbance.DROPPED)
        over = passing and time.monotonic() > self._since + AWAY_S
        return Disturbance.NONE if over else kind

    async def _connection(
        self, host_in: asyncio.StreamReader, host_out: asyncio.StreamWriter
    ) -> None:
        """Carry one connection of the host."""
        if self._disturbed() is Disturbance.DROPPED:
            host_out.transport.abort()
            return
        try:
            plc_in, plc_out = await asyncio.open_connection(self._plc_ip, PORT)
        except OSError:
            host_out.transport.abort()
            return
        names: dict[int, bytes] = {}  # invocation -> symbol asked for
        handles: dict[int, bytes] = {}  # handle -> symbol
        await asyncio.gather(
            self._carry(host_in, plc_out, lambda f: self._request(f, names, handles)),
            self._carry(plc_in, host_out, lambda f: self._answer(f, names, handles)),
            return_exceptions=True,
        )
        for stream in (host_out, plc_out):
            stream.transport.abort()

    async def _carry(self, source: Any, target: Any, look: Any) -> None:
        """Carry frames one way, in order, late where the network is slow."""
        queue: asyncio.Queue[tuple[float, bytes] | None] = asyncio.Queue()

        async def deliver() -> None:
            while (item := await queue.get()) is not None:
                await asyncio.sleep(max(0.0, item[0] - time.monotonic()))
                target.write(look(item[1]))
                await target.drain()

        task = asyncio.create_task(deliver())
        waiting = asyncio.create_task(receive(source))
        try:
            while self._disturbed() is not Disturbance.DROPPED:
                if not (await asyncio.wait({waiting}, timeout=0.02))[0]:
                    continue
                late = DELAY_S if self._disturbed() is Disturbance.LATE else 0.0
                queue.put_nowait((time.monotonic() + late, waiting.result()))
                waiting = asyncio.create_task(receive(source))
        finally:
            task.cancel()
            waiting.cancel()
            target.transport.abort()

    def _request(self, frame: bytes, names: dict[int, bytes], handles: dict[int, bytes]) -> bytes:
        """Keep what the host writes to the PLC."""
        command, number, body = frame_parts(frame)
        if command == READ_WRITE:
            group, _, _, size = struct.unpack_from("<IIII", body)
            if group == HANDLE_BY_NAME:
                names[number] = body[16 : 16 + size].split(b"\0")[0]
        elif command == WRITE:
            group, handle, size = struct.unpack_from("<III", body)
            if group == VALUE_BY_HANDLE and handles.get(handle) == FROM_HOST.encode():
                data = body[12 : 12 + size]
                if size == self._from_host.itemsize:
                    self._keep("written", data)
        return frame

    def _answer(self, frame: bytes, names: dict[int, bytes], handles: dict[int, bytes]) -> bytes:
        """Learn the handles of symbols, and spoil answers where asked to."""
        command, number, body = frame_parts(frame)
        if command == READ_WRITE and number in names and len(body) >= 12:
            handles[struct.unpack_from("<I", body, 8)[0]] = names.pop(number)
        kind = self._disturbed()
        start = 6 + HEADER.size
        if kind is Disturbance.NONSENSE:
            return frame[:start] + np.random.default_rng(number).bytes(len(frame) - start)
        if kind is Disturbance.CUT_SHORT:
            return frame[: len(frame) // 2]
        if command != READ or len(frame) != start + 8 + self._to_host.itemsize:
            return frame
        first = self._first_answers.setdefault(kind, frame)
        if kind is Disturbance.REPLAYED:
            return frame[:start] + first[start:]
        if kind is Disturbance.DATA_FROZEN:
            return frame[: start + 8] + self._structure(first, counter=frame)
        if kind is Disturbance.COUNTER_FROZEN:
            return frame[: start + 8] + self._structure(frame, counter=first)
        return frame

    def _structure(self, frame: bytes, *, counter: bytes) -> bytes:
        """Return the structure in an answer, with the heartbeat of another answer."""
        size = self._to_host.itemsize
        data = np.frombuffer(frame[-size:], self._to_host).copy()
        for name in ("sequence", "sequence_end"):
            data[name] = np.frombuffer(counter[-size:], self._to_host)[name]
        return data.tobytes()

    async def _read_plc(self) -> None:
        """Read `ST_ToHost` over and over, while there is a PLC."""
        size = self._to_host.itemsize
        while True:
            with contextlib.suppress(OSError, asyncio.IncompleteReadError):
                source, target = await asyncio.open_connection(self._plc_ip, PORT)
                name = TO_HOST.encode() + b"\0"
                body = struct.pack("<IIII", HANDLE_BY_NAME, 0, 4, len(name)) + name
                answer = await ask(source, target, self._plc_ip, READ_WRITE, body)
                handle = struct.unpack_from("<I", answer, 8)[0]
                body = struct.pack("<III", VALUE_BY_HANDLE, handle, size)
                before = b""
                while True:
                    data = (await ask(source, target, self._plc_ip, READ, body))[8:]
                    if data != before and len(data) == size:
                        self._keep("read", data)
                    before = data
                    await asyncio.sleep(POLL_S)
            await asyncio.sleep(POLL_S)


async def receive(source: asyncio.StreamReader) -> bytes:
    """Return one frame, with its length in front."""
    head = await source.readexactly(6)
    return head + await source.readexactly(int.from_bytes(head[2:], "little"))


async def ask(source: Any, target: Any, ip: str, command: int, body: bytes) -> bytes:
    """Send one request; return the body of its answer."""
    net = bytes(int(x) for x in f"{ip}.1.1".split("."))
    head = HEADER.pack(net, 851, net, 40001, command, 4, len(body), 0, 1)
    target.write(b"\0\0" + struct.pack("<I", len(head) + len(body)) + head + body)
    return frame_parts(await receive(source))[2]


def frame_parts(frame: bytes) -> tuple[int, int, bytes]:
    """Return command, number of the invocation, and body of a frame."""
    fields = HEADER.unpack_from(frame, 6)
    return fields[4], fields[8], frame[6 + HEADER.size :]


def observed(file: Path, structure: str) -> tuple[np.ndarray, np.ndarray]:
    """Return times [s] and structures that an `Observer` kept, only those of one write."""
    kind = layout(structure)
    record = np.dtype([("at", "<f8"), ("data", kind)])
    whole = file.read_bytes()
    rows = np.frombuffer(whole[: len(whole) // record.itemsize * record.itemsize], record)
    rows = rows[rows["data"]["sequence"] == rows["data"]["sequence_end"]]
    return rows["at"], rows["data"]
