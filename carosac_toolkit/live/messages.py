"""Messages to the operator of a run; a missing operator must not drop the platform."""

from __future__ import annotations

import os
import sys
from typing import TextIO

from carosac_toolkit.base.terminal import CLEAR_LINE, TerminalText, printable


def say(text: str, stream: TextIO | None = None) -> None:
    """Print a line, by default to the standard output, beside a status line that is rewritten.

    A stream whose terminal or reader is gone takes nothing more; all of it is in the recording.
    """
    out = stream or sys.stdout
    begin = CLEAR_LINE if out is sys.stderr and out.isatty() else ""
    put(out, TerminalText(f"{begin}{printable(text)}\n"))


def put(stream: TextIO, text: str) -> None:
    """Write to a stream at once; one that nobody reads any more takes nothing from now on."""
    try:
        stream.write(text)
        stream.flush()
    except OSError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
