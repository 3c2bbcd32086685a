"""The link to a PLC over ADS: one thread that reads and writes one structure each, again and again.

pyads is not safe in several threads, so that all its calls are made here. A connection that broke
stays broken until it is opened anew with new handles; both are done here. Without `writing` nothing
is ever written, and with it only from a request on until `quiet`, and never while the PLC obeys
another session: there is one structure for all hosts.
"""

from __future__ import annotations

import ctypes
import secrets
import socket
import threading
import time
from typing import Any

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.plc import blocks
from carosac_toolkit.plc.blocks import TRUTH, Answer, Request, truth
from carosac_toolkit.plc.clock_offset import ClockOffset
from carosac_toolkit.plc.reading import LinkCounters, Reading
from carosac_toolkit.robot.hardware import TCP_PORT, AdsAddress

_AGAIN = 0.2  # [s] between two attempts to connect
_REOPEN = 4  # calls in a row that failed, after which the connection is opened anew
_BY_HANDLE = 0xF005
_LETS_GO = (Request.DISABLE, Request.HOLD)


class AdsLink:
    """One PLC, from one host.

    Attributes:
        counters: What happened.
        session: By which the PLC knows this host.
        reading: The newest one, or None.
        error: The newest error in words, or None where the last cycle went well.
        wants_truth: Whether the truth of an emulated PLC is read as well, which takes a call more.
        hold_heartbeat: For tests: the sequence stays the same while this is true.
    """

    def __init__(
        self, address: AdsAddress, n: int, *, period: float, writing: bool, timeout: float
    ) -> None:
        """Set up; `open` connects.

        Args:
            address: Of the PLC.
            n: Number of cables.
            period: Of the thread [s]; commands are sent at once.
            writing: Whether anything may be written at all.
            timeout: After which a call is given up [s].
        """
        self.counters = LinkCounters()
        self.session = secrets.randbelow(2**32 - 1) + 1
        self.reading: Reading | None = None
        self.error: str | None = None
        self.wants_truth = False
        self.hold_heartbeat = False
        self._address, self._n, self._period, self._timeout = address, n, period, timeout
        self._writing = writing
        self._to_host, self._from_host = blocks.to_host(n), blocks.from_host(n)
        self._truth = truth(n)
        self._offset = ClockOffset()
        self._plc: Any = None
        self._handles: dict[str, int] = {}
        self._wake = threading.Condition()
        self._answered = threading.Condition()
        self._fresh = False
        self._active = False  # whether anything is written now
        self._ending = False  # whether that ends with the next write
        self._heard = False  # whether the PLC was read since the connection was opened
        self._pending: int | None = None  # disable or hold that was not answered in time
        self._running = False
        self._thread: threading.Thread | None = None
        self._out: dict[str, Any] = {
            "layout": blocks.LAYOUT, "cables": n, "session": self.session, "follow": 0,
            "request": 0, "request_number": secrets.randbelow(2**31), "command": 0,
            "period": 0.0, "length": 0.0, "rate": 0.0, "fault": 0,
        }  # fmt: skip
        self._sequence, self._failures, self._ended = 0, 0, 0.0

    def open(self, patience: float = 2.0) -> Reading:
        """Start the thread and wait for the first data.

        Raises:
            CarosacError: There were none in time [s]; the thread has ended then.
        """
        self._running = True
        self._thread = threading.Thread(target=self._run, name="ads-link", daemon=True)
        self._thread.start()
        end = time.monotonic() + patience
        with self._answered:
            while self.reading is None and time.monotonic() < end:
                self._answered.wait(end - time.monotonic())
        if self.reading is None:
            why = self.error or "no answer"
            self.close()
            raise CarosacError(
                f"PLC {self._address.net_id} at {self._address.ip}: {why} after {patience:g} s"
            )
        return self.reading

    def close(self) -> None:
        """End the thread and the connection; safe to call twice."""
        self._running = False
        with self._wake:
            self._wake.notify()
        if self._thread is not None:
            self._thread.join(10.0 * self._timeout + 2.0)
            self._thread = None

    @property
    def emulated(self) -> bool:
        """Whether the PLC is an emulated one, which knows the truth."""
        return "truth" in self._handles

    @property
    def other(self) -> int:
        """Another session that the PLC obeys, by its newest answer; 0 where there is none."""
        reading = self.reading
        owner = 0 if reading is None else int(reading.values["owner"])
        return 0 if owner == self.session else owner

    @property
    def age(self) -> float:
        """Time since the last answer of the PLC [s]."""
        reading = self.reading
        return float("inf") if reading is None else time.monotonic() - reading.received

    def send(self, length: Any, rate: Any, period: float) -> None:
        """Have the winches follow this from now on, in the units of the PLC; sent at once."""
        with self._wake:
            out = self._out
            command = (out["command"] + 1) % 2**32
            self._out = out | {
                "length": length, "rate": rate, "period": period, "follow": 1, "command": command,
            }  # fmt: skip
            self._fresh = True
            self._wake.notify()

    def hold(self) -> None:
        """Ask for no motion any more; the heartbeat goes on."""
        with self._wake:
            self._out = self._out | {"follow": 0}

    def request(self, request: Request, patience: float = 0.0, *, fault: int = 0) -> Answer:
        """Ask the PLC for something; commands no longer count then.

        Args:
            request: What.
            patience: How long to wait for the answer [s]; 0: not at all.
            fault: Number of the fault to hold.

        A disable or hold that is not answered in time stays, and the heartbeat stands still, so
        that the watchdog of the PLC stops the winches where the request does not reach it.

        Returns:
            The answer, `Answer.NONE` where there was none in time.
        """
        with self._wake:
            number = (self._out["request_number"] + 1) % 2**32 or 1
            self._out = self._out | {
                "request": int(request), "request_number": number, "follow": 0,
                "fault": fault,
            }  # fmt: skip
            self._active, self._ending, self._pending = True, False, None
            self._fresh = True
            self._wake.notify()
        answer = self._answer(number, patience)
        with self._wake:
            if self._out["request_number"] == number:
                if request in _LETS_GO and answer is Answer.NONE:
                    self._pending = number
                elif patience > 0.0:  # a PLC that starts anew must not find it
                    self._out = self._out | {"request": 0}
        return answer

    def quiet(self) -> None:
        """Write once more, without any request, and then nothing until the next one."""
        with self._wake:
            self._out = self._out | {"request": 0, "follow": 0}
            self._ending, self._pending = True, None
            self._fresh = True
            self._wake.notify()

    def _answer(self, number: int, patience: float) -> Answer:
        """What the PLC answered to a request, `Answer.NONE` where it did not in time [s]."""
        end = time.monotonic() + patience
        with self._answered:
            while time.monotonic() < end:
                reading = self.reading
                if reading is not None and reading.values["answered"] == number:
                    return Answer(reading.values["answer"])
                self._answered.wait(max(0.0, end - time.monotonic()))
        return Answer.NONE

    def wait_for_data(self, received: float, patience: float) -> bool:
        """Wait for an answer that came after `received` [s]; False where none did in time."""
        end = time.monotonic() + patience
        with self._answered:
            while self.reading is None or self.reading.received <= received:
                left = end - time.monotonic()
                if left <= 0.0 or not self._running:
                    return False
                self._answered.wait(left)
        return True

    def _run(self) -> None:
        """The thread: on an absolute schedule, and at once where there is something to send."""
        due = time.monotonic()
        try:
            while self._running:
                if self._plc is None and not self._connect():
                    with self._wake:
                        self._wake.wait_for(lambda: not self._running, _AGAIN)
                    due = time.monotonic()
                    continue
                self._cycle()
                due = self._next(due)
        except BaseException as error:
            self.error = f"{type(error).__name__}: {error}"
            raise
        finally:
            self._disconnect()

    def _next(self, due: float) -> float:
        """Wait for the next tick, or for something to send."""
        now = time.monotonic()
        due += self._period
        if now > due:
            self.counters.missed += int((now - due) / self._period)
            due = now
        with self._wake:
            self._wake.wait_for(lambda: self._fresh or not self._running, max(0.0, due - now))
        return min(due, time.monotonic())

    def _cycle(self) -> None:
        """Write where it is allowed, and read."""
        began = time.monotonic()
        try:
            if self._may_write():
                self._write()
            self._read()
            self._heard = True
            if self._pending is not None and self.reading is not None:
                if self.reading.values["answered"] == self._pending:
                    self.quiet()
        except blocks.WrongBlock as error:
            self._failed(f"{error}; host and PLC have other data blocks")
        except Exception as error:  # pyads raises its own and RuntimeError
            if not _is_ads(error):
                raise
            self._failed(str(error))
        else:
            self.error, self._failures = None, 0
            counters = self.counters
            counters.cycles += 1
            now = time.monotonic()
            if counters.cycles > 1:
                counters.gap_max = max(counters.gap_max, now - self._ended)
            self._ended = now
            counters.round_trip = now - began
            counters.round_trip_max = max(counters.round_trip_max, counters.round_trip)
        with self._answered:
            self._answered.notify_all()

    def _may_write(self) -> bool:
        """Whether something is to be written, and nobody else writes."""
        with self._wake:
            self._active = self._active and not self.other
            allowed = self._writing and self._active and self._heard
            self._fresh = self._fresh and allowed
        return allowed

    def _write(self) -> None:
        """Send the newest of everything, with the next heartbeat."""
        with self._wake:
            out, self._fresh, ending = self._out, False, self._ending
            held = self.hold_heartbeat or self._pending is not None
        self._sequence = (self._sequence + (not held)) % 2**32
        data = self._from_host.pack(
            out | {"sequence": self._sequence, "sequence_end": self._sequence}
        )
        kind = ctypes.c_ubyte * len(data)
        self._plc.write(_BY_HANDLE, self._handles["from_host"], data, kind)
        with self._wake:
            if ending and self._ending:
                self._active = self._ending = False

    def _read(self) -> None:
        """Take over what the PLC says."""
        values = self._to_host.unpack(self._fetch("to_host", self._to_host.size))
        received = time.monotonic()
        if not blocks.whole(self._to_host, values, self._n):
            self.counters.torn += 1
            return
        last = self.reading
        if last is not None and (
            values["boot"] != last.values["boot"] or values["time"] < last.values["time"]
        ):
            self.counters.restarts += 1
            self._offset.clear()
        alive = last is None or all(values[x] != last.values[x] for x in ("sequence", "time"))
        if alive:
            self._offset.add(received, values["time"])
        known = None
        if self.wants_truth and self.emulated:
            known = self._truth.unpack(self._fetch("truth", self._truth.size))
        self.reading = Reading(
            values=values, received=received, truth=known,
            measured=self._offset.here(values["time"]) if last is None or alive else last.measured,
            advanced=received if last is None or alive else last.advanced,
        )  # fmt: skip

    def _fetch(self, name: str, size: int) -> bytes:
        found = self._plc.read(
            _BY_HANDLE, self._handles[name], ctypes.c_ubyte * size, return_ctypes=True
        )
        return bytes(found)

    def _connect(self) -> bool:
        """Open the connection and ask for handles."""
        import pyads

        address = self._address
        try:
            # The library has no time limit of its own for a host that does not answer.
            socket.create_connection((address.ip, TCP_PORT), max(self._timeout, 0.2)).close()
            plc = pyads.Connection(address.net_id, address.port, address.ip)
            plc.open()
        except Exception as error:
            if not _is_ads(error):
                raise
            self._failed(f"cannot connect: {error}")
            return False
        self._plc, self._heard = plc, False
        try:
            plc.set_timeout(max(1, round(1000.0 * self._timeout)))
            self._handles = {"to_host": plc.get_handle(address.to_host)}
            if self._writing:
                self._handles["from_host"] = plc.get_handle(address.from_host)
            try:
                self._handles["truth"] = plc.get_handle(TRUTH)
            except pyads.ADSError as error:
                if error.err_code != _NO_SYMBOL:
                    raise
        except Exception as error:
            if not _is_ads(error):
                raise
            self._disconnect()
            self._failed(f"cannot find the data block: {error}")
            return False
        self._failures = 0
        self.counters.reconnects += self.reading is not None
        return True

    def _failed(self, why: str) -> None:
        """Count a failure; after some in a row the connection is given up."""
        self.error = why
        self.counters.errors += 1
        self._failures = self._failures + 1
        if self._failures >= _REOPEN:
            self._disconnect()

    def _disconnect(self) -> None:
        """Close the connection, whatever state it is in."""
        plc, self._plc = self._plc, None
        self._failures = 0
        if plc is None:
            return
        try:
            plc.close()
        except Exception as error:
            if not _is_ads(error):
                raise
            self.error = str(error)


_NO_SYMBOL = 1808


def _is_ads(error: Exception) -> bool:
    """Whether it is what a network or the ADS library raises."""
    import pyads

    return isinstance(error, pyads.ADSError | OSError | RuntimeError)
