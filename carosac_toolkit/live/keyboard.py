"""Keys and lines of the standard input, read in a thread of their own."""

from __future__ import annotations

import contextlib
import os
import select
import sys
import threading
from collections.abc import Callable, Iterator


@contextlib.contextmanager
def listening(heard: Callable[[str], None], ended: Callable[[], None]) -> Iterator[None]:
    """Hand every line, and on a terminal every key, to `heard` until the block ends.

    Args:
        heard: Called with a key (its escape sequence, or a letter) or with a line.
        ended: Called where the input has come to its end.
    """
    descriptor = sys.stdin.fileno()
    done_read, done_write = os.pipe()
    with contextlib.ExitStack() as stack:
        stack.callback(os.close, done_read)
        stack.callback(os.close, done_write)
        terminal = os.isatty(descriptor)
        if terminal:
            stack.enter_context(_single_keys(descriptor))
        reader = threading.Thread(
            target=_read, args=(descriptor, done_read, terminal, heard, ended), name="keyboard",
            daemon=True,
        )  # fmt: skip
        reader.start()
        try:
            yield
        finally:
            os.write(done_write, b".")
            reader.join()


@contextlib.contextmanager
def _single_keys(descriptor: int) -> Iterator[None]:
    """Have a terminal hand over keys at once, and put it back afterwards."""
    import termios
    import tty

    before = termios.tcgetattr(descriptor)
    tty.setcbreak(descriptor)
    try:
        yield
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


def _read(
    descriptor: int, done: int, terminal: bool, heard: Callable[[str], None],
    ended: Callable[[], None],
) -> None:  # fmt: skip
    """Read until the end of the input, or until told."""
    text = ""
    while done not in select.select([descriptor, done], [], [])[0]:
        data = os.read(descriptor, 256)
        if not data:
            ended()
            return
        text += data.decode(errors="replace")
        for word in _words(text, terminal):
            heard(word)
        text = _left(text, terminal)


def _words(text: str, terminal: bool) -> list[str]:
    """Whole lines; on a terminal also single keys, but not the digits of a line not yet ended."""
    if not terminal:
        return text.split("\n")[:-1]
    if text.startswith("\x1b"):
        return [text]
    if text[0] in "0123456789-+.":
        return text.split("\n")[:-1]
    return list(text.replace("\n", ""))


def _left(text: str, terminal: bool) -> str:
    """What has not been handed over."""
    if terminal and text[0] not in "0123456789-+.":
        return ""
    return text.rpartition("\n")[2]
