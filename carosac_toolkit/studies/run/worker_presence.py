"""Watch over the scheduler and the workers of a study."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from carosac_toolkit.base.errors import CarosacError

LOST_AFTER_S = 30.0  # [s] without a connection to the scheduler
CLUSTER_PATIENCE_S = 120.0  # [s] without workers, or without an answer of the scheduler
NOTICE_AFTER_S = 10.0  # [s] of that before it is said
QUERY_INTERVAL_S = 2.0  # [s] between two questions to the scheduler
ANSWER_TIMEOUT_S = 10.0  # [s] an answer is waited for


class LostScheduler(CarosacError):
    """Error of a scheduler that is gone, has no workers, or has none that can do the work."""


class Presence:
    """Watch over the scheduler and its workers while a study waits for them.

    A scheduler keeps tasks for workers that may come one day, so a wait for its results has no end
    of its own.

    Args:
        client: Client of the scheduler.
        say: Tells the user a line.
    """

    def __init__(self, client: Any, say: Callable[[str], None]) -> None:
        self._client = client
        self._say = say
        self._name = f"the scheduler at {client.scheduler.address}"
        self._told = False
        self._connected = self._asked = self._present = time.monotonic()

    def confirm(self) -> None:
        """Note that work has been done."""
        self._connected = self._asked = self._present = time.monotonic()

    def check(self) -> None:
        """Check for scheduler and workers; call it repeatedly while nothing comes.

        Raises:
            LostScheduler: Nobody has been there for too long.
        """
        now = time.monotonic()
        if self._client.status != "running":
            if now - self._connected > LOST_AFTER_S:
                raise LostScheduler(f"the connection to {self._name} is lost; run again to go on")
            return
        self._connected = now
        if now - self._asked < QUERY_INTERVAL_S:
            return
        absence = self._absence()
        self._asked = time.monotonic()
        if absence:
            self._wait(absence, self._asked - self._present)
            return
        if self._told:
            self._say(f"study: {self._name} is there again, with workers")
        self._told = False
        self._present = self._asked

    def _absence(self) -> str:
        """Describe what is wrong; empty if the scheduler has workers."""
        try:
            workers = self._client.nthreads(callback_timeout=ANSWER_TIMEOUT_S)
        except (OSError, TimeoutError):
            return "has not answered"
        return "" if workers else "has had no workers"

    def _wait(self, absence: str, duration: float) -> None:
        """Wait patiently, say so, and give up in the end."""
        if duration > CLUSTER_PATIENCE_S:
            raise LostScheduler(
                f"{self._name} {absence} for {duration:.0f} s; what is finished is kept: "
                "run again to go on"
            )
        if duration > NOTICE_AFTER_S and not self._told:
            self._told = True
            self._say(
                f"study: {self._name} {absence} for {duration:.0f} s; "
                f"the study ends if that lasts {CLUSTER_PATIENCE_S:g} s"
            )
