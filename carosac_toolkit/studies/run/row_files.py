"""Rows on disk: small Parquet files, written atomically and merged now and then."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from carosac_toolkit.base.errors import MALFORMED, InvalidFile
from carosac_toolkit.base.file_limits import read_rows
from carosac_toolkit.base.files import replacing
from carosac_toolkit.studies.run.rows import (
    Row,
    Value,
    column_kinds,
    in_common_columns,
    renamed,
)

PART_FILE_PATTERN = "part-*.parquet"
LARGE_PART_ROWS_MIN = 10_000  # rows of a part that is not merged any more
READ_ATTEMPTS = 5
_COLUMN_TYPES = ("bool", "int64", "double", "string", "null")  # of Arrow
_JSON_METADATA = {b"carosac": b"json"}  # marks a column of JSON texts, of values of several types


def part_files(folder: Path) -> list[Path]:
    """Return all parts, oldest first."""
    return sorted(folder.glob(PART_FILE_PATTERN))


def write_part(folder: Path, rows: Sequence[Row]) -> Path:
    """Write rows as a new part, the last one."""
    last = [path.stem.split("-")[1] for path in part_files(folder)[-1:]]
    number = int(last[0]) + 1 if last and last[0].isdigit() else len(part_files(folder))
    path = folder / f"part-{number:08d}.parquet"
    replace_part(path, rows)
    return path


def replace_part(path: Path, rows: Sequence[Row]) -> None:
    """Write rows as this part atomically: another process sees either all of it or the old one."""
    import pyarrow.parquet as pq

    with replacing(path) as temporary:
        pq.write_table(_table(in_common_columns(rows)), temporary)


def read_part(path: Path) -> list[Row]:
    """Read the rows of one part.

    Raises:
        InvalidFile: It is no whole part.
        FileNotFoundError: It is not there.
    """
    import pyarrow as pa

    try:
        return _rows(path)
    except FileNotFoundError:
        raise
    except (pa.ArrowException, OSError, *MALFORMED) as error:
        detail = (str(error).splitlines() or [type(error).__name__])[0]
        fault = f"this is no whole Parquet file: {detail}; delete it and run the study again: only"
        raise InvalidFile(path, [f"{fault} the cases in it run again"]) from error


def _rows(path: Path) -> list[Row]:
    """Read the rows of one part; a damaged one raises any of many errors."""
    table = read_rows(path)
    kinds = {item.name: str(item.type) for item in table.schema}
    if not {"case", "status"} <= set(kinds):
        raise InvalidFile(path, ["this is no part of a study: it lacks the column case or status"])
    for name, kind in kinds.items():
        if kind not in (("string",) if name in ("case", "status") else _COLUMN_TYPES):
            raise TypeError(f"column {name!r} has type {kind}")
    rows: list[Row] = table.to_pylist()
    for item in table.schema:
        if item.metadata and dict(item.metadata).get(b"carosac") == b"json":
            for row in rows:
                text = row[item.name]
                row[item.name] = None if text is None else _scalar(str(text))
    return [renamed(row) for row in rows]


def _scalar(text: str) -> Value:
    """Return a value of a column of several types."""
    value: Value = json.loads(text)
    if isinstance(value, list | dict):
        raise TypeError(f"got {text[:80]!r}; allowed: a number, text, true, false or null")
    if isinstance(value, int):
        float(value)  # which a column with others may need
    return value


def read_parts(folder: Path) -> dict[str, Row]:
    """Read all rows by case; of rows with the same case the first one counts.

    Raises:
        InvalidFile: A part is broken.
    """
    for attempt in range(READ_ATTEMPTS):
        by_case: dict[str, Row] = {}
        try:
            for path in part_files(folder):
                for row in read_part(path):
                    by_case.setdefault(str(row["case"]), row)
            return by_case
        except FileNotFoundError:  # a running study has just merged parts: look again
            if attempt == READ_ATTEMPTS - 1:
                raise
    return by_case


def merge_parts(folder: Path, known: Collection[str]) -> None:
    """Merge the small parts into one; parts with any unknown case stay as they are.

    The merged part appears before the others go. Should the process die in between, rows are there
    twice until the next merge, and readers take the first.
    """
    rows: dict[str, Row] = {}
    merged: list[Path] = []
    for path in part_files(folder):
        part = read_part(path)
        if len(part) < LARGE_PART_ROWS_MIN and all(row["case"] in known for row in part):
            merged.append(path)
            for row in part:
                rows.setdefault(str(row["case"]), row)
    if len(merged) > 1:
        write_part(folder, list(rows.values()))
        for path in merged:
            path.unlink()


def drop_rows(folder: Path, known: Collection[str], statuses: Collection[str]) -> None:
    """Remove the rows of known cases with these statuses, so that they run again."""
    for path in part_files(folder):
        rows = read_part(path)
        kept = [x for x in rows if x["case"] not in known or x["status"] not in statuses]
        if not kept:
            with contextlib.suppress(FileNotFoundError):
                path.unlink()
        elif len(kept) < len(rows):
            replace_part(path, kept)


def _table(rows: Sequence[Row]) -> Any:
    """Return an Arrow table of rows that share their columns."""
    import pyarrow as pa

    fields, arrays = [], []
    for name in rows[0] if rows else ():
        values: list[Any] = [row[name] for row in rows]
        metadata = None
        if len(column_kinds(rows, name)) > 1 or any(_is_huge(value) for value in values):
            values = [None if value is None else json.dumps(value) for value in values]
            metadata = _JSON_METADATA
        array = pa.array(values)
        arrays.append(array)
        fields.append(pa.field(name, array.type, metadata=metadata))
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields))


def _is_huge(value: Any) -> bool:
    """Return whether a whole number does not fit a Parquet integer."""
    return isinstance(value, int) and not -(2**63) <= value < 2**63
