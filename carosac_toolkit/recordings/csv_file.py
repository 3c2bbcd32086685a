"""CSV: comment lines with the document, a header, one line per time stamp."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidFile
from carosac_toolkit.base.file_limits import check_text_size
from carosac_toolkit.recordings.conversion import from_table, to_document, to_table
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.recordings.table import Table, shortened


def write_csv(recording: Recording, path: Path) -> None:
    """Write a recording; every number reads back to the same float64."""
    table = to_table(recording)
    document = json.dumps(to_document(recording, table.rows), indent=1)
    with path.open("w", encoding="utf-8", newline="\n") as stream:
        stream.writelines(f"# {line}\n" for line in document.splitlines())
        stream.write(",".join(table.columns) + "\n")
        cells = [_cells(column, table.empty[name]) for name, column in table.columns.items()]
        stream.writelines(",".join(row) + "\n" for row in zip(*cells, strict=True))


def read_csv(path: Path) -> Recording:
    """Read a CSV recording, with or without the comment lines.

    Raises:
        InvalidFile: With all faults that were found.
    """
    check_text_size(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InvalidFile(path, [f"not a text file: {error}"]) from error
    lines = text.splitlines()
    comments = 0
    while comments < len(lines) and lines[comments].startswith("#"):
        comments += 1
    document = _document(lines[:comments], path)
    if comments == len(lines):
        raise InvalidFile(path, ["there is no header line with column names"])
    if document is not None and not text.endswith("\n"):
        raise InvalidFile(path, ["the file is truncated: its last line has no newline"])
    names = _names(lines[comments], path)
    filled = [(i + 1, lines[i]) for i in range(comments + 1, len(lines)) if lines[i].strip()]
    numbers = [number for number, _ in filled]
    rows = _split([line for _, line in filled], path)
    return from_table(_table(names, rows, numbers, path), document, path)


def _cells(column: Array, empty: NDArray[np.bool_]) -> list[str]:
    """Write each value as the shortest text that reads back to the same float64."""
    return ["" if gone else repr(v) for v, gone in zip(column.tolist(), empty, strict=True)]


def _split(lines: list[str], path: Path) -> list[list[str]]:
    """Split lines into cells, each line on its own."""
    try:
        return [next(csv.reader([line])) for line in lines]
    except csv.Error as error:
        raise InvalidFile(path, [f"not a CSV file: {error}"]) from error


def _names(header: str, path: Path) -> list[str]:
    """Return the column names, each there once."""
    others = {mark: header.count(mark) for mark in ";\t" if header.count(mark)}
    if others and "," not in header:
        mark = max(others, key=lambda key: others[key])
        fault = f"the header line has no comma: is the separator {mark!r}? allowed: ','"
        raise InvalidFile(path, [f"{fault}, and '.' in numbers"])
    names = [name.strip() for name in _split([header], path)[0]]
    double = sorted({name for name in names if names.count(name) > 1})
    if double:
        raise InvalidFile(path, [f"column {name!r} appears twice" for name in double])
    return names


def _document(lines: list[str], path: Path) -> dict[str, Any] | None:
    """Return the document in the comment lines; None where there are none."""
    if not lines:
        return None
    try:
        document = json.loads("\n".join(line[1:] for line in lines))
    except RecursionError as error:
        raise InvalidFile(path, ["the comment lines at the top are nested too deeply"]) from error
    except ValueError as error:
        line = f"line {error.lineno}: " if isinstance(error, json.JSONDecodeError) else ""
        reason = error.msg if isinstance(error, json.JSONDecodeError) else str(error)
        fault = f"{line}the comment lines at the top are not a JSON document: {reason}"
        raise InvalidFile(path, [fault]) from error
    if not isinstance(document, dict):
        raise InvalidFile(path, ["the comment lines at the top are not a JSON object"])
    return document


def _table(names: list[str], rows: list[list[str]], numbers: list[int], path: Path) -> Table:
    """Turn text cells into numbers."""
    faults = [
        f"line {number}: {len(row)} cells; allowed: {len(names)}, as the header has"
        for row, number in zip(rows, numbers, strict=True)
        if len(row) != len(names)
    ]
    if faults:
        raise InvalidFile(path, shortened(faults))
    values = np.zeros((len(rows), len(names)))
    empty = np.zeros(values.shape, dtype=np.bool_)
    for i, row in enumerate(rows):
        faults += _parse(row, values[i], empty[i], names, numbers[i])
    if faults:
        raise InvalidFile(path, shortened(faults))
    return Table(
        columns={name: values[:, j].copy() for j, name in enumerate(names)},
        empty={name: empty[:, j].copy() for j, name in enumerate(names)},
        lines=numbers,
    )


def _parse(row: list[str], values: Any, empty: Any, names: Iterable[str], number: int) -> list[str]:
    """Fill one row of values; return the faults of cells that are no number."""
    faults = []
    for j, (cell, name) in enumerate(zip(row, names, strict=True)):
        if not cell.strip():
            empty[j] = True
            continue
        try:
            values[j] = float(cell.replace("_", "no digit"))  # Python alone takes 1_0 for 10
        except ValueError:
            faults.append(f"line {number}, column {name!r}: got {cell!r}; allowed: a number")
    return faults
