"""Filter of the lines that the ADS library itself writes to the standard error.

The library reports each broken frame there, by way of the file descriptor; the driver says once
what that means. All other lines pass.
"""

from __future__ import annotations

import contextlib
import os
import re
import sys
import threading
from collections.abc import Iterator

from carosac_toolkit.base.terminal import plain_stream

ADS_LINE = re.compile(rb"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d[+-]\d{4} (Verbose|Info|Warning|Error): ")


@contextlib.contextmanager
def without_ads_lines() -> Iterator[None]:
    """Drop the library's lines for as long as the block lasts; Python's own words go past this."""
    try:
        shown = os.dup(2)
    except OSError:  # there is no standard error
        yield
        return
    before, out, into = sys.stderr, *os.pipe()
    with contextlib.ExitStack() as stack:
        if _is_own(before):
            raw = stack.enter_context(open(os.dup(shown), "w", buffering=1))
            sys.stderr = plain_stream(raw)
        reader = threading.Thread(target=_filter, args=(out, shown), name="stderr", daemon=True)
        os.dup2(into, 2)
        os.close(into)
        reader.start()
        try:
            yield
        finally:
            sys.stderr = before
            os.dup2(shown, 2)  # the last end of the pipe that is written to: the reader ends
            reader.join(1.0)
            os.close(shown)


def _is_own(stream: object) -> bool:
    """Return whether a stream writes to the descriptor that the library writes to."""
    try:
        return stream is not None and stream.fileno() == 2  # type: ignore[attr-defined]
    except (AttributeError, OSError, ValueError):
        return False


def _filter(out: int, shown: int) -> None:
    """Hand on all other lines than those of the library."""
    rest = b""
    while data := os.read(out, 4096):
        *lines, rest = (rest + data).split(b"\n")
        for line in lines:
            if not ADS_LINE.match(line):
                with contextlib.suppress(OSError):
                    os.write(shown, line + b"\n")
    with contextlib.suppress(OSError):
        os.write(shown, rest)
    os.close(out)
