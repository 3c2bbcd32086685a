"""Thread that draws the latest picture at a limited rate; older ones are dropped."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Generic, TypeVar

from carosac_toolkit.base.numbers import check_positive

PUBLISH_RATE_MAX_HZ = 35.0  # pictures a second, at most
QUIET_INTERVAL_S = 0.25  # [s] without news, after which what was put off is drawn
T = TypeVar("T")


class Publisher(Generic[T]):
    """Queue of one picture, handed to `draw` in a thread of its own.

    The one who offers never waits for the drawing.

    Attributes:
        drawn: Number of pictures drawn.
        dropped: Number of pictures replaced by a newer one before they were drawn.
        error: Exception raised by `draw`; nothing is drawn after it.
    """

    def __init__(
        self, draw: Callable[[T], None], *, rate: float = PUBLISH_RATE_MAX_HZ,
        settle: Callable[[], None] | None = None,
    ) -> None:  # fmt: skip
        """Start the thread.

        Args:
            draw: Draws one.
            rate: The most that are drawn [1/s], > 0.
            settle: Called once where no news have come for a while after a drawing.
        """
        check_positive("rate", rate, "1/s")
        self._draw, self._settle = draw, settle
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
        """Return whether a picture offered now would be drawn without delay."""
        return time.monotonic() >= self._next

    def offer(self, picture: T) -> None:
        """Replace the picture that waits to be drawn."""
        with self._news:
            if self._latest is not None:
                self.dropped += 1
            self._latest = picture
            self._news.notify()

    def close(self) -> None:
        """Draw the waiting picture, then end the thread."""
        with self._news:
            self._closed = True
            self._news.notify()
        self._thread.join()

    def _run(self) -> None:
        """Wait for a picture, draw it, pause until the next may come."""
        settled = True
        while True:
            with self._news:
                heard = self._news.wait_for(self._has_news, None if settled else QUIET_INTERVAL_S)
                picture, self._latest = self._latest, None
                over = self._closed
            if picture is None and heard and over:
                return
            settled = picture is None
            self._next = time.monotonic() + self._period
            try:
                if picture is not None:
                    self._draw(picture)
                elif self._settle is not None:
                    self._settle()
            except Exception as error:
                self.error = error
                raise  # the hook of threads prints it; the robot goes on
            self.drawn += picture is not None
            self._rest()

    def _has_news(self) -> bool:
        """Return whether there is something to draw, or nothing will come."""
        return self._latest is not None or self._closed

    def _rest(self) -> None:
        """Sleep until the next picture may come."""
        while not self._closed and (left := self._next - time.monotonic()) > 0.0:
            time.sleep(min(left, 0.05))
