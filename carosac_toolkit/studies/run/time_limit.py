"""Time limit for Python code, in the thread that it runs in."""

from __future__ import annotations

import ctypes
import signal
import threading
import time
from types import FrameType, TracebackType
from typing import Any

EXCEPTION_WAIT_S = 1.0  # [s] an exception sent to a thread is waited for


class CaseTimeout(BaseException):
    """Expiry of the time limit; no `Exception`, so that code that catches those stops as well."""


class TimeLimit:
    """Context manager that raises `CaseTimeout` inside its block when the time is up.

    In the main thread a signal interrupts waiting as well, where the system has such signals;
    somebody else's alarm then waits for the end of the block. In any other thread the exception
    arrives with the next Python instruction, so a thread inside a long call of compiled code,
    `time.sleep` included, stops only when that call returns.

    Args:
        seconds: Time limit of the block [s].
    """

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._lock = threading.Lock()
        self._over = False
        self._fired = False
        self._by_signal = False
        self._handler: Any = None
        self._alarm = 0.0, 0.0  # [s] somebody else's: time left and interval
        self._start = 0.0
        self._timer: threading.Timer | None = None
        self._thread = 0

    def __enter__(self) -> TimeLimit:
        main = threading.current_thread() is threading.main_thread()
        self._by_signal = main and hasattr(signal, "setitimer")
        if self._by_signal:
            self._start = time.monotonic()
            self._alarm = signal.setitimer(signal.ITIMER_REAL, 0.0)
            self._handler = signal.signal(signal.SIGALRM, self._on_signal)
            signal.setitimer(signal.ITIMER_REAL, self._seconds)
        else:
            self._thread = threading.get_ident()
            self._timer = threading.Timer(self._seconds, self._send)
            self._timer.daemon = True
            self._timer.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._by_signal:
            self._over = True
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, self._handler or signal.SIG_DFL)
            self._set_alarm_again()
        elif self._timer is not None:
            with self._lock:
                self._over = True
            self._timer.cancel()
        if self._fired and kind is not CaseTimeout:
            self._await_exception()
            raise CaseTimeout

    def _set_alarm_again(self) -> None:
        """Give somebody else's alarm back, less the time that has passed."""
        left, interval = self._alarm
        if left > 0.0:
            left = max(left - (time.monotonic() - self._start), 1e-6)  # 0 would be none
            signal.setitimer(signal.ITIMER_REAL, left, interval)

    def _await_exception(self) -> None:
        """Let the exception arrive here if it is still on its way."""
        end = time.monotonic() + (0.0 if self._by_signal else EXCEPTION_WAIT_S)
        while time.monotonic() < end:
            time.sleep(0.001)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        """Raise in the main thread, unless it has left the block."""
        if not self._over:
            self._fired = True
            raise CaseTimeout

    def _send(self) -> None:
        """Send the exception to the thread, unless it has left the block."""
        with self._lock:
            if not self._over:
                self._fired = True
                ctypes.pythonapi.PyThreadState_SetAsyncExc(
                    ctypes.c_ulong(self._thread), ctypes.py_object(CaseTimeout)
                )
