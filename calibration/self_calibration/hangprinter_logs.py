"""Motor angles as Hangprinter firmware answers them: one list in brackets for each sample.

RepRapFirmware answers ``M569.3 P40.0:41.0:42.0:43.0`` with the encoder angles [deg] since the mark
that ``M569.3 ... S`` set at the origin, such as ``[-4834.89, 7431.31, -1079.36, 1309.72]``,
positive paying line out. The scripts of hp-mark put the same into ``motor_pos_samp``, and positions
[mm] into ``xyz_of_samp``, for the first samples or all of them, nan where they are unknown. Each
list is on one line; comments after ``#``, imports and the question itself are passed over.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from calibration.self_calibration.motor_angles import MotorAngles
from carosac_toolkit.base.errors import InvalidFile
from carosac_toolkit.recordings.table import shortened

_ANGLES, _POSITIONS = "motor_pos_samp", "xyz_of_samp"
_NAME = re.compile(r"([A-Za-z_]\w*)\s*=\s*(.*)")
_AROUND_LISTS = re.compile(r"np\.array\(|numpy\.array\(|[\[\](),\s]")
_LIST = re.compile(r"\[([^\[\]]*)\]")
_ECHOES = ("import ", "from ", "M569.3 ")  # lines that a script or a console adds


def is_log(text: str) -> bool:
    """Return whether a text is one of bracketed lists rather than a table."""
    first = next((line.strip() for line in text.splitlines() if not tells_nothing(line)), "")
    return first.startswith(("[", _ANGLES, _POSITIONS))


def tells_nothing(line: str) -> bool:
    """Return whether a line is blank, a comment, or one that a script or a console adds."""
    return not line.strip() or line.strip().startswith(("#", *_ECHOES))


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
    for number, name, words in _lists(text, faults):
        is_position = name == _POSITIONS
        row = _numbers(words, number, faults, nan_allowed=is_position)
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


def _lists(text: str, faults: list[str]) -> Iterator[tuple[int, str, str]]:
    """Yield the line, the array and the content of each list; add what else there is to faults."""
    name = _ANGLES
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.split("#", 1)[0].strip()
        if tells_nothing(line):
            continue
        if named := _NAME.fullmatch(line):
            name, line = named[1], named[2]
            if name not in (_ANGLES, _POSITIONS):
                allowed = f"{_ANGLES} and {_POSITIONS}"
                faults.append(f"line {number}: got the array {name!r}; allowed: {allowed}")
        if name not in (_ANGLES, _POSITIONS):
            continue
        if _AROUND_LISTS.sub("", _LIST.sub("", line)):
            allowed = "complete lists, such as [-4834.89, 7431.31]"
            faults.append(f"line {number}: got {raw.strip()!r}; allowed: {allowed}")
            continue
        for match in _LIST.finditer(line):
            yield number, name, match[1]


def _numbers(text: str, line: int, faults: list[str], *, nan_allowed: bool) -> list[float]:
    """Read the numbers of one list, in which a comma may come last."""
    words = [part.strip() for part in text.split(",")]
    row = []
    for word in words[:-1] if not words[-1] else words:
        try:
            value = float(word.removeprefix("np."))
        except ValueError:
            value = math.inf
        if math.isinf(value) or (math.isnan(value) and not nan_allowed):
            faults.append(f"line {line}: got {word!r}; allowed: a number")
        row.append(value)
    return row
