"""Steering of a run by keys and lines of the standard input."""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Iterator

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.live.hand_target import HandTarget
from carosac_toolkit.live.keyboard import listening
from carosac_toolkit.live.messages import say
from carosac_toolkit.loop.loop import Path
from carosac_toolkit.safety.guard import GuardedDriver

POLL_INTERVAL_S = 0.05  # after the end of the input, until the target is reached


@contextlib.contextmanager
def steered(path: Path, guard: GuardedDriver) -> Iterator[None]:
    """Follow what is typed until the block ends, where the path is a hand target.

    Where the input ends the run goes on to the target, and ends.
    """
    if not isinstance(path, HandTarget):
        yield
        return
    over = threading.Event()

    def heard(word: str) -> None:
        try:
            path.obey(word)
        except InvalidField as error:
            say(f"carosac: {error}", sys.stderr)
            return
        if path.over:
            guard.end("the end was asked for")
        else:
            say(f"target {place(path.target)}", sys.stderr)

    def ended() -> None:
        while not (path.arrived or guard.ending or guard.fault or over.wait(POLL_INTERVAL_S)):
            pass
        guard.end("the input has ended")

    with listening(heard, ended):
        try:
            yield
        finally:
            over.set()


def place(position: Array) -> str:
    """Return a position [m], shape (3,), as text."""
    return " ".join(f"{x:.3f}" for x in position) + " m"
