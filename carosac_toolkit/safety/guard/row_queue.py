"""Queue of journal rows, written by a thread of its own, so that no disk can hold up a robot.

The guard journals measurements and commands while it holds its lock; a journal that blocks there,
as one on a network disk that hangs, would keep the watchdog from braking. So the guard puts rows
into a queue and goes on. The queue is bounded, in number and in age: a run whose recording is
further behind is a run that nobody could explain afterwards, and the guard stops it.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

WAITING_ROWS_MAX = 20_000  # about 15 MB
END_TIMEOUT_S = 5.0  # for the last rows, after which they are given up

Row = tuple[float, Callable[..., None], tuple[Any, ...], dict[str, Any]]


class RowQueue:
    """Queue of calls of a journal, in order; safe from several threads.

    Attributes:
        lost: Rows that were given up: there was no room, or the journal failed.
        waited: Time spent in `written` [s].
    """

    def __init__(
        self, *, lag: float, threaded: bool, describe: Callable[[Exception], str],
        rows_max: int = WAITING_ROWS_MAX,
    ) -> None:  # fmt: skip
        """Set up; nothing is started before the first row.

        Args:
            lag: Largest time for which a row may wait [s].
            threaded: Whether a thread writes; else `put` does, for runs that no clock drives: they
                outrun any queue, and nothing needs to be braked while they wait.
            describe: Puts an error of the journal into words.
            rows_max: Largest number of rows that may wait.
        """
        self._lag, self._rows_max, self._threaded = lag, rows_max, threaded
        self._describe = describe
        self._rows: deque[Row] = deque()
        lock = threading.RLock()
        self._wake = threading.Condition(lock)
        self._done = threading.Condition(lock)  # rows finished
        self._put = self._finished = 0
        self.waited = 0.0
        self._thread: threading.Thread | None = None
        self._writing: float | None = None  # when the row was put that the journal is at
        self._ending = False
        self._broken: str | None = None
        self.lost = 0

    @property
    def trouble(self) -> str | None:
        """Reason why the recording is no longer complete or in time, or None."""
        with self._wake:
            if self._broken is not None:
                return self._broken
            oldest, lost = self._writing, self.lost
            if oldest is None and self._rows:
                oldest = self._rows[0][0]
        behind = 0.0 if oldest is None else time.monotonic() - oldest
        if behind > self._lag:
            return f"it is {behind:.1f} s behind; allowed: {self._lag:g} s"
        return f"{lost} rows found no room" if lost else None

    def written(self, timeout: float) -> bool:
        """Return whether all rows up to now have been handed to the journal.

        Args:
            timeout: Longest wait for that [s].
        """
        began = time.monotonic()
        with self._wake:
            last = self._put
            self._done.wait_for(lambda: self._finished >= last or self._broken is not None, timeout)
            self.waited += time.monotonic() - began
            return self._finished >= last and self._broken is None

    def put(self, method: Callable[..., None], *arguments: Any, **named: Any) -> None:
        """Queue a call of the journal; never wait for it where a thread writes."""
        row = (time.monotonic(), method, arguments, named)
        if not self._threaded:
            self._write(row)
            return
        with self._wake:
            if self._ending or self._broken is not None or len(self._rows) >= self._rows_max:
                self.lost += 1
                return
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="recording", daemon=True)
                self._thread.start()
            self._rows.append(row)
            self._put += 1
            self._wake.notify()

    def end(self, timeout: float = END_TIMEOUT_S) -> int:
        """Wait for the last rows, not longer than `timeout` [s]; safe to call twice.

        Returns:
            Number of rows that were not written, in all.
        """
        with self._wake:
            timeout = 0.0 if self._ending else timeout
            self._ending = True
            self._wake.notify()
        if self._thread is not None:
            self._thread.join(timeout)
        with self._wake:
            self.lost += len(self._rows)
            self._rows.clear()
            return self.lost + (self._writing is not None)

    def _run(self) -> None:
        """Write rows until the end, and then those that are left."""
        while True:
            with self._wake:
                self._wake.wait_for(lambda: bool(self._rows) or self._ending)
                if not self._rows:
                    return
                row = self._rows.popleft()
                self._writing = row[0]
            self._write(row)
            with self._wake:
                self._writing = None
                self._finished += 1
                self._done.notify_all()
                if self._broken is not None:
                    self.lost += len(self._rows)
                    self._rows.clear()
                    return

    def _write(self, row: Row) -> None:
        """Call the journal; after one failure never again."""
        _, method, arguments, named = row
        if self._broken is not None:
            self.lost += 1
            return
        try:
            method(*arguments, **named)
        except Exception as error:  # whatever it is, it must not keep the winches from braking
            with self._wake:
                self._broken = self._describe(error)
                self.lost += 1
