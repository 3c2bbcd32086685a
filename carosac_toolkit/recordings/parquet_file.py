"""Parquet: the table, with its document in the schema's metadata."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from carosac_toolkit.base.errors import InvalidFile
from carosac_toolkit.base.file_limits import open_parquet
from carosac_toolkit.recordings.conversion import from_table, to_document, to_table
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.recordings.table import Table

METADATA_KEY = b"carosac"


def write_parquet(recording: Recording, path: Path) -> None:
    """Write a recording; empty cells are null."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = to_table(recording)
    arrays = [
        pa.array(column, type=pa.float64(), mask=table.empty[name])
        for name, column in table.columns.items()
    ]
    document = json.dumps(to_document(recording, table.rows)).encode()
    schema = pa.schema(
        [(name, pa.float64()) for name in table.columns], metadata={METADATA_KEY: document}
    )
    pq.write_table(pa.Table.from_arrays(arrays, schema=schema), path)


def read_parquet(path: Path) -> Recording:
    """Read a Parquet recording.

    Raises:
        InvalidFile: With all faults that were found.
    """
    import pyarrow as pa

    try:
        file = open_parquet(path)
        names = file.schema_arrow.names
        _check_columns(file.schema_arrow, path)
        stored = file.read()
    except (pa.ArrowException, OSError, ValueError) as error:  # ValueError: a name is not UTF-8
        fault = f"this is no whole Parquet file: {str(error).splitlines()[0]}"
        raise InvalidFile(path, [fault]) from error
    columns, empty = {}, {}
    for name in names:
        column = stored[name].combine_chunks()
        empty[name] = np.asarray(column.is_null().to_numpy(zero_copy_only=False), dtype=np.bool_)
        try:
            values = column.cast(pa.float64()).fill_null(0.0).to_numpy(zero_copy_only=False)
        except pa.ArrowException as error:
            fault = f"column {name!r}: {str(error).splitlines()[0]}"
            raise InvalidFile(path, [fault]) from error
        columns[name] = np.array(values, dtype=np.float64)
    document = _document((stored.schema.metadata or {}).get(METADATA_KEY), path)
    return from_table(Table(columns=columns, empty=empty), document, path)


def _check_columns(schema: Any, path: Path) -> None:
    """Refuse columns that hold no numbers or appear twice, before they are decoded."""
    import pyarrow as pa

    faults = [
        f"column {field.name!r}: got type {field.type}; allowed: numbers"
        for field in schema
        if not (pa.types.is_floating(field.type) or pa.types.is_integer(field.type))
    ]
    double = {name for name in schema.names if schema.names.count(name) > 1}
    faults += [f"column {name!r} appears twice" for name in sorted(double)]
    if faults:
        raise InvalidFile(path, faults)


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
