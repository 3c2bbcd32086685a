"""Results of a reference suite as small files: one row per case, and a record of the suite."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from carosac_toolkit.base.errors import CarosacError, InvalidField, InvalidFile, MissingFile
from carosac_toolkit.studies.compare.paired import PairedBlock, paired_blocks
from carosac_toolkit.studies.compare.paper_tables import explanation, markdown_table, sheets
from carosac_toolkit.studies.compare.results import COMPARED_COLUMNS, StudyResults
from carosac_toolkit.studies.reference.cases import TRACKING, ReferenceSuite, SuiteTask
from carosac_toolkit.studies.run.folder import json_record
from carosac_toolkit.studies.run.rows import CASE_STATUSES, Row, renamed

RESULTS, RECORD, TABLES = "results.csv", "reference.json", "tables.md"
REFERENCE_SCHEMA = "carosac-reference/1"
PUBLISHED_LABEL = "published"
TEXT_COLUMNS = (
    "part", "robot", "controller", "estimator", "sensors", "perturbation", "trajectory", "seed",
    "status", "reason",
)  # fmt: skip
NUMBER_COLUMNS = (
    "tracking_rmse_x_m", "tracking_rmse_y_m", "tracking_rmse_z_m", "tracking_rmse_norm_m",
    "tracking_centre_m", "tracking_boundary_m", "residual_sway_m", "estimation_rmse_x_m",
    "estimation_rmse_y_m", "estimation_rmse_z_m", "estimation_rmse_norm_m",
    "orientation_rmse_rad", "latency_median_s", "latency_p95_s", "latency_p99_s", "wall_time_s",
    "steps", "centre_steps", "limited",
)  # fmt: skip
LATER_COLUMNS = (  # which files of earlier versions do not have
    "tension_min_N", "tension_max_N", "slack_share", "overload_share", "outside_share",
    "limited_share",
)  # fmt: skip


class OtherSuite(CarosacError):
    """Error of results of another definition, which cannot be compared with these."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PartResults:
    """Results of one part of a suite on one robot.

    Attributes:
        task: Task that was run.
        results: Its rows, with those of others where they were asked for.
    """

    task: SuiteTask
    results: StudyResults

    @cached_property
    def blocks(self) -> list[PairedBlock]:
        """Paired comparisons with the baseline."""
        labels = zip(self.results.labels_of(COMPARED_COLUMNS), self.results.summary, strict=True)
        wanted = self.task.baseline
        names = [x for x, line in labels if (line["controller"], line["estimator"]) == wanted]
        return paired_blocks(self.results, names[0])

    @property
    def rows(self) -> list[Row]:
        """Rows, each with its part."""
        return [row | {"part": self.task.part} for row in self.results.rows]


def write_rows(parts: Sequence[PartResults]) -> str:
    """Write rows of all parts as CSV: six digits of each number, one row per case."""
    stream = io.StringIO()
    writer: Any = csv.writer(stream, lineterminator="\n")
    writer.writerow((*TEXT_COLUMNS, *NUMBER_COLUMNS, *LATER_COLUMNS))
    for part in parts:
        for row in part.rows:
            known = {**row, "reason": row["reason"] or ""}
            cells = [str(known[name]).replace("\n", " ") for name in TEXT_COLUMNS]
            numbers = (*NUMBER_COLUMNS, *LATER_COLUMNS)
            writer.writerow([*cells, *(_digits(row.get(name)) for name in numbers)])
    return stream.getvalue()


def read_rows(folder: Path) -> list[Row]:
    """Read rows that `write_rows` wrote; a missing number is None.

    Raises:
        MissingFile: There are none.
        InvalidFile: The file is none of this kind.
    """
    path = folder / RESULTS
    reader = csv.DictReader(io.StringIO(_text(path)))
    reader.fieldnames = list(renamed(dict.fromkeys(reader.fieldnames or ())))
    missing = [name for name in (*TEXT_COLUMNS, *NUMBER_COLUMNS) if name not in reader.fieldnames]
    if missing:
        raise InvalidFile(path, [f"header: got no {', '.join(missing)}; allowed: all columns"])
    rows, faults = [], []
    for line in reader:
        try:
            rows.append(_row(line))
        except InvalidField as error:
            faults.append(f"line {reader.line_num}, {error}")
    if faults:
        raise InvalidFile(path, faults)
    return rows


