"""Progress of a study, on standard error."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable
from typing import TextIO

from carosac_toolkit.base.terminal import CLEAR_LINE, TerminalText, printable
from carosac_toolkit.studies.run.rows import CASE_STATUSES, Row

TERMINAL_INTERVAL_S = 0.5  # [s] between two updates of the line on a terminal
PLAIN_INTERVAL_S = 30.0  # [s] to the first line elsewhere; every wait is twice the last one


class Progress:
    """Counter of finished cases that estimates the remaining time.

    Args:
        total: Number of cases of the study.
        done: Rows that are there already.
        quiet: True to report nothing.
        stream: Output stream; standard error by default.
        share: Tells how much of the work is done, 0 to 1; None: as many as cases are finished.
    """

    def __init__(
        self,
        total: int,
        done: Iterable[Row],
        *,
        quiet: bool,
        stream: TextIO | None = None,
        share: Callable[[], float] | None = None,
    ) -> None:
        self._stream = stream or sys.stderr
        self._quiet = quiet
        self._terminal = self._stream.isatty()
        self._interval = TERMINAL_INTERVAL_S if self._terminal else PLAIN_INTERVAL_S
        self._total = total
        self._counts = dict.fromkeys(CASE_STATUSES, 0)
        self._count(done)
        self._before = self._told = self.finished
        self._start = self._shown = time.monotonic()
        self._share = share
        self._share_before = share() if share else 0.0
        if self._before and not quiet:
            self._write(f"study: {self._before} of {total} cases are there already", "\n")

    @property
    def finished(self) -> int:
        """Number of cases that have a row."""
        return sum(self._counts.values())

    def add(self, rows: Iterable[Row]) -> None:
        """Count rows, and report from time to time, and as soon as the rest can be estimated."""
        first = self.finished == self._before
        self._count(rows)
        now = time.monotonic()
        estimable = first and self._before < self.finished < self._total
        if estimable or now - self._shown >= self._interval:
            self._shown = now
            self._interval *= 1.0 if self._terminal else 2.0
            self._tell(end="" if self._terminal else "\n")

    def close(self) -> None:
        """Report a last time."""
        if self.finished > self._told or self._terminal:
            self._tell(end="\n")

    def say(self, text: str) -> None:
        """Write a separate line."""
        if not self._quiet:
            self._write(text, "\n")

    def line(self) -> str:
        """Return the current status line."""
        elapsed = time.monotonic() - self._start
        text = f"study: {self.finished}/{self._total} cases, {_clock(elapsed)}"
        new = float(self.finished - self._before)
        left = float(self._total - self.finished)
        if self._share:
            share = self._share()
            new, left = share - self._share_before, 1.0 - share
            text += f", {100.0 * share:.0f} %"
        if self.finished < self._total and left > 0.0 and new > 0.0:
            text += f", {_clock(elapsed / new * left)} to go"
        bad = [f"{self._counts[name]} {name.replace('_', ' ')}" for name in CASE_STATUSES[1:]
               if self._counts[name]]  # fmt: skip
        return ", ".join([text, *bad])

    def _count(self, rows: Iterable[Row]) -> None:
        """Count rows by status."""
        for row in rows:
            self._counts[str(row["status"])] += 1

    def _tell(self, end: str) -> None:
        """Write the line, over the last one on a terminal."""
        self._told = self.finished
        if not self._quiet:
            self._write(self.line(), end)

    def _write(self, text: str, end: str) -> None:
        """Write a line at once, over the last one on a terminal."""
        start = CLEAR_LINE if self._terminal else ""
        self._stream.write(TerminalText(start + printable(text) + end))
        self._stream.flush()


def _clock(seconds: float) -> str:
    """Return hours, minutes and seconds."""
    minutes, second = divmod(round(seconds), 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours}:{minute:02d}:{second:02d}"
