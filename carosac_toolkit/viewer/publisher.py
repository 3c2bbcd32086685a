"""Draws the latest picture in a thread of its own, at a limited rate; older ones are dropped."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Generic, TypeVar

from carosac_toolkit.number_checks import check_positive

RATE = 40.0  # pictures a second, at most
T = TypeVar("T")


class Publisher(Generic[T]):
    """Takes what it is offered at once and hands the newest to `draw` later.

    The one who offers never waits for the drawing.

    Attributes:
        drawn: How many were drawn.
        dropped: How many were replaced by a newer one before they were drawn.
        error: What `draw` raised; nothing is drawn after it.
    """

    def __init__(self, draw: Callable[[T], None], *, rate: float = RATE) -> None:
        """Start the thread; `rate` [1/s] > 0 is the most that is drawn."""
        check_positive("rate", rate, "1/s")
        self._draw = draw
        self._period = 1.0 / rate
        self._news = threading.Condition()
        self._latest: T | None = None
        self._closed = False
        self._next = 0.0
        self.drawn = 0
        self.dropped = 0
        self.error: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="viewer", daemon=True)
        self._thread.start()

    @property
    def due(self) -> bool:
        """Whether a picture offered now would be drawn without delay; else none need be made."""
        return time.monotonic() >= self._next

    def offer(self, picture: T) -> None:
        """Replace whatever waits to be drawn."""
        with self._news:
            if self._latest is not None:
                self.dropped += 1
            self._latest = picture
            self._news.notify()

    def close(self) -> None:
        """Draw what waits, then end the thread."""
        with self._news:
            self._closed = True
            self._news.notify()
        self._thread.join()

    def _run(self) -> None:
        """Wait for something new, draw it, rest until the next may come."""
        while True:
            with self._news:
                self._news.wait_for(lambda: self._latest is not None or self._closed)
                picture, self._latest = self._latest, None
            if picture is None:
                return
            self._next = time.monotonic() + self._period
            try:
                self._draw(picture)
            except Exception as error:  # shown by whoever asks; the robot goes on
                self.error = error
                return
            self.drawn += 1
            self._rest()

    def _rest(self) -> None:
        """Sleep until the next picture may come."""
        while not self._closed and (left := self._next - time.monotonic()) > 0.0:
            time.sleep(min(left, 0.05))
