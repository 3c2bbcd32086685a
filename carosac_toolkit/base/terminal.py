r"""Text for a terminal: control characters in names and messages are shown, not obeyed.

A name from a file such as ``\x1b]0;owned\x07`` would otherwise change what the terminal shows or
does.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TextIO, cast

CLEAR_LINE = "\r\x1b[K"
_DIRECTION_MARKS = (*range(0x202A, 0x202F), *range(0x2066, 0x206A))  # reorder the text around them
_CONTROL = (*range(0x20), *range(0x7F, 0xA0), 0x2028, 0x2029, *_DIRECTION_MARKS)
_SHOWN = {code: f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" for code in _CONTROL}
_PRINTED = {code: text for code, text in _SHOWN.items() if chr(code) not in "\n\t"}


class TerminalText(str):
    """Text whose control characters are ours, such as those that rewrite a line."""


def printable(text: str) -> str:
    r"""Return text with each control character but newline and tab shown, as ``\x1b``."""
    return text.translate(_PRINTED)


def has_control_characters(text: str) -> bool:
    """Return whether text holds a control character, newline and tab included."""
    return text.translate(_SHOWN) != text


class _PlainStream:
    """Stream that shows control characters."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write text; return how many characters were given."""
        self._stream.write(text if isinstance(text, TerminalText) else printable(text))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write several texts."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def plain_stream(stream: TextIO) -> TextIO:
    """Return a stream that shows control characters, apart from those of `TerminalText`."""
    return cast(TextIO, _PlainStream(stream))


@contextmanager
def plain_output() -> Iterator[None]:
    """Show control characters on standard output and error for as long as the block lasts."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (plain_stream(stream) for stream in before)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before
