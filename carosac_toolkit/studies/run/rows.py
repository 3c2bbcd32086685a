"""Row of a case: its status, its fields, and the numbers that its run returned."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping
from typing import Any, Literal, get_args

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.studies.run.case import CASE_COLUMNS, HASHED_AS, Case, canonical

Value = bool | int | float | str | None
Row = dict[str, Value]
Status = Literal["ok", "diverged", "failed", "crashed", "timed_out"]

CASE_STATUSES: tuple[str, ...] = get_args(Status)
OWN_COLUMNS = ("case", "status", "reason", *CASE_COLUMNS, "seed", "settings", "wall_time_s")
LATENCY_COLUMNS = (
    "latency_median_s",
    "latency_p95_s",
    "latency_p99_s",
)  # of one run; none in a batch
REASON_CHARACTERS_MAX = 1000  # characters kept of a message


class BadRow(CarosacError):
    """Error of a case function that returned an invalid row."""


def make_row(
    case: Case,
    status: Status,
    *,
    reason: str | None = None,
    wall_time: float,
    values: Mapping[str, Value] | None = None,
) -> Row:
    """Build the row of a case.

    Args:
        case: The case.
        status: ``"ok"``; ``"diverged"``: it ran to its end, but its errors are no score;
            ``"failed"``: it raised; ``"timed_out"``: it ran longer than allowed; ``"crashed"``: its
            process died each time.
        reason: Why it is not ok.
        wall_time: Wall time of the run [s].
        values: Values of the case function, as `checked_values` lets it through.
    """
    row: Row = {"case": case.identity, "status": status, "reason": _shortened(reason)}
    row |= {name: getattr(case, name) for name in (*CASE_COLUMNS, "seed")}
    row |= {"settings": canonical(dict(case.settings)), "wall_time_s": wall_time}
    return row | dict(values or {})


def row_of_run(case: Case, values: Mapping[str, Value], *, wall_time: float) -> Row:
    """Build the row of a case that ran to its end: ``ok``, or ``diverged`` if a value says why."""
    others = {name: value for name, value in values.items() if name != "diverged"}
    why = values.get("diverged")
    status: Status = "ok" if why is None else "diverged"
    reason = None if why is None else str(why)
    return make_row(case, status, reason=reason, wall_time=wall_time, values=others)


def checked_values(returned: Any) -> dict[str, Value]:
    """Return the values of a case function with numpy scalars as plain ones.

    Raises:
        BadRow: It is no flat dict of finite numbers, text, true/false and None, or it uses a
            column name that every row has already.
    """
    if not isinstance(returned, Mapping):
        raise BadRow(f"the case function returned {type(returned).__name__}; allowed: a dict")
    return {_checked_name(name): _checked_value(name, x) for name, x in returned.items()}


def in_common_columns(rows: Iterable[Row]) -> list[Row]:
    """Give all rows the same columns, and all numbers of a column the same type.

    What a row does not have is None. A column with any float holds floats, however the rows were
    spread over files.
    """
    rows = list(rows)
    others = sorted({name for row in rows for name in row} - set(OWN_COLUMNS))
    columns = (*OWN_COLUMNS, *others)
    floating = {name for name in columns if column_kinds(rows, name) == {int, float}}
    return [{name: _as_float(row.get(name), name in floating) for name in columns} for row in rows]


def renamed(row: Row) -> Row:
    """Return a row with the names of today; one of an earlier version may have those of before."""
    new_names = {old: new for new, old in HASHED_AS.items() if new not in row}
    return {new_names.get(name, name): value for name, value in row.items()}


def column_kinds(rows: Iterable[Row], name: str) -> set[type]:
    """Return the types of the values that a column holds, without None."""
    return {type(row[name]) for row in rows if row.get(name) is not None}


def _as_float(value: Value, wanted: bool) -> Value:
    """Turn a whole number into a float if requested."""
    return float(value) if wanted and isinstance(value, int) else value


def _checked_name(name: Any) -> str:
    """Check the name of a column."""
    if not isinstance(name, str) or not name:
        raise BadRow(f"row field {name!r}: got a {type(name).__name__}; allowed: a name")
    if name in OWN_COLUMNS:
        raise BadRow(f"row field '{name}': every row has this column; allowed: another name")
    return name


def _checked_value(name: Any, value: Any) -> Value:
    """Check one value and make it a plain one."""
    if type(value).__module__ == "numpy" and getattr(value, "ndim", None) == 0:
        value = value.item()
    if value is None or isinstance(value, (bool, str)):
        return value
    if isinstance(value, int) and abs(value) <= sys.float_info.max:
        return int(value)
    if isinstance(value, float) and math.isfinite(value):
        return float(value)
    raise BadRow(
        f"row field '{name}': got {_shortened(repr(value), 80)}; "
        "allowed: a finite number, text, true/false or None"
    )


def _shortened(text: str | None, length: int = REASON_CHARACTERS_MAX) -> str | None:
    """Cut a long message."""
    return text if text is None or len(text) <= length else text[: length - 4] + " ..."
