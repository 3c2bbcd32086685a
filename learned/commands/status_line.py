"""What a training does now, on standard error: one line that is written over on a terminal."""

from __future__ import annotations

import sys
import time
from typing import TextIO

from carosac_toolkit.base.terminal import CLEAR_LINE, TerminalText, printable

TERMINAL_INTERVAL_S = 0.5  # between two updates of the line
PLAIN_INTERVAL_S = 3.0  # to the first line elsewhere; every wait is twice the last one


class StatusLine:
    """Writes what is told, seldom enough to be read."""

    def __init__(self, stream: TextIO | None = None) -> None:
        """Write to a stream; None: standard error."""
        self._stream = stream or sys.stderr
        self._terminal = self._stream.isatty()
        self._wait = TERMINAL_INTERVAL_S if self._terminal else PLAIN_INTERVAL_S
        self._began = time.monotonic()
        self._next = self._began if self._terminal else self._began + self._wait
        self._shown = False

    def tell(self, text: str) -> None:
        """Show what goes on, unless something was shown just now."""
        now = time.monotonic()
        if now < self._next:
            return
        line = f"{text}, {now - self._began:.0f} s"
        if self._terminal:
            self._write(CLEAR_LINE + printable(line))
            self._shown = True
        else:
            self._write(printable(line) + "\n")
            self._wait *= 2.0
        self._next = now + self._wait

    def clear(self) -> None:
        """Make room for another line."""
        if self._shown:
            self._write(CLEAR_LINE)
            self._shown = False

    def _write(self, text: str) -> None:
        self._stream.write(TerminalText(text))
        self._stream.flush()
