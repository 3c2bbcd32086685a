"""Cells of a CSV file as numbers, some lines at once."""

from __future__ import annotations

import csv
from array import array
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidFile
from carosac_toolkit.base.file_limits import check_recording
from carosac_toolkit.recordings.table import FAULTS_SHOWN, Column, Table, shortened


class CellParser:
    """Columns that grow by blocks of lines; empty cells take a bit each."""

    def __init__(self, names: list[str], path: Path) -> None:
        """Begin without rows."""
        self._names = names
        self._path = path
        self._values: dict[str, list[Array]] = {name: [] for name in names}
        self._masks: dict[str, list[NDArray[np.uint8]]] = {name: [] for name in names}
        self._rows: list[int] = []  # of each block
        self._cells = 0

    def table(self, blocks: Iterable[tuple[list[str], list[int]]]) -> Table:
        """Parse blocks of lines with their numbers.

        Raises:
            InvalidFile: Cells that are no numbers, or too many.
        """
        numbers = array("q")
        faults: list[str] = []
        for lines, of_lines in blocks:
            numbers.extend(of_lines)
            columns = self._parsed(lines)
            if columns is None:
                columns, more = self._checked(lines, of_lines)
                faults += more
            if len(faults) > FAULTS_SHOWN:
                break
            if not faults:
                self._append(columns, len(lines))
        if faults:
            raise InvalidFile(self._path, shortened(faults))
        return Table(names=self._names, rows=len(numbers), take=self._take, lines=numbers)

    def _append(self, columns: list[Column], rows: int) -> None:
        """Keep the cells that are not empty."""
        self._rows.append(rows)
        self._cells += sum(len(values) for values, _ in columns)
        check_recording(self._path, sum(self._rows), len(self._names), self._cells)
        for name, (values, filled) in zip(self._names, columns, strict=True):
            self._values[name].append(values)
            self._masks[name].append(np.packbits(filled))

    def _take(self, name: str) -> Column:
        """Return a column and forget it."""
        masks = [
            np.unpackbits(bits, count=rows).astype(np.bool_)
            for bits, rows in zip(self._masks.pop(name), self._rows, strict=True)
        ]
        none = [np.zeros(0)]
        filled = np.concatenate(masks) if masks else np.zeros(0, dtype=np.bool_)
        return np.concatenate(self._values.pop(name) or none), filled

    def _parsed(self, lines: list[str]) -> list[Column] | None:
        """Return the columns; None where a cell is nothing that Arrow takes for a number."""
        import pyarrow as pa
        import pyarrow.csv

        text = "".join(lines).encode()
        keys = [str(j) for j in range(len(self._names))]
        types = dict.fromkeys(keys, pa.float64())
        try:
            table = pyarrow.csv.read_csv(
                pa.BufferReader(text),
                read_options=pyarrow.csv.ReadOptions(
                    column_names=keys, use_threads=False, block_size=len(text) + 1
                ),
                parse_options=pyarrow.csv.ParseOptions(quote_char=False),
                convert_options=pyarrow.csv.ConvertOptions(column_types=types, null_values=[""]),
            )
        except pa.ArrowException:
            return None
        if table.num_rows != len(lines):
            return None
        return [
            (
                column.drop_null().to_numpy(),
                column.is_valid().to_numpy(),
            )
            for column in table.columns
        ]

    def _checked(self, lines: list[str], numbers: list[int]) -> tuple[list[Column], list[str]]:
        """Return the columns as Python reads them, and the faults of lines and cells."""
        try:
            rows = [next(csv.reader([line])) for line in lines]
        except csv.Error as error:
            raise InvalidFile(self._path, [f"not a CSV file: {error}"]) from error
        faults = [
            f"line {number}: {len(row)} cells; allowed: {len(self._names)}, as the header has"
            for row, number in zip(rows, numbers, strict=True)
            if len(row) != len(self._names)
        ]
        if faults:
            return [], faults
        values = np.zeros((len(rows), len(self._names)))
        filled = np.ones(values.shape, dtype=np.bool_)
        for i, row in enumerate(rows):
            for j, cell in enumerate(row):
                if not cell.strip():
                    filled[i, j] = False
                    continue
                try:
                    values[i, j] = float(cell.replace("_", "no digit"))  # Python takes 1_0 for 10
                except ValueError:
                    where = f"line {numbers[i]}, column {self._names[j]!r}"
                    faults.append(f"{where}: got {cell!r}; allowed: a number")
        return [(values[filled[:, j], j], filled[:, j]) for j in range(len(self._names))], faults
