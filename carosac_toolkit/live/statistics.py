"""Statistics of a run while it goes on, without keeping it."""

from __future__ import annotations

import sys
import time
from collections import Counter
from typing import Any, TextIO

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.terminal import TerminalText, printable
from carosac_toolkit.live.histogram import Histogram
from carosac_toolkit.live.messages import put, say
from carosac_toolkit.loop.loop import Step
from carosac_toolkit.safety.guard import GuardedDriver

TERMINAL_INTERVAL_S, FILE_INTERVAL_S = 0.2, 2.0  # between two lines


class Statistics:
    """Counters of a run, printed as it goes on; call it with every step.

    Attributes:
        limits: Number of cycles in which each limit changed a command.
        late_by: Number of late cycles by the stage that took longest in each.
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
        self.late_by: Counter[str] = Counter()
        self._latency, self._jitter = Histogram(), Histogram()
        self._stages: dict[str, float] = {}
        self._late, self._recorded = 0, 0.0
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
        self._latency.add(step.latency)
        if self._last is not None:
            self._jitter.add(abs(now - self._last - self._guard.settings.period))
        self._last = now
        self._blame(step)
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
        self._stages["display"] = time.monotonic() - now

    def _blame(self, step: Step | None) -> None:
        """Count the cycle before by its longest stage if it was late; take the stages of `step`."""
        late, recorded = self._guard.overruns, self._guard.monitor.rows.waited
        if late > self._late and self._stages:
            self.late_by[max(self._stages, key=self._stages.__getitem__)] += late - self._late
        self._late = late
        if step is not None:
            waited = recorded - self._recorded
            command = step.durations.get("command", 0.0) - waited
            self._stages = {**step.durations, "command": command, "recorder": waited}
        self._recorded = recorded

    def timing(self) -> str:
        """Return how even the cycles came, and what made late ones late, in words."""
        self._blame(None)
        shown = [self._jitter.quantile(0.5), self._jitter.quantile(0.99), self._jitter.largest]
        half, most, largest = (f"{1e3 * (x or 0.0):.2f}" for x in shown)
        stages = ", ".join(f"{stage} {count}" for stage, count in self.late_by.most_common())
        late = f"{self._guard.overruns} late" + (f" (by {stages})" if stages else "")
        return f"{late}; jitter {half} ms median, {most} ms p99, {largest} ms largest"

    def end_line(self) -> None:
        """End the status line, which is rewritten in place."""
        if self._stream.isatty() and self._printed > self._began:
            put(self._stream, "\n")

    def data(self) -> dict[str, Any]:
        """Return the numbers of the whole run; quantiles as of `Histogram`."""
        self._blame(None)
        rms = np.sqrt(self._squares / self._known) if self._known else (None, None)
        return {
            "cycles": self.cycles,
            "latency_median_s": self._latency.quantile(0.5),
            "latency_p99_s": self._latency.quantile(0.99),
            "jitter_p50_s": self._jitter.quantile(0.5),
            "jitter_p99_s": self._jitter.quantile(0.99),
            "jitter_max_s": self._jitter.largest,
            "late_cycles": self._guard.overruns,
            "late_cycles_by_stage": dict(self.late_by),
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
        evidence = self._guard.homing.evidence
        if evidence is not None:
            say(f"homed anew: {evidence.sensitivity}")

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
