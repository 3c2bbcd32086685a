"""Wall-clock time of a guard: late cycles, and controllers that never come back."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable

from carosac_toolkit.loop.drive_state import Fault
from carosac_toolkit.safety.guard.checks import Finding
from carosac_toolkit.safety.guard.settings import GuardSettings

PERIODS_UNTIL_MISSED = 3.0  # without a call, from which on the winches slow down


class CycleTimer:
    """Counter of cycles that took longer than a period; without real time none does.

    Attributes:
        began: Start of the last period, by the monotonic clock [s].
        late: Number of late cycles since the start.
    """

    def __init__(self, settings: GuardSettings, *, real_time: bool) -> None:
        self._settings = settings
        self._real_time = real_time
        self._second: deque[bool] = deque(maxlen=max(10, round(1.0 / settings.period)))
        self._warming = 0
        self.late = 0
        self.begin()

    @property
    def warming(self) -> bool:
        """True in the first cycles, which may be slow."""
        return self._warming > 0

    @property
    def waited(self) -> float:
        """Time since the period began [s]."""
        return time.monotonic() - self.began

    def begin(self) -> None:
        """Begin a period."""
        self.began = time.monotonic()

    def warm_up(self) -> None:
        """Begin the first cycles after `enable`."""
        self._warming = self._settings.warm_up if self._real_time else 0
        self._second.clear()
        self.begin()

    def end_cycle(self) -> Finding | None:
        """Count a cycle that has its command; return a finding where too many were late."""
        if self._warming > 0:
            self._warming -= 1
            return None
        late = self._real_time and self.waited > self._settings.period
        self.late += late
        self._second.append(late)
        share = sum(self._second) / len(self._second)
        if len(self._second) < (self._second.maxlen or 0) or share <= self._settings.overrun_share:
            return None
        text = f"{100 * share:.0f} % of the cycles of the last second came too late"
        return Finding(fault=Fault.OVERRUN, text=text)


class Watchdog:
    """Thread that checks twice a period whether the guard was called.

    Attributes:
        miss: Called as long as ticks are missed.
    """

    def __init__(
        self, period: float, waited: Callable[[], float], miss: Callable[[], None],
        failed: Callable[[Exception], None],
    ) -> None:  # fmt: skip
        """Take the time waited since the last call [s], and what to do where ticks are missed.

        `failed` hears what `miss` raises, and must not raise; the watchdog goes on.
        """
        self._period = period
        self._waited, self.miss, self._failed = waited, miss, failed
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._look, name="guard watchdog", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def end(self) -> None:
        """End the thread; safe to call from the watchdog itself."""
        self._closing.set()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _look(self) -> None:
        """Check until closed."""
        while not self._closing.wait(0.5 * self._period):
            if self._waited() > PERIODS_UNTIL_MISSED * self._period:
                try:
                    self.miss()
                except Exception as error:  # the only one who can still brake must not end
                    self._failed(error)
