"""Observations as CSV with units in the names of its columns.

Columns: ``setup``, ``target``; then ``hz_U``, ``v_U`` and ``slope_L``, or ``x_L``, ``y_L``, ``z_L``
in the set-up's frame (origin in the instrument, z up, y where Hz is 0, x to the right of it); U is
gon, deg, rad or mil and L is m, mm or ft. Optional: ``prism_constant_mm``, ``sighted``,
``rim_deg``. Lines that start with # are comments.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from calibration.tachymeter.observations import face_one, polar
from calibration.tachymeter.records import (
    MILLIMETRE_M,
    Record,
    plain_name,
    read_lines,
    shortened_faults,
)
from carosac_toolkit.base.errors import InvalidFile, did_you_mean
from carosac_toolkit.base.file_limits import csv_cells, doubles

ANGLE_UNITS_RAD = {"gon": np.pi / 200.0, "deg": np.pi / 180.0, "rad": 1.0, "mil": np.pi / 3200.0}
LENGTH_UNITS_M = {"m": 1.0, "mm": MILLIMETRE_M, "ft": 0.3048}
_TEXT_COLUMNS = ("setup", "target", "sighted")
_OPTIONAL_COLUMNS = ("prism_constant_mm", "rim_deg")
_ANGLE_COLUMNS, _SPACE_COLUMNS = ("hz", "v"), ("x", "y", "z")


def read_csv(path: str) -> list[Record]:
    """Read a file of one or more set-ups.

    Args:
        path: The file.

    Returns:
        Its observations in order, in face I.

    Raises:
        MissingFile: There is no such file.
        InvalidFile: Names every column and line that cannot be read, and why.
    """
    lines = list(enumerate(read_lines(path), start=1))
    rows = [(n, text) for n, text in lines if text.strip() and not text.lstrip().startswith("#")]
    if not rows:
        raise InvalidFile(path, ["nothing but comments; a header line is needed"])
    header = [name.lower() for name in csv_cells(path, *rows[0])]
    faults = _header_faults(header)
    if faults:
        raise InvalidFile(path, [f"line {rows[0][0]}: {fault}" for fault in faults])
    read = _polar_row if any(name.startswith("slope_") for name in header) else _space_row
    records: list[Record] = []
    for number, text in rows[1:]:
        cells = csv_cells(path, number, text)
        try:
            records.append(_record(path, number, header, cells, read))
        except ValueError as error:
            faults.append(f"line {number}: {error}")
    if faults:
        raise InvalidFile(path, shortened_faults(faults))
    if not records:
        raise InvalidFile(path, ["a header, but no observations"])
    return records


def _header_faults(header: list[str]) -> list[str]:
    """Find what is wrong with the columns."""
    known = [
        *_TEXT_COLUMNS,
        *_OPTIONAL_COLUMNS,
        *(f"{name}_{unit}" for name in _ANGLE_COLUMNS for unit in ANGLE_UNITS_RAD),
        *(f"{name}_{unit}" for name in ("slope", *_SPACE_COLUMNS) for unit in LENGTH_UNITS_M),
    ]
    faults = [
        *(
            f"column '{name}' is unknown" + did_you_mean(name, known)
            for name in header
            if name not in known
        ),
        *(f"column '{name}' twice" for name in doubles(header)),
        *(f"no column '{name}'" for name in ("setup", "target") if name not in header),
    ]
    if faults:
        return faults
    has = {name: [n for n in header if n.rpartition("_")[0] == name] for name in (
        *_ANGLE_COLUMNS, "slope", *_SPACE_COLUMNS
    )}  # fmt: skip
    polar_given = any(has[name] for name in (*_ANGLE_COLUMNS, "slope"))
    if polar_given and any(has[name] for name in _SPACE_COLUMNS):
        return ["both angles and coordinates; give hz, v, slope or x, y, z"]
    names = (*_ANGLE_COLUMNS, "slope") if polar_given else _SPACE_COLUMNS
    faults = [
        f"no column for {name}, such as '{name}_{_usual(name)}'" for name in names if not has[name]
    ]
    for group in (_ANGLE_COLUMNS, ("slope",)) if polar_given else (_SPACE_COLUMNS,):
        columns = [column for name in group for column in has[name]]
        if len({column.rpartition("_")[2] for column in columns}) > 1 or len(columns) > len(group):
            faults.append(f"mixed units: {', '.join(columns)}; use one unit")
    return faults


def _usual(name: str) -> str:
    return "gon" if name in _ANGLE_COLUMNS else "m"


def _record(
    path: str, number: int, header: list[str], cells: list[str],
    read: Callable[[dict[str, str]], tuple[float, float, float]],
) -> Record:  # fmt: skip
    """Read one line."""
    if len(cells) != len(header):
        raise ValueError(f"{len(cells)} cells, but the header has {len(header)}: cut off?")
    row = dict(zip(header, cells, strict=True))
    for name in ("setup", "target"):
        if not row[name]:
            raise ValueError(f"no {name}")
    hz, v, distance = read(row)
    constant = _optional(row, "prism_constant_mm")
    return Record(
        setup=row["setup"], point=plain_name(row["target"]), hz=hz, v=v, distance=distance,
        prism_constant=None if constant is None else constant * MILLIMETRE_M,
        sighted=row.get("sighted") or None, rim_deg=_optional(row, "rim_deg"),
        path=path, line=number,
    )  # fmt: skip


def _polar_row(row: dict[str, str]) -> tuple[float, float, float]:
    """Read Hz, V and slope distance, in face I."""
    hz, v = (_scaled(row, name, ANGLE_UNITS_RAD) for name in _ANGLE_COLUMNS)
    slope = _scaled(row, "slope", LENGTH_UNITS_M)
    if slope <= 0.0:
        raise ValueError(f"slope distance {slope:g} m; allowed: > 0")
    if not 0.0 < v < 2.0 * np.pi:
        raise ValueError(f"V is {np.rad2deg(v):g} deg: no zenith angle")
    return (*face_one(hz, v), slope)


def _space_row(row: dict[str, str]) -> tuple[float, float, float]:
    """Read coordinates in the set-up's frame, as Hz, V, distance."""
    place = np.array([_scaled(row, name, LENGTH_UNITS_M) for name in _SPACE_COLUMNS])
    if np.linalg.norm(place) < 0.1:
        raise ValueError("a point less than 0.1 m from the instrument, the origin of its frame")
    hz, v, distance = polar(place[None])[0]
    return float(hz), float(v), float(distance)


def _scaled(row: dict[str, str], name: str, units: dict[str, float]) -> float:
    """Read a number in SI."""
    column = next(column for column in row if column.rpartition("_")[0] == name)
    return _number(column, row[column]) * units[column.rpartition("_")[2]]


def _optional(row: dict[str, str], column: str) -> float | None:
    """Read a number that may be missing."""
    return _number(column, row[column]) if row.get(column) else None


def _number(column: str, text: str) -> float:
    """Read a finite number."""
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{column} is {text!r}; allowed: a number with a point") from None
    if not np.isfinite(value):
        raise ValueError(f"{column} is {text}; allowed: a finite number")
    return value
