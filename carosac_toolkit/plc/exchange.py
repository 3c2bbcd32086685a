"""The exchange of data with a PLC: one thread reads and writes one block each, again and again.

The thread makes all calls of the link, which therefore needs no locks. A connection that broke
stays broken until it is opened anew, which the thread does as well. Without `writing` nothing is
ever written. With it, the exchange writes from a request on until `quiet`, and never while the PLC
obeys another session: all hosts share one block. After each connect it compares the machine of the
PLC with that of the robot file, and exchanges nothing with the PLC of another robot.
"""

from __future__ import annotations

import secrets
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import Any

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.plc import blocks, identity
from carosac_toolkit.plc.blocks import FROM_HOST, TO_HOST, TRUTH, Answer, Request
from carosac_toolkit.plc.clock_offset import ClockOffset
from carosac_toolkit.plc.link import LinkError, PlcLink
from carosac_toolkit.plc.reading import LinkCounters, Reading

FIRST_DATA_TIMEOUT_S = 2.0  # beyond it a PLC is off or elsewhere
RECONNECT_PERIOD_S = 0.2
FAILURES_BEFORE_RECONNECT = 4  # calls in a row: a lost packet or two is no broken connection
CLOCK_MAX_S = 1e11  # beyond it a double no longer resolves 0.02 ms
_RELEASING = (Request.DISABLE, Request.HOLD)


