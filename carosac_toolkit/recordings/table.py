"""A table of named columns, as it comes out of a file or goes into one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array

FAULTS_SHOWN = 20


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """Columns of equal length with their empty cells.

    Attributes:
        columns: Values by column name, each of shape (rows,); anything where a cell is empty.
        empty: Which cells are empty, by column name, each of shape (rows,).
        lines: Line of the file that each row stands on, or None for a file without lines.
        written: How the file spells each column, where names are canonical.
    """

    columns: Mapping[str, Array]
    empty: Mapping[str, NDArray[np.bool_]]
    lines: Sequence[int] | None = None
    written: Mapping[str, str] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(next(iter(self.columns.values()), ()))

    def row_name(self, row: int) -> str:
        """Name a row in messages, counted from 1."""
        return f"row {row + 1}" + (f" (line {self.lines[row]})" if self.lines else "")


def shortened(faults: list[str]) -> list[str]:
    """Keep the first faults and say how many more there are."""
    more = len(faults) - FAULTS_SHOWN
    return [*faults[:FAULTS_SHOWN], f"and {more} more"] if more > 0 else faults
