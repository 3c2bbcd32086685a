"""Time of a guard by the clock on the wall: cycles that come late, controllers that never come."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable

from carosac_toolkit.loop.drive_state import Fault
from carosac_toolkit.safety.guard.checks import Finding
from carosac_toolkit.safety.guard.settings import GuardSettings

LATE = 3.0  # periods without a call from which on the winches slow down


class Punctuality:
    """Counts cycles that took longer than a period; where no clock runs none does.

    Attributes:
        began: When the last period began, by the monotonic clock [s].
        late: Cycles since the start that took longer.
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
        """Whether this is one of the first cycles, which may be slow."""
        return self._warming > 0

    @property
    def waited(self) -> float:
        """Since the period began [s]."""
        return time.monotonic() - self.began

    def begin(self) -> None:
        """A period begins."""
        self.began = time.monotonic()

    def warm_up(self) -> None:
        """The first cycles begin."""
        self._warming = self._settings.warm_up if self._real_time else 0
        self._second.clear()
        self.begin()

    def end_cycle(self) -> Finding | None:
        """The controller has commanded: count, and say where too many cycles were late."""
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
    """A thread that looks twice a period whether the guard was called."""

    def __init__(
        self, period: float, waited: Callable[[], float], miss: Callable[[], None],
        failed: Callable[[Exception], None],
    ) -> None:  # fmt: skip
        """Call `miss` as long as `waited` [s] says that ticks are missed.

        `failed` hears what `miss` raises, and must not raise; the watchdog goes on.
        """
        self._period = period
        self._waited, self._miss, self._failed = waited, miss, failed
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
        while not self._closing.wait(0.5 * self._period):
            if self._waited() > LATE * self._period:
                try:
                    self._miss()
                except Exception as error:  # the only one who can still brake must not end
                    self._failed(error)
