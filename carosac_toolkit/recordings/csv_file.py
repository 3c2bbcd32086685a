"""CSV: comment lines with the document, a header, one line per time stamp."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidFile
from carosac_toolkit.base.file_limits import check_recording, check_text_size, doubles
from carosac_toolkit.recordings.conversion import from_table, row_times, to_blocks, to_document
from carosac_toolkit.recordings.csv_cells import CellParser
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.recordings.table import Mask, Table, shortened

BLOCK_CHARACTERS = 2**21  # that are parsed at once
LINE_CHARACTERS_MAX = 2**17
HEADER_SHOWN = 60  # characters of a first line without names that messages show
COLUMNS_HINT = (
    "time_s,position_x_m,position_y_m,position_z_m for a path, "
    "time_s,cable_length_1_m,cable_length_2_m,... for a recording"
)
COMMENT_LINES_MAX = 100_000


def write_csv(recording: Recording, path: Path) -> None:
    """Write a recording; every number reads back to the same float64."""
    time = row_times(recording)
    document = json.dumps(to_document(recording, len(time)), indent=1)
    with path.open("w", encoding="utf-8", newline="\n") as stream:
        stream.writelines(f"# {line}\n" for line in document.splitlines())
        for number, block in enumerate(to_blocks(recording, time)):
            if not number:
                stream.write(",".join(block) + "\n")
            cells = [_cells(column, empty) for column, empty in block.values()]
            stream.writelines(",".join(row) + "\n" for row in zip(*cells, strict=True))


def read_csv(path: Path) -> Recording:
    """Read a CSV recording, with or without the comment lines.

    Raises:
        InvalidFile: With all faults that were found.
    """
    table, document = read_table(path)
    return from_table(table, document, path)


def read_table(path: Path) -> tuple[Table, dict[str, Any] | None]:
    """Read the columns of a CSV file, and the document in the comment lines above them.

    Raises:
        InvalidFile: With all faults that were found.
    """
    if path.stat().st_size == 0:
        raise InvalidFile(path, ["the file is empty"])
    check_text_size(path, path.stat().st_size)
    with path.open("rb") as ending:
        ending.seek(-1, os.SEEK_END)
        truncated = ending.read() != b"\n"
    try:
        with path.open(encoding="utf-8-sig") as stream:
            lines = _Lines(stream, path)
            document = _document(lines.comments(), path)
            header = lines.header()
            if document is not None and truncated:
                raise InvalidFile(path, ["the file is truncated: its last line has no newline"])
            table = CellParser(_names(header, path), path).table(lines.blocks())
    except UnicodeDecodeError as error:
        raise InvalidFile(path, [f"not a text file: {error}"]) from error
    return table, document


class _Lines:
    """Lines of a file, in order, none longer than a table can have."""

    def __init__(self, stream: TextIO, path: Path) -> None:
        self._stream = stream
        self._path = path
        self._number = 0  # of `_line`
        self._line = ""
        self._advance()

    def comments(self) -> list[str]:
        """Return the comment lines at the top, without `#`."""
        comments = []
        while self._line.startswith("#"):
            comments.append(self._line[1:].rstrip("\n"))
            self._advance()
            if self._number > COMMENT_LINES_MAX:
                raise InvalidFile(self._path, ["the comment lines at the top do not end"])
        return comments

    def header(self) -> str:
        """Return the line after the comments."""
        if not self._line:
            raise InvalidFile(self._path, ["there is no header line with column names"])
        header = self._line.rstrip("\n")
        self._advance()
        return header

    def blocks(self) -> Iterator[tuple[list[str], list[int]]]:
        """Yield the lines that are not blank, some at once, with their numbers."""
        while self._line:
            lines, numbers, size = list[str](), list[int](), 0
            while self._line and size < BLOCK_CHARACTERS:
                if not self._line.isspace():
                    lines.append(self._line)
                    numbers.append(self._number)
                size += len(self._line)
                self._advance()
            if lines:
                yield lines, numbers

    def _advance(self) -> None:
        self._line = self._stream.readline(LINE_CHARACTERS_MAX)
        self._number += 1
        if len(self._line) == LINE_CHARACTERS_MAX:
            fault = f"line {self._number}: longer than {LINE_CHARACTERS_MAX - 1} characters"
            raise InvalidFile(self._path, [fault])


def _cells(column: Array, empty: Mask) -> list[str]:
    """Write each value as the shortest text that reads back to the same float64."""
    return ["" if gone else repr(v) for v, gone in zip(column.tolist(), empty, strict=True)]


def _names(header: str, path: Path) -> list[str]:
    """Return the column names, each there once."""
    others = {mark: header.count(mark) for mark in ";\t" if header.count(mark)}
    if others and "," not in header:
        mark = max(others, key=lambda key: others[key])
        fault = f"the header line has no comma: is the separator {mark!r}? allowed: ','"
        raise InvalidFile(path, [f"{fault}, and '.' in numbers"])
    try:
        names = [name.strip() for name in next(csv.reader([header]), [""])]
    except csv.Error as error:
        raise InvalidFile(path, [f"not a CSV file: {error}"]) from error
    check_recording(path, 0, len(names), 0)
    if all(map(_is_number, names)):
        fault = f"the first line must name the columns: got {header[:HEADER_SHOWN]!r}; allowed: "
        raise InvalidFile(path, [f"{fault}{COLUMNS_HINT}"])
    faults = [f"column {name!r} appears twice" for name in doubles(names)]
    if faults:
        raise InvalidFile(path, shortened(faults))
    return names


def _is_number(text: str) -> bool:
    """Return whether a cell of the header is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def _document(lines: list[str], path: Path) -> dict[str, Any] | None:
    """Return the document in the comment lines; None where there are none."""
    if not lines:
        return None
    try:
        document = json.loads("\n".join(lines))
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
