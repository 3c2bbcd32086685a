"""Files of motor angles: CSV with one line per sample."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.self_calibration.hangprinter_logs import is_log, parse_log, tells_nothing
from calibration.self_calibration.motor_angles import MotorAngles
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidFile, MissingFile
from carosac_toolkit.base.file_limits import csv_cells, doubles
from carosac_toolkit.base.files import replacing
from carosac_toolkit.recordings.table import shortened

_MOTOR_COLUMN = re.compile(r"motor_(?:angle_)?(?P<cable>.+?)_(?P<unit>deg|rad)")
_FORCE_COLUMN = re.compile(r"force_(?P<cable>.+?)_[nN]")
_KNOWN_COLUMN = re.compile(r"known_(?P<sigma>sigma_)?(?P<axis>[xyz])_(?P<unit>mm|m)")
_UNIT_FACTORS = {"deg": math.radians(1.0), "rad": 1.0, "mm": 1e-3, "m": 1.0}
COLUMNS_ALLOWED = (
    "sample, motor_NAME_deg or motor_angle_01_rad, known_x_mm or known_x_m, force_NAME_n"
)


@dataclass(frozen=True)
class _Column:
    """A column that means something: where it stands, of what, and in which unit."""

    index: int
    name: str
    factor: float


def holds_motor_angles(path: Path) -> bool:
    """Return whether a file has motor angles, as a table or a log; False where it is unreadable."""
    try:
        with path.open(encoding="utf-8-sig") as stream:
            for line in stream:
                if not tells_nothing(line):
                    return is_log(line) or any(
                        _MOTOR_COLUMN.fullmatch(cell.strip()) for cell in line.split(",")
                    )
    except (OSError, UnicodeDecodeError):
        pass
    return False


def load_motor_angles(path: str | Path) -> MotorAngles:
    """Read motor angles and the positions that are known, if any.

    Columns, in any order: ``sample`` (a name), one ``motor_NAME_deg`` or ``motor_angle_01_rad`` a
    motor (deg or rad, positive paying cable out), ``known_x_mm``, ``known_y_mm``, ``known_z_mm``
    (or ``_m``), blank or missing where a coordinate is unknown, and ``known_sigma_x_mm`` and so on
    if they differ from the settings, ``force_NAME_n`` for each motor, or for none, the tension with
    which it holds its cable [N]. Lines that start with # are comments. A file whose first line
    begins with a bracket is read as by `hangprinter_logs`.

    Raises:
        MissingFile: There is no such file.
        InvalidFile: With all faults that were found, by line.
    """
    path = Path(path)
    if not path.is_file():
        raise MissingFile(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InvalidFile(path, [f"this is no text file: {error}"]) from error
    if is_log(text):
        return parse_log(path, text)
    lines = [
        (number, csv_cells(path, number, line))
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.startswith("#")
    ]
    if len(lines) < 2:
        raise InvalidFile(
            path, [f"no samples; allowed: a header ({COLUMNS_ALLOWED}) and lines below it"]
        )
    reader = _AngleReader(lines[0][1])
    faults = reader.faults or reader.read(lines[1:])
    if faults:
        raise InvalidFile(path, shortened(faults))
    return reader.result()


def write_motor_angles(angles: MotorAngles, path: Path) -> None:
    """Write motor angles [rad] and known positions [m]; every number reads back the same."""
    known = [f"known_{axis}_m" for axis in "xyz"]
    spread = [f"known_sigma_{axis}_m" for axis in "xyz"] if angles.known_sigma is not None else []
    motors = [f"motor_{name}_rad" for name in angles.cables]
    if angles.tension is not None:
        motors += [f"force_{name}_n" for name in angles.cables]
    measured = np.hstack(
        [angles.motor_angle, *([] if angles.tension is None else [angles.tension])]
    )
    lines = [",".join(["sample", *motors, *known, *spread])]
    for k, name in enumerate(angles.samples):
        cells = [*angles.known_position[k]]
        cells += [] if angles.known_sigma is None else [*angles.known_sigma[k]]
        axes = [*angles.coordinates_known[k]] * 2
        words = [repr(float(v)) if there else "" for v, there in zip(cells, axes, strict=False)]
        lines.append(",".join([name, *(repr(float(v)) for v in measured[k]), *words]))
    with replacing(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


class _AngleReader:
    """The columns of a file, and what was read of them."""

    def __init__(self, header: Sequence[str]) -> None:
        self.faults: list[str] = []
        self._width = len(header)
        self._sample = header.index("sample") if "sample" in header else -1
        self._motors: list[_Column] = []
        self._known: dict[str, _Column] = {}
        self._sigma: dict[str, _Column] = {}
        self._forces: list[_Column] = []
        for index, title in enumerate(header):
            self._add(index, title)
        self._check(header)
        self._names: list[tuple[int, str]] = []
        self._angle: list[list[float]] = []
        self._force: list[list[float]] = []
        self._position: list[list[float]] = []
        self._spread: list[list[float]] = []

    def _add(self, index: int, title: str) -> None:
        """Take one column, or say that its name means nothing."""
        motor, known = _MOTOR_COLUMN.fullmatch(title), _KNOWN_COLUMN.fullmatch(title)
        if motor:
            self._motors.append(_Column(index, motor["cable"], _UNIT_FACTORS[motor["unit"]]))
        elif known:
            place = self._sigma if known["sigma"] else self._known
            if known["axis"] in place:
                self.faults.append(f"column {title}: the same coordinate comes twice")
            place[known["axis"]] = _Column(index, title, _UNIT_FACTORS[known["unit"]])
        elif force := _FORCE_COLUMN.fullmatch(title):
            self._forces.append(_Column(index, force["cable"], 1.0))
        elif title != "sample":
            self.faults.append(f"column {title!r}: unknown; allowed: {COLUMNS_ALLOWED}")

    def _check(self, header: Sequence[str]) -> None:
        """Find columns that are missing or double."""
        if self._sample < 0:
            self.faults.append("column sample: missing; allowed: a name for each sample")
        if not self._motors:
            self.faults.append("no motor angles; allowed: columns such as motor_a_deg")
        names = [column.name for column in self._motors]
        forces = [column.name for column in self._forces]
        if forces and sorted(forces) != sorted(names):
            self.faults.append(f"forces of {forces}; allowed: one of each motor, or none at all")
        for name in doubles(names):
            self.faults.append(f"motor {name}: two columns; allowed: one per motor")
        alone = [axis for axis in self._sigma if axis not in self._known]
        gone = [axis for axis in self._known if self._sigma and axis not in self._sigma]
        for what, axes in (("known", alone), ("known_sigma", gone)):
            if axes:
                columns = ", ".join(f"{what}_{axis}_mm" for axis in axes)
                allowed = "known and known_sigma of the same axes"
                self.faults.append(f"column {columns}: missing; allowed: {allowed}")

    def read(self, lines: Sequence[tuple[int, list[str]]]) -> list[str]:
        """Read all samples; returns the faults, by line."""
        faults: list[str] = []
        for number, cells in lines:
            if len(cells) != self._width:
                faults.append(
                    f"line {number}: got {len(cells)} cells; allowed: {self._width}, as in the "
                    "header (is the file cut?)"
                )
                continue
            self._names.append((number, cells[self._sample]))
            self._angle.append([self._number(c, cells, number, faults) for c in self._motors])
            by_name = {column.name: column for column in self._forces}
            forces = [by_name[motor.name] for motor in self._motors] if by_name else []
            self._force.append([self._number(c, cells, number, faults) for c in forces])
            if self._force[-1] and min(self._force[-1]) < 0.0:
                faults.append(f"line {number}: force: got < 0; allowed: >= 0")
            self._place(cells, number, faults)
        seen: dict[str, int] = {}
        for number, name in self._names:
            if not name or name in seen:
                before = f", as on line {seen[name]}" if name else ""
                faults.append(f"line {number}: sample: got {name!r}{before}; allowed: a new name")
            seen.setdefault(name, number)
        return faults

    def _number(self, column: _Column, cells: list[str], line: int, faults: list[str]) -> float:
        """Read one number in SI units."""
        try:
            value = float(cells[column.index]) * column.factor
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            faults.append(
                f"line {line}: {column.name}: got {cells[column.index]!r}; allowed: a number"
            )
        return value

    def _place(self, cells: list[str], line: int, faults: list[str]) -> None:
        """Read known coordinates, if there are any."""
        self._position.append([math.nan] * 3)
        self._spread.append([math.nan] * 3)
        for k, axis in enumerate("xyz"):
            column = self._known.get(axis)
            if column is None or not cells[column.index]:
                continue
            self._position[-1][k] = self._number(column, cells, line, faults)
            if self._sigma:
                spread = self._sigma[axis]
                self._spread[-1][k] = self._number(spread, cells, line, faults)
                if self._spread[-1][k] <= 0.0:
                    faults.append(f"line {line}: {spread.name}: got <= 0; allowed: > 0")

    def result(self) -> MotorAngles:
        """Return the motor angles."""
        position: Array = np.array(self._position)
        spread: Array = np.array(self._spread)
        return MotorAngles(
            samples=tuple(name for _, name in self._names),
            cables=tuple(column.name for column in self._motors),
            motor_angle=np.array(self._angle),
            known_position=np.nan_to_num(position),
            is_known=np.asarray(np.isfinite(position).any(axis=1)),
            known_sigma=np.nan_to_num(spread) if self._sigma else None,
            known_axes=np.isfinite(position),
            tension=np.array(self._force) if self._forces else None,
        )
