"""What all commands share: their common options, results and tables.

A command is a module named in the entry-point group ``carosac.commands``. The first line of its
docstring is its summary; it has a frozen dataclass ``Options`` that derives from `CommonOptions`
(the docstring of each field is its help), and ``run(options) -> CommandResult``.

A field of type `Path`, best as `OutputFile` or `OutputFolder`, is an output and is checked before
``run``; what a command reads is text, as it may be a name or a path.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from carosac_toolkit.base.errors import InvalidField

RATE_MAX = 1000.0  # [Hz]
OutputFile = Annotated[Path | None, tyro.conf.arg(metavar="FILE")]
OutputFolder = Annotated[Path | None, tyro.conf.arg(metavar="DIR")]


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


def period_of_rate(rate: float) -> float:
    """Time between two commands as --rate has it [s].

    Raises:
        InvalidField: A rate [Hz] that is none, or above that of any industrial PLC.
    """
    if not 0.0 < rate <= RATE_MAX:
        raise InvalidField("--rate", f"{rate} Hz", f"over 0 to {RATE_MAX:g} Hz")
    return 1.0 / rate


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
