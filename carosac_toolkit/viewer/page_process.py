"""Page of a live loop in its own process, as threads of one process share Python's lock.

A thread that draws holds that lock now and then, and if the system takes the processor from it at
that moment, the loop waits. Here the loop only sends numbers through a pipe, and gets targets back.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.live.hand_target import HandTarget
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.viewer.live import Instant, LivePage, drawing
from carosac_toolkit.viewer.page import Page
from carosac_toolkit.viewer.picture import take_picture
from carosac_toolkit.viewer.publisher import PUBLISH_RATE_MAX_HZ, Publisher

PAGE_NICENESS = 10  # by so much the page's process is nicer than the loop's
PROCESS_TIMEOUT_S = 60.0  # [s] for the process to start, and for it to end


@dataclass(frozen=True, kw_only=True, eq=False)
class PageOptions:
    """Settings of the page's process.

    Attributes:
        robot: Robot to show.
        title: Title of the page.
        host: Address to serve at.
        port: To serve at, or the next free one.
        enlarged: Factor on the sag that is drawn.
        rate: Pictures a second, at most.
        plain: True for a page that is cheap to draw.
    """

    robot: Robot
    title: str
    host: str
    port: int
    enlarged: float = 1.0
    rate: float = PUBLISH_RATE_MAX_HZ
    plain: bool = False


class PageProcess:
    """Page that shows instants and returns targets. Close it.

    Attributes:
        url: Address of the page.
        instants: Sends the latest instant, from a thread; closed by `follow`.
        drawn: Pictures that the page has drawn; known after `close`.
    """

    def __init__(self, options: PageOptions, moved: Callable[[Array], object]) -> None:
        """Start the process, and wait until it serves.

        Args:
            options: Settings of the page.
            moved: Told of each new target in W [m], shape (3,).

        Raises:
            CarosacError: It could not serve.
        """
        context = multiprocessing.get_context("spawn")
        self._pipe, there = context.Pipe()
        self._process = context.Process(target=_serve, args=(there, options), daemon=True)
        self._process.start()
        there.close()
        self.drawn = 0
        self._closing = False
        kind, value = self._first_word()
        if kind == "error":
            self._process.join(PROCESS_TIMEOUT_S)
            raise CarosacError(str(value))
        self.url = str(value)
        self.instants: Publisher[Instant] = Publisher(self._send, rate=options.rate)
        self._moved = moved
        self._listener = threading.Thread(target=self._listen, name="page", daemon=True)
        self._listener.start()

    def say(self, text: str) -> None:
        """Show bad news."""
        self._tell(("say", text))

    def close(self) -> None:
        """End the process."""
        self._closing = True
        self.instants.close()
        self._tell(("close", None))
        self._listener.join(PROCESS_TIMEOUT_S)
        self._process.join(PROCESS_TIMEOUT_S)
        if self._process.is_alive():
            self._process.terminate()
            self._process.join()

    def _first_word(self) -> tuple[str, Any]:
        """Return its address, or raise what went wrong."""
        try:
            if self._pipe.poll(PROCESS_TIMEOUT_S):
                kind, value = self._pipe.recv()
                return kind, value
        except EOFError:
            pass
        return "error", "the process of the page did not start"

    def _send(self, instant: Instant) -> None:
        """Hand over an instant; waits where the pipe is full, and newer ones replace it then."""
        self._tell(("instant", instant))

    def _tell(self, message: tuple[str, Any]) -> None:
        """Send a message; a page that has ended gets nothing."""
        try:
            self._pipe.send(message)
        except (BrokenPipeError, OSError):
            return

    def _listen(self) -> None:
        """Take targets until the page ends."""
        try:
            while True:
                kind, value = self._pipe.recv()
                if kind == "target":
                    self._moved(value)
                elif kind == "drawn":
                    self.drawn = int(value)
        except (EOFError, OSError):
            if not self._closing:
                print("carosac: the page has ended; the simulation goes on", file=sys.stderr)


def _serve(pipe: Connection, options: PageOptions) -> None:
    """Run the page's process until it is told to end, or its parent is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the loop, which then ends this
    if hasattr(os, "nice"):
        os.nice(
            PAGE_NICENESS
        )  # where the cores do not suffice for both, pictures are late, not the loop
    try:
        page = Page(
            options.robot, options.title, host=options.host, port=options.port,
            rate=options.rate, followed="reference", plain=options.plain,
        )  # fmt: skip
    except CarosacError as error:
        pipe.send(("error", str(error)))
        return
    page.enlarged.value = options.enlarged
    lock = threading.Lock()

    def moved(place: Array) -> None:
        with lock:
            pipe.send(("target", np.asarray(place)))

    target = HandTarget(
        options.robot, options.robot.home_position, speed_max=1.0, acceleration_max=1.0
    )
    LivePage(page, target, moved)
    robot = options.robot
    page.draw(take_picture(robot, robot.home_position, robot.home_rotation))  # loads the kernels
    instants = drawing(page)
    pipe.send(("url", page.url))
    try:
        _show(pipe, page, instants)
    finally:
        instants.close()
        with lock:
            pipe.send(("drawn", instants.drawn))
        page.close()


def _show(pipe: Connection, page: Page, instants: Publisher[Instant]) -> None:
    """Receive instants as fast as they come; the newest is drawn."""
    try:
        while True:
            kind, value = pipe.recv()
            if kind == "instant":
                instants.offer(value)
            elif kind == "say":
                page.say(value, problem=True)
            else:
                return
    except EOFError:
        return