class PlcExchange:
    """The cyclic exchange of one host with one PLC.

    Attributes:
        counters: Counts of cycles, errors and restarts.
        number: Public number of this host, which the PLC shows while it obeys this host.
        reading: Newest data from the PLC, or None.
        error: Newest error in words, or None if the last cycle succeeded.
        refusal: Why this is the PLC of another robot, or None.
        emulated: Whether the PLC is an emulated one, which knows the true state of its robot.
        wants_truth: Whether to read that state as well, which takes one more call a cycle.
    """

    def __init__(
        self, link: PlcLink, machine: Mapping[str, Any], *, period: float, writing: bool
    ) -> None:
        """Set up; `open` connects.

        Args:
            link: Wire to the PLC; from `open` on only the thread calls it.
            machine: Members of `blocks.machine` by name, which those of the PLC must equal.
            period: Period of the thread [s]; commands are sent at once.
            writing: Whether anything may be written at all.
        """
        self.counters = LinkCounters()
        self.number = secrets.randbelow(2**32 - 1) + 1
        self.reading: Reading | None = None
        self.error: str | None = None
        self.refusal: str | None = None
        self.emulated = False
        self.wants_truth = False
        n = int(machine["cables"])
        self._link, self._n, self._period, self._writing = link, n, period, writing
        self._machine = machine
        self._to_host, self._from_host = blocks.to_host(n), blocks.from_host(n)
        self._truth = blocks.truth(n)
        self._offset = ClockOffset()
        self._connected = False
        self._wake = threading.Condition()
        self._answered = threading.Condition()
        self._calls: deque[tuple[Future[Any], Callable[..., Any], tuple[Any, ...]]] = deque()
        self._fresh = False
        self._active = False  # whether anything is written now
        self._ending = False  # whether that ends with the next write
        self._heard = False  # whether the PLC was read since the connection was opened
        self._pending: int | None = None  # disable or hold that was not answered in time
        self._running = False
        self._thread: threading.Thread | None = None
        self._out: dict[str, Any] = {
            "layout": blocks.BLOCK_LAYOUT, "cables": n, "host_number": self.number,
            "session": secrets.randbelow(2**64 - 1) + 1, "machine": machine["hash"],
            "follow": 0, "request": 0, "request_number": secrets.randbelow(2**31), "command": 0,
            "period": 0.0, "length": 0.0, "rate": 0.0, "fault": 0,
        }  # fmt: skip
        self._sequence, self._failures, self._ended = 0, 0, 0.0

    def open(self) -> Reading:
        """Start the thread and wait for the first data.

        Raises:
            CarosacError: No data came within `FIRST_DATA_TIMEOUT_S`, or the PLC is of another
                robot; the thread has ended then.
        """
        self._running = True
        self._thread = threading.Thread(target=self._run, name="plc-exchange", daemon=True)
        self._thread.start()
        end = time.monotonic() + FIRST_DATA_TIMEOUT_S
        with self._answered:
            while not (self.reading or self.refusal) and time.monotonic() < end:
                self._answered.wait(max(0.0, end - time.monotonic()))
        if self.reading is None:
            late = f"{self.error or 'no answer'} after {FIRST_DATA_TIMEOUT_S:g} s"
            self.close()
            raise CarosacError(f"PLC {self._link.address}: {self.refusal or late}")
        return self.reading

    def close(self) -> None:
        """End the thread and the connection; safe to call twice."""
        self._running = False
        with self._wake:
            self._wake.notify()
        if self._thread is not None:
            self._thread.join(self._patience)
            self._thread = None

    @property
    def other(self) -> int:
        """Number of another host that the PLC obeys, by its newest data; 0 if there is none."""
        reading = self.reading
        owner = 0 if reading is None else int(reading.values["owner"])
        return 0 if owner == self.number else owner

    @property
    def age(self) -> float:
        """Time since the newest data came from the PLC [s]."""
        reading = self.reading
        return float("inf") if reading is None else time.monotonic() - reading.received

    def send(self, length: Any, rate: Any, period: float) -> None:
        """Send a command at once; the winches follow it from then on.

        Args:
            length: Set positions [unit], shape (n,).
            rate: Set velocities [unit/s], shape (n,).
            period: Time between two commands [s].
        """
        with self._wake:
            out = self._out
            command = (out["command"] + 1) % 2**32
            self._out = out | {
                "length": length, "rate": rate, "period": period, "follow": 1, "command": command,
            }  # fmt: skip
            self._fresh = True
            self._wake.notify()

    def request(self, request: Request, patience: float = 0.0, *, fault: int = 0) -> Answer:
        """Send a request to the PLC; commands sent before no longer count.

        Args:
            request: The request.
            patience: How long to wait for the answer [s]; 0: not at all.
            fault: Number of the fault to hold.

        A disable or hold that is not answered in time stays, and the heartbeat stands still, so
        that the watchdog of the PLC stops the winches even if the request never arrives.

        Returns:
            The answer, or `Answer.NONE` if none came in time.
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
        answer = self._wait_for_answer(number, patience)
        with self._wake:
            if self._out["request_number"] == number:
                if request in _RELEASING and answer is Answer.NONE:
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

    def wait_for_data(self, received: float, patience: float) -> bool:
        """Wait for data received after a time; return whether they came.

        Args:
            received: By `time.monotonic` [s].
            patience: How long to wait [s].
        """
        end = time.monotonic() + patience
        with self._answered:
            while self.reading is None or self.reading.received <= received:
                left = end - time.monotonic()
                if left <= 0.0 or not self._running:
                    return False
                self._answered.wait(left)
        return True

    def read(self, block: str, size: int) -> bytes:
        """Return the bytes of a block, read between two cycles.

        Raises:
            LinkError: As of `PlcLink.read`, or the connection is broken.
        """
        data: bytes = self._call(self._link.read, block, size)
        return data

    def write(self, block: str, data: bytes) -> None:
        """Write the bytes of a block between two cycles.

        Raises:
            LinkError: As of `PlcLink.write`, the connection is broken, or nothing may be written.
        """
        if not self._writing:
            raise LinkError(f"PLC {self._link.address}: nothing may be written")
        self._call(self._link.write, block, data)

    @property
    def _patience(self) -> float:
        """Time within which the thread has finished a cycle, whatever the network does [s]."""
        return 10.0 * self._link.timeout + 2.0

    def _call(self, method: Callable[..., Any], *arguments: Any) -> Any:
        """Have the thread make one call of the link."""
        answer: Future[Any] = Future()
        with self._wake:
            self._calls.append((answer, method, arguments))
            self._wake.notify()
        try:
            return answer.result(self._patience)
        except TimeoutError as error:
            answer.cancel()
            raise LinkError(f"PLC {self._link.address}: {self.error or 'no answer'}") from error

    def _wait_for_answer(self, number: int, patience: float) -> Answer:
        """Return the answer to a request, `Answer.NONE` if it did not come in time [s]."""
        end = time.monotonic() + patience
        with self._answered:
            while time.monotonic() < end:
                reading = self.reading
                if reading is not None and reading.values["answered"] == number:
                    return Answer(reading.values["answer"])
                self._answered.wait(max(0.0, end - time.monotonic()))
        return Answer.NONE

    def _run(self) -> None:
        """Run the thread: on an absolute schedule, and at once if there is something to send."""
        due = time.monotonic()
        try:
            while self._running:
                if not self._connected and not self._connect():
                    with self._wake:
                        self._wake.wait_for(lambda: not self._running, RECONNECT_PERIOD_S)
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
        """Wait for the next tick, or for something to send; return the tick after it [s]."""
        now = time.monotonic()
        due += self._period
        if now > due:
            self.counters.missed += int((now - due) / self._period)
            due = now
        with self._wake:
            self._wake.wait_for(
                lambda: self._fresh or (self._calls and self.error is None) or not self._running,
                max(0.0, due - now),
            )  # calls are made after a cycle that succeeded: one that failed waits for its tick
        return min(due, time.monotonic())

    def _cycle(self) -> None:
        """Write if it is allowed, and read."""
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
        except LinkError as error:
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
            self._make_calls()
        with self._answered:
            self._answered.notify_all()

    def _make_calls(self) -> None:
        """Make the calls that other threads wait for."""
        while self._calls:
            answer, method, arguments = self._calls.popleft()
            if answer.set_running_or_notify_cancel():
                try:
                    answer.set_result(method(*arguments))
                except LinkError as error:
                    answer.set_exception(error)

    def _may_write(self) -> bool:
        """Return whether there is something to write, and nobody else writes."""
        with self._wake:
            self._active = self._active and not self.other
            allowed = self._writing and self._active and self._heard
            self._fresh = self._fresh and allowed
        return allowed

    def _write(self) -> None:
        """Send the newest of everything, with the next heartbeat."""
        with self._wake:
            out, self._fresh, ending = self._out, False, self._ending
            held = self._pending is not None
        self._sequence = (self._sequence + (not held)) % 2**32
        data = self._from_host.pack(
            out | {"sequence": self._sequence, "sequence_end": self._sequence}
        )
        self._link.write(FROM_HOST, data)
        with self._wake:
            if ending and self._ending:
                self._active = self._ending = False

    def _read(self) -> None:
        """Read the data of the PLC; keep them if they are whole."""
        values = self._to_host.unpack(self._link.read(TO_HOST, self._to_host.size))
        received = time.monotonic()
        if not blocks.whole(self._to_host, values, self._n):
            self.counters.torn += 1
            return
        if not abs(values["time"]) <= CLOCK_MAX_S:
            raise LinkError(
                f"time of the PLC: got {values['time']} s; allowed: at most {CLOCK_MAX_S:g} s"
            )
        last = self.reading
        if last is not None and (
            values["boot"] != last.values["boot"] or values["time"] < last.values["time"]
        ):
            self.counters.restarts += 1
            self._offset.clear()
        alive = last is None or all(values[x] != last.values[x] for x in ("sequence", "time"))
        if alive:
            self._offset.add(received, values["time"])
        truth = None
        if self.wants_truth and self._link.has(TRUTH):
            truth = self._truth.unpack(self._link.read(TRUTH, self._truth.size))
        self.reading = Reading(
            values=values, received=received, truth=truth,
            measured=self._offset.here(values["time"]) if last is None or alive else last.measured,
            advanced=received if last is None or alive else last.advanced,
        )  # fmt: skip

    def _connect(self) -> bool:
        """Open the connection to the PLC of this robot; return whether that succeeded."""
        try:
            self._link.connect(writing=self._writing)
            plc = identity.read_machine(self._link, self._n)
            self.refusal = identity.refusal(plc, self._machine)
            if self.refusal is not None:
                raise LinkError(self.refusal)
        except (LinkError, blocks.WrongBlock) as error:
            self._disconnect()
            self._failed(str(error))
            with self._answered:
                self._answered.notify_all()
            return False
        self._connected, self._heard, self._failures = True, False, 0
        self.emulated = self.emulated or self._link.has(TRUTH)  # known also while reconnecting
        self.counters.reconnects += self.reading is not None
        return True

    def _failed(self, reason: str) -> None:
        """Count a failure; give the connection up after some in a row."""
        self.error = reason
        self.counters.errors += 1
        self._failures += 1
        if self._failures >= FAILURES_BEFORE_RECONNECT:
            self._disconnect()

    def _disconnect(self) -> None:
        """Close the connection, in whatever state it is."""
        self._connected, self._failures = False, 0
        try:
            self._link.close()
        except LinkError as error:
            self.error = str(error)
