"""Reader of keys and lines of the standard input, in a thread of its own."""

from __future__ import annotations

import contextlib
import os
import re
import select
import sys
import threading
from codecs import getincrementaldecoder
from collections.abc import Callable, Iterator

from carosac_toolkit.base.errors import InvalidField

_KEY_PATTERN = re.compile(r"\x1b\[[0-9;]*[A-Za-z~]|\x1bO[A-Za-z]")  # as a terminal sends it
_PARTIAL_KEY_PATTERN = re.compile(r"\x1b(\[[0-9;]*|O)?")
_NUMBER_CHARACTERS = "0123456789+-."
_SEPARATORS = " ,\teE"  # in a line of numbers


def check_input(option: str) -> None:
    """Refuse to listen where there is no standard input.

    Raises:
        InvalidField: There is none; it names the option that wants it.
    """
    try:
        sys.stdin.fileno()
    except (AttributeError, OSError, ValueError) as error:
        allowed = "a standard input: a terminal, a pipe or a file"
        raise InvalidField(option, "none", allowed) from error


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
        with contextlib.suppress(termios.error):  # where the terminal is gone
            termios.tcsetattr(descriptor, termios.TCSANOW, before)


def _read(
    descriptor: int, done: int, terminal: bool, heard: Callable[[str], None],
    ended: Callable[[], None],
) -> None:  # fmt: skip
    """Read until the end of the input, or until told."""
    words = Words(keys=terminal)
    decoder = getincrementaldecoder("utf-8")("replace")
    while done not in select.select([descriptor, done], [], [])[0]:
        try:
            data = os.read(descriptor, 256)
        except OSError:  # the terminal is gone
            data = b""
        for word in words.feed(decoder.decode(data)) if data else words.rest():
            heard(word)
        if not data:
            ended()
            return


class Words:
    """Splitter of input, in pieces of any size, into lines and, on a terminal, keys."""

    def __init__(self, *, keys: bool) -> None:
        """Start empty; `keys`: each key is a word, but for those of a line of numbers."""
        self._keys = keys
        self._text = ""
        self._line = ""

    def feed(self, text: str) -> list[str]:
        """Take input; return the words that are whole now."""
        self._text += text
        if not self._keys:
            *lines, self._text = self._text.split("\n")
            return lines
        words: list[str] = []
        while self._text:
            key = _KEY_PATTERN.match(self._text)
            if key is None and _PARTIAL_KEY_PATTERN.fullmatch(self._text):
                break  # the rest of an escape sequence is still to come
            word = self._text[0] if key is None else key.group()
            self._text = self._text[len(word) :]
            words += self._take(word)
        return words

    def rest(self) -> list[str]:
        """Return the last line, where it has no end."""
        left = self._line if self._keys else self._text
        self._line = self._text = ""
        return [left] if left.strip() else []

    def _take(self, word: str) -> list[str]:
        """Take one key; return the words that it completes."""
        if word in "\r\n":
            return self._ended_line()
        if word in "\b\x7f":
            self._line = self._line[:-1]
            return []
        if word in _NUMBER_CHARACTERS or (self._line and word in _SEPARATORS):
            self._line += word
            return []
        self._line = ""  # a key gives a half line up
        return [] if word == "\x1b" else [word.replace("\x1bO", "\x1b[")]

    def _ended_line(self) -> list[str]:
        """Return the line of numbers that Enter has ended."""
        line, self._line = self._line, ""
        return [line] if line.strip() else []
