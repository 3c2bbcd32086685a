"""Note beside every running case, so that its death is attributed to it alone."""

from __future__ import annotations

import faulthandler
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

_START_LINE_PATTERN = re.compile(r"^start (\S+)\n", re.MULTILINE)


@dataclass(frozen=True)
class Death:
    """End of earlier attempts at a case.

    Attributes:
        attempts: Number of attempts that ended with the process.
        timed_out: True if the last one was ended because it did not stop when its time was up.
        cause: Known cause; empty if unknown.
        wall_time: Duration of the last attempt, as far as known [s].
    """

    attempts: int
    timed_out: bool
    cause: str
    wall_time: float


def read_death(note: Path) -> Death | None:
    """Read the note of a case; None if no attempt has died."""
    try:
        text, changed = note.read_text(encoding="utf-8", errors="replace"), note.stat().st_mtime
    except FileNotFoundError:
        return None
    _, *parts = _START_LINE_PATTERN.split(text)  # time, message, time, message, ...
    if not parts:
        return None
    started, message = parts[-2:]
    return Death(
        attempts=len(parts) // 2,
        timed_out=message.startswith("Timeout ("),
        cause=_cause(message),
        wall_time=max(0.0, changed - float(started)),
    )


@contextmanager
def noted(note: Path, kill_after: float) -> Iterator[None]:
    """Keep a note of the running case; end the process if the block outlasts its time.

    The interpreter's fault handler writes into the note what it knows when the process dies, and
    ends the process, also one whose threads are stuck in compiled code that lets nobody in.

    Args:
        note: File that holds the note; it is removed when the block is left.
        kill_after: Time after which the process is ended [s].
    """
    before = faulthandler.is_enabled()
    with note.open("a", encoding="utf-8") as file:
        file.write(f"start {time.time()}\n")
        file.flush()
        faulthandler.enable(file)
        faulthandler.dump_traceback_later(kill_after, exit=True, file=file)
        try:
            yield
        finally:
            faulthandler.cancel_dump_traceback_later()
            faulthandler.disable()
    if before:
        faulthandler.enable()
    note.unlink(missing_ok=True)


def _cause(message: str) -> str:
    """Return the first line of a fault handler's message, with the place in the case's thread."""
    if not message:
        return ""
    first = message.splitlines()[0].removeprefix("Fatal Python error: ")
    threads = re.split(r"^(?:Current thread|Thread) .*$", message, flags=re.MULTILINE)
    of_case = next((text for text in threads if "in run_attempt" in text), "")
    place = re.search(r'File "(.+)", line (\d+) in (\S+)', of_case)
    if place is None:
        return first
    return f"{first} in {place[3]} ({Path(place[1]).name}:{place[2]})"
