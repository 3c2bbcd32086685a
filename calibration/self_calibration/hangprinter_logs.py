"""Motor angles as Hangprinter firmware answers them: one list in brackets for each sample.

RepRapFirmware answers ``M569.3 P40.0:41.0:42.0:43.0`` with the encoder angles [deg] since the mark
that ``M569.3 ... S`` set at the origin, such as ``[-4834.89, 7431.31, -1079.36, 1309.72]``,
positive paying line out. The scripts of hp-mark put the same into ``motor_pos_samp``, and positions
[mm] into ``xyz_of_samp``, for the first samples or all of them, nan where they are unknown.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from calibration.self_calibration.motor_angles import MotorAngles
from carosac_toolkit.base.errors import InvalidFile
from carosac_toolkit.recordings.table import shortened

_ANGLES, _POSITIONS = "motor_pos_samp", "xyz_of_samp"
_NAME = re.compile(r"([A-Za-z_]\w*)\s*=\s*(.*)")
_ARRAY_ENDS = re.compile(r"np\.array\(|numpy\.array\(|[\[\](),\s]")  # around lists of numbers
_LIST = re.compile(r"\[([^\[\]]*)\]")
_ECHOES = ("import ", "from ", "M569.3 ")  # lines that a script or a console adds


def is_log(text: str) -> bool:
    """Return whether a text is one of bracketed lists rather than a table."""
    lines = [line.strip() for line in text.splitlines()]
    passed = ("#", *_ECHOES)
    first = next((line for line in lines if line and not line.startswith(passed)), "")
    return first.startswith(("[", _ANGLES, _POSITIONS))


def parse_log(path: Path, text: str) -> MotorAngles:
    """Read motor angles, and known positions if there are any.

    Args:
        path: Named in errors.
        text: Of the file.

    Raises:
        InvalidFile: With all faults that were found, by line.
    """
    faults: list[str] = []
    angles: list[list[float]] = []
    positions: list[list[float]] = []
    is_position = False
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.split("#", 1)[0].strip()
        if not line or line.startswith(_ECHOES):
            continue
        if named := _NAME.fullmatch(line):
            line, is_position = named[2], named[1] == _POSITIONS
            if named[1] not in (_ANGLES, _POSITIONS):
                allowed = f"{_ANGLES} and {_POSITIONS}"
                faults.append(f"line {number}: unknown array {named[1]!r}; allowed: {allowed}")
        if _ARRAY_ENDS.sub("", _LIST.sub("", line)) or _incomplete(line):
            allowed = "complete lists on one line each, such as [-4834.89, 7431.31]"
            faults.append(f"line {number}: got {raw.strip()!r}; allowed: {allowed}")
            continue
        for match in _LIST.finditer(line):
            row = _numbers(match[1], number, faults, nan_allowed=is_position)
            width = 3 if is_position else len(angles[0]) if angles else len(row)
            if len(row) != width or not row:
                what = "x, y, z" if is_position else f"{width} angles, as in the first list"
                faults.append(f"line {number}: got {len(row)} numbers; allowed: {what}")
            (positions if is_position else angles).append(row)
    if not angles:
        faults.append("no samples; allowed: lists of motor angles such as [-4834.89, 7431.31]")
    if len(positions) > len(angles):
        faults.append(
            f"{_POSITIONS}: got {len(positions)} lists; allowed: at most {len(angles)}, one for "
            f"each sample of {_ANGLES}"
        )
    if faults:
        raise InvalidFile(path, shortened(faults))
    place = np.full((len(angles), 3), math.nan)
    place[: len(positions)] = np.array(positions).reshape(-1, 3)
    known = np.isfinite(place)
    return MotorAngles(
        samples=tuple(str(k) for k in range(len(angles))),
        cables=tuple(f"{k + 1:02d}" for k in range(len(angles[0]))),
        motor_angle=np.radians(angles),
        known_position=1e-3 * np.nan_to_num(place),
        is_known=np.asarray(known.any(axis=1)),
        known_axes=known,
    )


def _numbers(text: str, line: int, faults: list[str], *, nan_allowed: bool) -> list[float]:
    """Read the numbers of one list, in which a comma may come last."""
    row = []
    for word in (part.strip() for part in text.split(",")):
        if not word:
            continue
        try:
            value = float(word.removeprefix("np."))
        except ValueError:
            value = math.inf
        if math.isinf(value) or (math.isnan(value) and not nan_allowed):
            faults.append(f"line {line}: got {word!r}; allowed: a number")
        row.append(value)
    return row
