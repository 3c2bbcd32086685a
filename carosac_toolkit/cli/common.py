"""What all commands share: their common options, results, JSON, tables and safe file writing.

A command is a module named in the entry-point group ``carosac.commands``. The first line of its
docstring is its summary; it has a frozen dataclass ``Options`` that derives from `CommonOptions`
(the docstring of each field is its help), and ``run(options) -> CommandResult``.
"""

from __future__ import annotations

import json
import math
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from carosac_toolkit.errors import InvalidField

OutputFile = Annotated[Path | None, tyro.conf.arg(metavar="FILE")]


@dataclass(frozen=True, kw_only=True)
class CommonOptions:
    """Options that every command has."""

    json: OutputFile = None
    """Write the numbers that the command prints to this file as well."""
    seed: int = 0
    """Seed of everything random; the same seed gives the same numbers."""


@dataclass(frozen=True)
class CommandResult:
    """What a command found.

    Attributes:
        data: The numbers it printed; what ``--json`` writes. numpy values are welcome.
        status: Exit status: 0 fine, 1 it ran but the answer is negative.
    """

    data: dict[str, Any] = field(default_factory=dict)
    status: int = 0


def check_writable(option: str, path: Path | None, suffixes: Sequence[str] = ()) -> None:
    """Refuse an output file that cannot be written, before any work is done.

    Raises:
        InvalidField: The folder does not exist or is read-only, the path is a folder, or its
            suffix is not one of `suffixes`.
    """
    if path is None:
        return
    if not path.parent.is_dir():
        raise InvalidField(option, f"'{path}'", f"a file in an existing folder; no {path.parent}/")
    if path.is_dir():
        raise InvalidField(option, f"'{path}'", "a file, not a folder")
    if not os.access(path.parent, os.W_OK):
        raise InvalidField(option, f"'{path}'", "a file in a folder that can be written")
    if suffixes and path.suffix.lower() not in suffixes:
        raise InvalidField(option, f"'{path}'", f"a file name ending in {' or '.join(suffixes)}")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path` that takes its place only if all goes well.

    Yields:
        The temporary path, with the suffix of `path`, to be written in the block.
    """
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write numbers as JSON, atomically; a number that is not finite becomes null."""
    text = json.dumps(_plain(data), indent=2, allow_nan=False, ensure_ascii=False)
    with replacing(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def _plain(value: Any) -> Any:
    """Turn numpy values, tuples and paths into what JSON knows."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


def format_table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Lay out rows in columns; columns of numbers are aligned to the right.

    Args:
        header: Column titles, with units.
        rows: Cells; a float is printed with five significant digits.

    Returns:
        The table as text without a final newline.
    """
    cells = [[_cell(value) for value in row] for row in rows]
    right = [
        bool(rows) and all(isinstance(row[i], int | float) for row in rows)
        for i in range(len(header))
    ]
    widths = [max(len(line[i]) for line in [list(header), *cells]) for i in range(len(header))]
    lines = [list(header), ["-" * width for width in widths], *cells]
    return "\n".join(
        "  ".join(
            cell.rjust(width) if to_right else cell.ljust(width)
            for cell, width, to_right in zip(line, widths, right, strict=True)
        ).rstrip()
        for line in lines
    )


def _cell(value: object) -> str:
    """Print one cell."""
    return f"{value:.5g}" if isinstance(value, float) else str(value)
