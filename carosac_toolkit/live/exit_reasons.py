"""End of a live run from outside: signals, and a controller that never comes back."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from types import FrameType

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.live.messages import say
from carosac_toolkit.safety.guard import GuardedDriver

INTERRUPT_TIMEOUT_S = 3.0  # for a hanging controller, before the process ends
STOP_SIGNALS = tuple(
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")
    if hasattr(signal, name)
)


class ControllerHung(CarosacError):
    """A controller that did not come back and was interrupted."""


class Ending:
    """End of a run, by a signal or by the watchdog.

    Attributes:
        signal: Signal that asked for the end, or None.
    """

    def __init__(self, guard: GuardedDriver, last_words: Callable[[], object]) -> None:
        """Watch a guard; `last_words` is called before the process ends the hard way."""
        self._guard = guard
        self._last_words = last_words
        self._hung = False
        self._over = threading.Event()
        self.signal: signal.Signals | None = None

    def heard(self, number: int, frame: FrameType | None) -> None:
        """Stop in good order at a signal, at the second one at once."""
        if self._hung:
            raise ControllerHung("the controller did not come back; the winches were stopped")
        if self.signal is not None:
            raise KeyboardInterrupt
        self.signal = signal.Signals(number)
        self._guard.end(self.signal.name)

    def hang(self) -> None:
        """Interrupt a controller whose winches are stopped, or end the process."""
        self._hung = True
        threading.Thread(target=self._end_process, name="last resort", daemon=True).start()
        os.kill(os.getpid(), signal.SIGINT)

    def _end_process(self) -> None:
        """End the process, unless the controller comes back in time."""
        if self._over.wait(INTERRUPT_TIMEOUT_S):
            return
        self._guard.end_recording()
        self._last_words()
        say("carosac: the controller cannot be interrupted; the process ends", sys.stderr)
        os._exit(1)

    def over(self) -> None:
        """Take note that the controller came back."""
        self._over.set()


@contextlib.contextmanager
def ending_of(guard: GuardedDriver, last_words: Callable[[], object]) -> Iterator[Ending]:
    """Stop a guarded run in good order at `STOP_SIGNALS`, and where its controller hangs."""
    ending = Ending(guard, last_words)
    before = {number: signal.signal(number, ending.heard) for number in STOP_SIGNALS}
    guard.on_hang = ending.hang
    try:
        yield ending
    finally:
        ending.over()
        guard.on_hang = None
        for number, handler in before.items():
            signal.signal(number, handler)
