"""Tables of text that keep to a width by breaking into blocks of columns."""

from __future__ import annotations

import shutil
import textwrap

Rows = list[tuple[str, ...]]
NAME_SHOWN = 28  # characters of a name


def terminal_width() -> int:
    """Columns that text may take."""
    return max(80, shutil.get_terminal_size().columns)


def wrapped(text: str, width: int, start: str = "") -> str:
    """Break a sentence into lines, with a mark in front; paths and names stay whole."""
    return textwrap.fill(
        text, width, initial_indent=start, subsequent_indent=" " * len(start),
        break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip


def counted(count: int, noun: str, plural: str | None = None) -> str:
    """A number of things in words: 1 case, 2 cases."""
    return f"{count} {noun if count == 1 else plural or noun + 's'}"


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
        if (
            blocks
            and sum(widths[i] + 2 for i in [*range(left), *blocks[-1], *columns]) - 2 <= width
        ):
            blocks[-1] += columns
        else:
            blocks.append(columns)
    return "\n\n".join(
        _align([[line[i] for i in [*range(left), *block]] for line in [header, *rows]], left)
        for block in blocks
    )


def _align(lines: list[list[str]], left: int) -> str:
    """Lay out a block, its title first: the first columns to the left, the rest to the right."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    lines = [lines[0], ["-" * width for width in widths], *lines[1:]]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if i < left else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )


def _cut(name: str, shown: int) -> str:
    return name if len(name) <= shown else f"...{name[3 - shown :]}"
