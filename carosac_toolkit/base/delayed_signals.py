"""Ctrl-C, or SIGTERM of a batch system, in the middle of a piece of work: it is finished first."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)
DEFAULT_HANDLERS = (signal.default_int_handler, signal.SIG_DFL)


@contextmanager
def delayed_signals(notice: str = "") -> Iterator[Callable[[], bool]]:
    """Let a first Ctrl-C or SIGTERM wait until this is left; a second one does not wait.

    Signals that somebody else handles, or that are ignored, stay as they are, and so do all outside
    the main thread, where Python hears none.

    Args:
        notice: Written to standard error when the first one comes.

    Yields:
        Tells whether one waits: leave soon then.
    """
    came: list[int] = []
    before: dict[int, object] = {}

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]

    def note(number: int, _: FrameType | None) -> None:
        came.append(number)
        restore()
        if notice:
            os.write(2, f"\n{notice}\n".encode())

    if threading.current_thread() is threading.main_thread():
        for number in STOP_SIGNALS:
            if signal.getsignal(number) in DEFAULT_HANDLERS:
                before[number] = signal.signal(number, note)
    try:
        yield lambda: bool(came)
    finally:
        restore()
    if came:
        signal.raise_signal(came[0])
        raise SystemExit(128 + came[0])  # the first process of a container survives that
