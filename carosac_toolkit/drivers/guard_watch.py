"""The thread that brakes where a controller does not come back."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from carosac_toolkit.drivers.guarded import GuardedDriver

LATE = 3.0  # periods without a call from which on the winches slow down


class Watchdog:
    """Looks twice a period whether the guard was called; see `GuardedDriver.miss`."""

    def __init__(self, guard: GuardedDriver) -> None:
        self._guard = guard
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._look, name="guard watchdog", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def end(self) -> None:
        """Come to an end; safe to call from the watchdog itself."""
        self._closing.set()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _look(self) -> None:
        """Until closed."""
        guard, period = self._guard, self._guard.settings.period
        while not self._closing.wait(0.5 * period):
            waited = time.monotonic() - guard.began
            if waited > LATE * period:
                guard.miss(waited)
