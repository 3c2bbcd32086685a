"""Largest files that are read: a few megabytes of a compressed file can hold terabytes.

Limits on robot files are in `carosac_toolkit.base.yaml`, on MATLAB files in
`carosac_toolkit.recordings.mat_process`.
"""

from __future__ import annotations

import csv
import os
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from carosac_toolkit.base.errors import InvalidFile

DECODED_BYTES_MAX = 2**29  # of an npz file or a part of a study
# Of a recording. Of 8 cables at 100 Hz with commands, poses and an IMU at 200 Hz on clocks of their
# own, all three end between 4.5 and 6.5 hours.
VALUES_BYTES_MAX = 3 * 2**28  # of its numbers as float64
CELLS_MAX = 2**29  # of its table, empty ones included
TEXT_BYTES_MAX = 2**31  # as CSV
COLUMNS_MAX = 1000
FOOTER_BYTES_MAX = 2**24  # of a Parquet file: it takes 10 times more in memory
CELL_BYTES = 8
_WAY_OUT = "cut it, or leave channels out"


def check_decoded(path: str | Path, size: int) -> None:
    """Refuse a file that would take too much memory once decoded.

    Args:
        path: The file.
        size: What it says it holds [bytes].

    Raises:
        InvalidFile: It is too large.
    """
    if size > DECODED_BYTES_MAX:
        raise InvalidFile(path, [f"would take {_megabytes(size)}; allowed: {_MEMORY_TEXT}"])


def check_recording(path: str | Path, rows: int, columns: int, cells: int) -> None:
    """Refuse a recording that is too large, in a file or on its way into one.

    Args:
        path: The file.
        rows: Rows of its table.
        columns: Columns of its table.
        cells: Cells that are not empty, as far as they are known.

    Raises:
        InvalidFile: It is too large.
    """
    size = CELL_BYTES * max(cells, rows)  # each row has a time
    for got, allowed, unit in (
        (columns, COLUMNS_MAX, "columns"),
        (size / 1e6, VALUES_BYTES_MAX / 1e6, "MB of numbers"),
        (rows * columns / 1e6, CELLS_MAX / 1e6, "million cells"),
    ):
        if got > allowed:
            fault = f"has {got:.4g} {unit}; allowed: up to {allowed:.4g}: {_WAY_OUT}"
            raise InvalidFile(path, [fault])


def check_text_size(path: str | Path, size: int) -> None:
    """Refuse a text file that is too long.

    Raises:
        InvalidFile: It is too long.
    """
    if size > TEXT_BYTES_MAX:
        got, allowed = size / 1e6, TEXT_BYTES_MAX / 1e6
        fault = f"has {got:.4g} MB of text; allowed: up to {allowed:.4g} MB: {_WAY_OUT}"
        raise InvalidFile(path, [fault])


def csv_cells(path: str | Path, number: int, line: str) -> list[str]:
    """Split a line of a small table of text; without spaces about its cells.

    Raises:
        InvalidFile: A cell is too long, or there are too many.
    """
    try:
        cells = [cell.strip() for cell in next(csv.reader([line]))]
    except csv.Error as error:
        raise InvalidFile(path, [f"line {number}: no CSV: {error}"]) from error
    if len(cells) > COLUMNS_MAX:
        fault = f"line {number}: {len(cells)} cells; allowed: up to {COLUMNS_MAX}"
        raise InvalidFile(path, [fault])
    return cells


def doubles(names: Iterable[str]) -> list[str]:
    """Name the columns that appear more than once, sorted."""
    return sorted(name for name, count in Counter(names).items() if count > 1)


def open_parquet(path: str | Path) -> Any:
    """Open a Parquet file whose list of columns and row groups is not too long.

    Returns:
        A `pyarrow.parquet.ParquetFile`, whose data are not read yet.

    Raises:
        InvalidFile: It would take too much memory.
        pyarrow.ArrowException, OSError: It is no Parquet file.
    """
    import pyarrow.parquet as pq

    with open(path, "rb") as stream:
        stream.seek(-8, os.SEEK_END)
        footer = int.from_bytes(stream.read(4), "little")
    if FOOTER_BYTES_MAX < footer < Path(path).stat().st_size:
        raise InvalidFile(path, ["this is no table: its footer is too long"])
    return pq.ParquetFile(path)


def encoded_size(file: Any) -> int:
    """Return what the pages of an open Parquet file take, decompressed [bytes]."""
    groups = range(file.metadata.num_row_groups)
    return sum(file.metadata.row_group(i).total_byte_size for i in groups)


def read_rows(path: str | Path) -> Any:
    """Read a Parquet file of numbers and texts as a `pyarrow.Table`.

    A text that many rows share stands in the file once, so texts are counted before they are read.

    Raises:
        InvalidFile: It would take too much memory once decoded.
        pyarrow.ArrowException, OSError: It is no Parquet file.
    """
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.parquet as pq

    file = open_parquet(path)
    cells = file.metadata.num_rows * file.metadata.num_columns
    check_decoded(path, max(CELL_BYTES * cells, encoded_size(file)))
    texts = [x.name for x in file.schema_arrow if pa.types.is_string(x.type)]
    others = [x for x in file.schema_arrow if pa.types.is_nested(x.type) or _is_bytes(x.type)]
    if others:
        raise InvalidFile(path, [f"column {others[0].name!r}: got type {others[0].type}"])
    size = 0
    for batch in pq.ParquetFile(path, read_dictionary=texts).iter_batches(columns=texts):
        for column in batch.columns:
            lengths = pc.binary_length(column.dictionary).cast(pa.int64())
            size += pc.sum(lengths.take(column.indices)).as_py() or 0
            check_decoded(path, size)
    return file.read()


def _is_bytes(kind: Any) -> bool:
    """Return whether a column holds bytes or texts of another type than `pyarrow.string`."""
    import pyarrow as pa

    types = pa.types
    return bool(
        types.is_binary(kind) or types.is_large_binary(kind) or types.is_large_string(kind)
        or types.is_fixed_size_binary(kind) or types.is_dictionary(kind)
        or types.is_string_view(kind) or types.is_binary_view(kind)
    )  # fmt: skip


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.0f} MB"


_MEMORY_TEXT = f"up to {_megabytes(DECODED_BYTES_MAX)} in memory"
