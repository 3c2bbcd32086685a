"""Tables of text, the same in a terminal, a pipe and a file; wide ones break into blocks.

Numbers are never cut or wrapped to make a table fit, as rich would do in a pipe.
"""

from __future__ import annotations

import re
import shutil
import textwrap
from collections.abc import Sequence

from carosac_toolkit.base.numbers import plain

Rows = list[tuple[str, ...]]
NO_BREAK_SPACE = "\u00a0"
_UNIT_GAP_PATTERN = re.compile(
    r"(?<=\d) (?=(?:%|[mck]?m|m?s|min|[mk]?N|k?g|t|k?Hz|deg|m?rad)(?:[^A-Za-z0-9]|$))"
)
NAME_SHOWN = 28  # characters of a name


def terminal_width() -> int:
    """Return the number of columns that text may take."""
    return max(80, shutil.get_terminal_size().columns)


def wrapped(text: str, width: int, start: str = "") -> str:
    """Break a sentence into lines, with a mark in front.

    Paths and names stay whole, and a number stays with its unit.
    """
    lines = textwrap.fill(
        _UNIT_GAP_PATTERN.sub(NO_BREAK_SPACE, text), width, initial_indent=start,
        subsequent_indent=" " * len(start), break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip
    return lines.replace(NO_BREAK_SPACE, " ")


def counted(count: int, noun: str, plural: str | None = None) -> str:
    """Return a number of things in words: 1 case, 2 cases."""
    return f"{count} {noun if count == 1 else plural or noun + 's'}"


def format_table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Lay out rows in columns; columns of numbers are aligned to the right.

    Args:
        header: Column titles, with units.
        rows: Cells; a float is printed with five significant digits.

    Returns:
        The table as text without a final newline.
    """
    right = [
        bool(rows) and all(isinstance(row[i], int | float) for row in rows)
        for i in range(len(header))
    ]
    return _align([header, *([_cell(value) for value in row] for row in rows)], right)


def fit(
    header: tuple[str, ...],
    rows: Rows,
    groups: tuple[int, ...],
    width: int,
    *,
    shown: int = NAME_SHOWN,
) -> str:
    """Lay out a table in as many blocks as it takes to stay within a width.

    Args:
        header: Column titles.
        rows: Cells; those of the first group are cut at their front where they are long.
        groups: How many columns stay together; those of the first group hold text, stand on the
            left and are repeated in every block.
        width: In characters; a group that is wider stands alone.
        shown: Characters kept of a cell of the first group.
    """
    rows = [(*(_cut(c, shown) for c in row[: groups[0]]), *row[groups[0] :]) for row in rows]
    widths = [max(len(line[i]) for line in [header, *rows]) for i in range(len(header))]
    left, start = groups[0], groups[0]
    blocks: list[list[int]] = []
    for count in groups[1:]:
        columns = list(range(start, start + count))
        start += count
        if blocks and sum(widths[i] + 2 for i in [*blocks[-1], *columns]) - 2 <= width:
            blocks[-1] += columns
        else:
            blocks.append([*range(left), *columns])
    return "\n\n".join(
        _align([[line[i] for i in block] for line in [header, *rows]], [i >= left for i in block])
        for block in blocks
    )


def aligned(titles: Sequence[str], rows: Sequence[Sequence[str]], left: int) -> str:
    """Lay out a table of any width; the first `left` columns hold text, the others numbers."""
    return _align([titles, *rows], [i >= left for i in range(len(titles))])


def _align(lines: Sequence[Sequence[str]], right: Sequence[bool]) -> str:
    """Lay out lines, the titles first, with each column to the right or to the left."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join(
            cell.rjust(width) if to_right else cell.ljust(width)
            for cell, width, to_right in zip(line, widths, right, strict=True)
        ).rstrip()
        for line in (lines[0], ["-" * width for width in widths], *lines[1:])
    )


def _cell(value: object) -> str:
    """Print one cell."""
    return plain(value, 5) if isinstance(value, float) else str(value)


def _cut(name: str, shown: int) -> str:
    """Cut a long name at its front."""
    return name if len(name) <= shown else f"...{name[3 - shown :]}"