def read_record(folder: Path) -> dict[str, Any]:
    """Read which suite the results of a folder belong to.

    Raises:
        MissingFile: There is no record.
        InvalidFile: It is none of a suite.
    """
    return json_record(folder / RECORD, REFERENCE_SCHEMA, {"suite": str, "digest": str}, read=_text)


def _text(path: Path) -> str:
    """Return the content of a file of results."""
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise MissingFile(path, "this is no folder of a reference suite") from error
    except UnicodeDecodeError as error:
        raise InvalidFile(path, [f"not UTF-8 text (byte {error.start})"]) from error
    except OSError as error:
        raise InvalidFile(path, [f"cannot be read: {error.strerror}"]) from error


def check_same(suite: ReferenceSuite, folder: Path) -> None:
    """Refuse to compare with results of another definition.

    Raises:
        OtherSuite: They are of another one.
    """
    other = read_record(folder)
    if other["digest"] != suite.digest:
        raise OtherSuite(
            f"{folder} holds results of {other['suite']} ({other['digest']}); these are of "
            f"{suite.name} ({suite.digest}). Results of different definitions cannot be compared"
        )


def with_published(part: PartResults, rows: Sequence[Row]) -> PartResults:
    """Add others' rows from the same draws to those of a part.

    What ran here as well is left out of theirs: it tells whether both agree.
    """
    here = {_way(row) for row in part.results.rows}
    others = [
        row | {_axis(part): f"{row[_axis(part)]} ({PUBLISHED_LABEL})"}
        for row in rows
        if (row["part"], row["robot"]) == (part.task.part, part.task.robot)
        and _way(row) not in here
    ]
    return replace(part, results=replace(part.results, rows=(*part.results.rows, *others)))


def tables(suite: ReferenceSuite, parts: Sequence[PartResults], origin: str) -> str:
    """Return all tables as Markdown."""
    head = f"Suite `{suite.name}`, definition `{suite.digest}`."
    texts = []
    for part in parts:
        shown = [f"**{one.title}**\n\n{markdown_table(one)}" for one in sheets(part.blocks)]
        texts += [f"### {part.task.part.capitalize()}, {part.task.robot}", *shown]
    blocks = [block for part in parts for block in part.blocks]
    return "\n\n".join([head, *texts, explanation(blocks), origin]) + "\n"


def record(
    suite: ReferenceSuite, parts: Sequence[PartResults], made: Mapping[str, str], command: str
) -> dict[str, Any]:
    """Return the origin of the results, and their paired comparisons."""
    return {
        "schema": REFERENCE_SCHEMA,
        "suite": suite.name,
        "digest": suite.digest,
        "command": command,
        "made": dict(made),
        "parts": [
            {"part": part.task.part, "blocks": [block.data() for block in part.blocks]}
            for part in parts
        ],
    }


def _axis(part: PartResults) -> str:
    """Return which axis the entries of a part belong to."""
    return "controller" if part.task.part == TRACKING else "estimator"


def _way(row: Row) -> tuple[str, str]:
    return str(row["controller"]), str(row["estimator"])


def _digits(value: Any) -> str:
    return "" if value is None else f"{value:.6g}"


def _row(line: Mapping[str, str | None]) -> Row:
    """Parse one line as a row of a study.

    Raises:
        InvalidField: A cell that is missing, or none of its kind.
    """
    cells = {name: line[name] for name in (*TEXT_COLUMNS, *NUMBER_COLUMNS)}
    short = [name for name, cell in cells.items() if cell is None]
    if short:
        raise InvalidField(short[0], "nothing", "a cell in each column")
    row: Row = {name: cells[name] for name in TEXT_COLUMNS}
    if row["status"] not in CASE_STATUSES:
        raise InvalidField("status", repr(row["status"]), f"one of {list(CASE_STATUSES)}")
    cells |= {name: line.get(name) for name in LATER_COLUMNS}
    row |= {
        name: _number(name, cell, float) if (cell := cells[name]) else None
        for name in (*NUMBER_COLUMNS, *LATER_COLUMNS)
    }
    seed = _number("seed", cells["seed"] or "", int)
    return row | {"seed": seed, "reason": cells["reason"] or None, "settings": "{}"}


def _number(name: str, cell: str, kind: type[int] | type[float]) -> int | float:
    """Parse a finite number."""
    try:
        value = kind(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InvalidField(name, repr(cell), "a finite number")
    return value
