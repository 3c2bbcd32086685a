"""Statistics of a run while it goes on, without keeping it."""

from __future__ import annotations

import sys
import time
from collections import Counter
from typing import Any, TextIO

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.terminal import TerminalText, printable
from carosac_toolkit.live.messages import put, say
from carosac_toolkit.loop.loop import Step
from carosac_toolkit.safety.guard import GuardedDriver

TERMINAL_INTERVAL_S, FILE_INTERVAL_S = 0.2, 2.0  # between two lines
QUANTILE_CYCLES_MAX = 200_000  # the first ones, of which quantiles are taken


class Statistics:
    """Counters of a run, printed as it goes on; call it with every step.

    Attributes:
        limits: Number of cycles in which each limit changed a command.
        position: Newest estimated position in W [m], shape (3,); None before the first cycle.
    """

    def __init__(self, guard: GuardedDriver, stream: TextIO | None = None) -> None:
        """Print to `stream`, by default the standard error."""
        self._guard = guard
        self._given = stream
        self._every = TERMINAL_INTERVAL_S if self._stream.isatty() else FILE_INTERVAL_S
        self._began = self._printed = time.monotonic()
        self._last: float | None = None
        self.cycles = 0
        self.limits: Counter[str] = Counter()
        self._latency: list[float] = []
        self._interval: list[float] = []
        self._squares: Array = np.zeros(2)
        self._known = 0
        self.position: Array | None = None

    @property
    def _stream(self) -> TextIO:
        """Stream to print to."""
        return self._given or sys.stderr

    def __call__(self, step: Step) -> None:
        """Count one cycle."""
        now = time.monotonic()
        self.cycles += 1
        if self.cycles == 1:
            self._say_home()
        self.limits.update({hit.limit for hit in step.command.limited})
        if len(self._latency) < QUANTILE_CYCLES_MAX:
            self._latency.append(step.latency)
            if self._last is not None:
                self._interval.append(now - self._last)
        self._last = now
        self.position = step.belief.position[0]
        reference = step.reference.position[0, 0]
        if step.truth is not None:
            wrong = (
                step.truth.position[0] - reference,
                step.belief.position[0] - (step.truth.position[0]),
            )
            self._squares = self._squares + np.square(wrong).sum(axis=1)
            self._known += 1
        if now - self._printed >= self._every:
            self._printed = now
            self._print(step, reference)

    def end_line(self) -> None:
        """End the status line, which is rewritten in place."""
        if self._stream.isatty() and self._printed > self._began:
            put(self._stream, "\n")

    def data(self, period: float) -> dict[str, Any]:
        """Return the numbers of the whole run."""
        late = np.array(self._interval)
        jitter = np.abs(late - period)
        rms = np.sqrt(self._squares / self._known) if self._known else (None, None)
        return {
            "cycles": self.cycles,
            "latency_median_s": _quantile(self._latency, 0.5),
            "latency_p99_s": _quantile(self._latency, 0.99),
            "jitter_p50_s": _quantile(jitter, 0.5),
            "jitter_p99_s": _quantile(jitter, 0.99),
            "late_cycles": self._guard.overruns,
            "limited_cycles": dict(self.limits),
            "tracking_rmse_m": rms[0],
            "estimation_rmse_m": rms[1],
            "position_m": None if self.position is None else self.position.tolist(),
        }

    def _say_home(self) -> None:
        """Print by how much homing changed the readings: far more than yesterday is a slip."""
        change = self._guard.home_change
        if change is not None:
            changes = ", ".join(f"{1e3 * x:+.1f}" for x in change)
            say(f"homed: the offsets of the cables changed by {changes} mm")

    def _print(self, step: Step, reference: Array) -> None:
        """Print state, time, estimate, distance to the reference, latency and limits in a line."""
        estimate = step.belief.position[0]
        far = 1e3 * float(np.linalg.norm(estimate - reference))
        place = " ".join(f"{x:+.3f}" for x in estimate)
        text = (
            f"{self._guard.state:<10} {float(step.measurement.time[0]):8.2f} s  at {place} m  "
            f"off {far:6.1f} mm  cycle {1e3 * step.latency:5.2f} ms  "
            f"limited {sum(self.limits.values())}  late {self._guard.overruns}"
        )
        start, end = ("\r", "\x1b[K") if self._stream.isatty() else ("", "\n")
        put(self._stream, TerminalText(start + printable(text) + end))


def _quantile(values: Any, share: float) -> float | None:
    """Return a quantile, or None where there are no values."""
    return float(np.quantile(values, share)) if len(values) else None
