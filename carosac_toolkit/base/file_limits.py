"""Largest files that are read: a few megabytes of a compressed file can hold terabytes.

Limits on robot files are in `carosac_toolkit.base.yaml`, on MATLAB files in
`carosac_toolkit.recordings.mat_process`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from carosac_toolkit.base.errors import InvalidFile

DECODED_BYTES_MAX = 2**29  # of a Parquet or npz file: 50 columns at 100 Hz for 3.7 hours
TEXT_BYTES_MAX = 2**28  # of a CSV file, whose cells take 10 times more as objects
CELL_BYTES = 8


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


def check_text_size(path: Path) -> None:
    """Refuse a text file that would take too much memory.

    Raises:
        InvalidFile: It is too large.
        OSError: There is no such file.
    """
    size = path.stat().st_size
    if size > TEXT_BYTES_MAX:
        allowed = f"text files up to {_megabytes(TEXT_BYTES_MAX)}, or shorter recordings"
        raise InvalidFile(path, [f"has {_megabytes(size)}; allowed: {allowed}"])


def open_parquet(path: str | Path) -> Any:
    """Open a Parquet file, after a look at the sizes in its metadata.

    Returns:
        A `pyarrow.parquet.ParquetFile`, whose data are not read yet.

    Raises:
        InvalidFile: It would take too much memory once decoded.
        pyarrow.ArrowException, OSError: It is no Parquet file.
    """
    import pyarrow.parquet as pq

    file = pq.ParquetFile(path)
    groups = [file.metadata.row_group(i) for i in range(file.metadata.num_row_groups)]
    cells = sum(group.num_rows * group.num_columns for group in groups)
    check_decoded(path, max(CELL_BYTES * cells, sum(group.total_byte_size for group in groups)))
    return file


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.0f} MB"


_MEMORY_TEXT = f"up to {_megabytes(DECODED_BYTES_MAX)} in memory"
