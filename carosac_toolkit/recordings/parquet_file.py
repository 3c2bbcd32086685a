"""Parquet: the table, with its document in the schema's metadata."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from carosac_toolkit.base.errors import InvalidFile
from carosac_toolkit.base.file_limits import (
    CELL_BYTES,
    check_recording,
    doubles,
    encoded_size,
    open_parquet,
)
from carosac_toolkit.recordings.conversion import (
    BLOCK_ROWS,
    from_table,
    row_times,
    to_blocks,
    to_document,
)
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.recordings.table import Column, Table, shortened

METADATA_KEY = b"carosac"


def write_parquet(recording: Recording, path: Path) -> None:
    """Write a recording; empty cells are null."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    time = row_times(recording)
    document = json.dumps(to_document(recording, len(time))).encode()
    writer = None
    for block in to_blocks(recording, time):
        arrays = [pa.array(x, type=pa.float64(), mask=empty) for x, empty in block.values()]
        if writer is None:
            fields = [(name, pa.float64()) for name in block]
            schema = pa.schema(fields, metadata={METADATA_KEY: document})
            writer = pq.ParquetWriter(path, schema)
        writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
    assert writer is not None  # a recording has a sample
    writer.close()


def read_parquet(path: Path) -> Recording:
    """Read a Parquet recording, column by column.

    Raises:
        InvalidFile: With all faults that were found.
    """
    import pyarrow as pa

    try:
        file = open_parquet(path)
        names = file.schema_arrow.names
        metadata = file.metadata
        check_recording(path, metadata.num_rows, len(names), encoded_size(file) // (2 * CELL_BYTES))
        _check_columns(file.schema_arrow, path)
        document = _document((file.schema_arrow.metadata or {}).get(METADATA_KEY), path)
        take = _Columns(file, path).take
        return from_table(Table(names=names, rows=metadata.num_rows, take=take), document, path)
    except (pa.ArrowException, OSError, ValueError) as error:  # ValueError: a name is not UTF-8
        fault = f"this is no whole Parquet file: {str(error).splitlines()[0]}"
        raise InvalidFile(path, [fault]) from error


class _Columns:
    """Columns of an open file."""

    def __init__(self, file: Any, path: Path) -> None:
        self._file = file
        self._path = path

    def take(self, name: str) -> Column:
        """Read a column; a `carosac_toolkit.recordings.table.Table.take`."""
        import pyarrow as pa

        values, filled = [], []
        for batch in self._file.iter_batches(batch_size=BLOCK_ROWS, columns=[name]):
            column = batch.column(0)
            present = column.drop_null()
            try:
                values.append(present.cast(pa.float64()).to_numpy(zero_copy_only=False))
            except pa.ArrowException as error:
                fault = f"column {name!r}: {str(error).splitlines()[0]}"
                raise InvalidFile(self._path, [fault]) from error
            filled.append(column.is_valid().to_numpy(zero_copy_only=False))
        return np.concatenate(values), np.concatenate(filled)


def _check_columns(schema: Any, path: Path) -> None:
    """Refuse columns that hold no numbers or appear twice, before they are decoded."""
    import pyarrow as pa

    faults = [
        f"column {field.name!r}: got type {field.type}; allowed: numbers"
        for field in schema
        if not (pa.types.is_floating(field.type) or pa.types.is_integer(field.type))
    ]
    faults += [f"column {name!r} appears twice" for name in doubles(schema.names)]
    if faults:
        raise InvalidFile(path, shortened(faults))


def _document(text: bytes | None, path: Path) -> dict[str, Any] | None:
    """Return the JSON document of the schema's metadata; None where there is none."""
    if text is None:
        return None
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        fault = f"metadata 'carosac' is not a JSON document: {error}"
        raise InvalidFile(path, [fault]) from error
    if not isinstance(document, dict):
        raise InvalidFile(path, ["metadata 'carosac' is not a JSON object"])
    return document
