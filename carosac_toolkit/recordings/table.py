"""A table of named columns, as it comes out of a file or goes into one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidFile

Mask = NDArray[np.bool_]
Column = tuple[Array, Mask]  # values of the cells that are not empty; which those are
FAULTS_SHOWN = 20


class Faults:
    """Faults of a file: the first ones as text, and how many there are."""

    def __init__(self) -> None:
        self._texts: list[str] = []
        self._count = 0

    def __bool__(self) -> bool:
        """Return whether there are any."""
        return self._count > 0

    def add(self, texts: Iterable[str], count: int | None = None) -> None:
        """Add faults.

        Args:
            texts: The first `FAULTS_SHOWN` of them, or all.
            count: How many there are; None: these.
        """
        texts = list(texts)
        self._texts += texts[:FAULTS_SHOWN]
        self._count += len(texts) if count is None else count

    def check(self, path: Path) -> None:
        """Refuse the file if there are any.

        Raises:
            InvalidFile: With the first ones.
        """
        if self._count:
            raise InvalidFile(path, shortened(self._texts, self._count))


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """Columns of equal length, each taken once, so that a long table is not in memory twice.

    Attributes:
        names: Names of the columns, as in the file.
        rows: Number of rows.
        take: Returns, for a column, the values of the cells that are not empty, shape (K,), and
            which those are, shape (rows,).
        lines: Line of the file that each row stands on, or None for a file without lines.
    """

    names: Sequence[str]
    rows: int
    take: Callable[[str], Column]
    lines: Sequence[int] | None = None

    def row_name(self, row: int) -> str:
        """Name a row in messages, counted from 1."""
        return f"row {row + 1}" + (f" (line {self.lines[row]})" if self.lines is not None else "")


def shortened(faults: list[str], count: int | None = None) -> list[str]:
    """Keep the first faults and say how many more there are, of `count` or of these."""
    more = (len(faults) if count is None else count) - FAULTS_SHOWN
    return [*faults[:FAULTS_SHOWN], f"and {more} more"] if more > 0 else faults
