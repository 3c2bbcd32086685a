"""Leica GSI-8 and GSI-16, word by word through geocompy.

Words that are read: 11 point name, 16 station name, 21 Hz, 22 V, 31 slope distance, 51 ppm and
prism constant, 58 prism constant, 81 to 83 coordinates of the target, 84 to 86 of the station, 87
target height. All others, and code blocks (41), are passed over.

geocompy drops the sign of angles and passes over words that it cannot read; both are done here.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from calibration.tachymeter.observations import face_one, polar
from calibration.tachymeter.records import (
    MILLIMETRE_M,
    LineFault,
    Record,
    plain_name,
    read_lines,
    shortened_faults,
)
from carosac_toolkit.base.errors import InvalidFile
from carosac_toolkit.base.extras import require

_ANGLE_WORDS = {21: "Hz", 22: "V"}
_LENGTH_WORDS = {
    31: "slope distance", 58: "prism constant", 81: "easting", 82: "northing", 83: "height",
    84: "station easting", 85: "station northing", 86: "station height", 87: "target height",
}  # fmt: skip
_WORD = re.compile(r"[0-9]{2}[0-9.].{3}[+-]")
_UNIT_NAMES = {
    "0": "m", "6": "m", "8": "m", "1": "ft", "7": "ft",
    "2": "gon", "3": "decimal degrees", "4": "degrees, minutes, seconds", "5": "mil",
}  # by the digit of a word  # fmt: skip
_POLAR_WORDS, _TARGET_WORDS, _STATION_WORDS = (21, 22, 31), (81, 82, 83), (84, 85, 86)


@dataclass
class _GsiReader:
    """State that carries over from line to line."""

    path: str
    setup: str
    station: tuple[float, ...] | None = None
    units: dict[str, tuple[str, int]] = field(default_factory=dict)  # by kind: unit, first line
    records: list[Record] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)


def read_gsi(path: str) -> list[Record]:
    """Read a file of one or more set-ups.

    A new set-up starts where the station changes: at a word 16 with another name, or at a block
    with station coordinates (84 to 86) and no observation.

    Args:
        path: The file.

    Returns:
        Its observations in order, in face I.

    Raises:
        MissingExtra: geocompy is not installed.
        MissingFile: There is no such file.
        InvalidFile: Names every line that cannot be read, and why.
    """
    require("reading GSI files", "geocompy")
    reader = _GsiReader(path=path, setup=Path(path).stem)
    for number, line in enumerate(read_lines(path), start=1):
        if not line.strip():
            continue
        try:
            _read_line(reader, number, line)
        except LineFault as fault:
            reader.faults.append(f"line {number}: {fault}")
    if reader.faults:
        raise InvalidFile(path, shortened_faults(reader.faults))
    if not reader.records:
        raise InvalidFile(path, ["no observations (blocks with words 21, 22 and 31, or 81 to 83)"])
    return reader.records


def _read_line(reader: _GsiReader, number: int, line: str) -> None:
    """Read one block."""
    words = _split(line)
    if words[0][:2] == "41":
        return
    if words[0][:2] != "11":
        raise LineFault(f"starts with '{words[0].strip()}'; a GSI block starts with word 11 or 41")
    name = plain_name(words[0][7:])
    values, prism = _values(reader, number, words[1:])
    station = _station_name(words[1:])
    if station is not None:
        _change_station(reader, station)
    here = (
        tuple(values[i] for i in _STATION_WORDS)
        if all(i in values for i in _STATION_WORDS)
        else None
    )
    observed = [i for i in (*_POLAR_WORDS, *_TARGET_WORDS) if i in values]
    if here is not None:
        if not observed and station is None:
            _change_station(reader, name)
        reader.station = here
    if observed:
        hz, v, distance = _polar_reading(reader, values)
        reader.records.append(
            Record(
                setup=reader.setup, point=name, hz=hz, v=v, distance=distance,
                prism_set=prism, path=reader.path, line=number,
            )
        )  # fmt: skip


def _change_station(reader: _GsiReader, name: str) -> None:
    """Begin a new set-up, if the name is new."""
    setup = f"{Path(reader.path).stem}:{name}"
    if setup != reader.setup:
        reader.setup, reader.station = setup, None


def _split(line: str) -> list[str]:
    """Split a block into its words, each with its space at the end."""
    long = line.startswith("*")
    size, kind = (24, "GSI-16") if long else (16, "GSI-8")
    text = line[long:].rstrip()
    if len(text) % size != size - 1:
        whole = len(text) // size
        raise LineFault(
            f"cut off or damaged: {len(text) - whole * size} characters after word {whole}, where "
            f"{kind} has words of {size - 1} characters and a space"
        )
    text += " "
    words = [text[i : i + size] for i in range(0, len(text), size)]
    for word in words:
        if _WORD.match(word) is None or word[-1] != " ":
            raise LineFault(f"'{word.strip()}' is no {kind} word; is the line damaged?")
    return words


def _index(word: str) -> int:
    """Return the word index, of two or three digits."""
    return int(word[:3].rstrip("."))


def _station_name(words: list[str]) -> str | None:
    """Return the word 16, if there is one."""
    names = [plain_name(word[7:]) for word in words if _index(word) == 16]
    return names[0] if names else None


def _values(
    reader: _GsiReader, number: int, words: list[str]
) -> tuple[dict[int, float], float | None]:
    """Read angles [rad], lengths [m] by word index, and the prism constant [m] of a block."""
    from geocompy.gsi.gsiformat import GsiPPMPrismConstantWord, parse_gsi_word

    values: dict[int, float] = {}
    prism = None
    for word in words:
        index = _index(word)
        if index == 51:
            prism = _parsed(word, GsiPPMPrismConstantWord.parse).value[1] * MILLIMETRE_M
            continue
        if index not in _ANGLE_WORDS and index not in _LENGTH_WORDS:
            continue
        if index in values:
            raise LineFault(f"word {index} ({_name(index)}) twice in one block")
        _check_unit(reader, number, word, index)
        value = float(_parsed(word, lambda text: parse_gsi_word(text, strict=True)).value)
        values[index] = -value if index in _ANGLE_WORDS and word[6] == "-" else value
    return values, values.get(58, prism)


def _parsed(word: str, parse: Any) -> Any:
    """Read a word with geocompy."""
    try:
        return parse(word)
    except (ValueError, IndexError) as error:
        raise LineFault(f"word {_index(word)} '{word.strip()}' cannot be read") from error


def _name(index: int) -> str:
    """Name the content of a word."""
    return _ANGLE_WORDS.get(index) or _LENGTH_WORDS[index]


def _check_unit(reader: _GsiReader, number: int, word: str, index: int) -> None:
    """Refuse a unit of the wrong kind, and another one than in the lines above."""
    kind = "angles" if index in _ANGLE_WORDS else "lengths"
    digit = word[5]
    unit = _UNIT_NAMES.get(digit)
    angular = unit is not None and unit not in ("m", "ft")
    if unit is None or angular != (kind == "angles"):
        allowed = "2 gon, 3 degrees, 4 DMS, 5 mil" if kind == "angles" else "0, 6, 8 m; 1, 7 ft"
        raise LineFault(
            f"word {index} ({_name(index)}) has unit digit '{digit}'; allowed: {allowed}"
        )
    if digit == "4" and not (word[-6] in "012345" and word[-4] in "012345"):
        raise LineFault(
            f"word {index} ({_name(index)}) '{word.strip()}': minutes or seconds over 59"
        )
    known, first = reader.units.setdefault(kind, (unit, number))
    if unit != known:
        raise LineFault(
            f"word {index} ({_name(index)}) in {unit}, but line {first} has {kind} in {known}: "
            "mixed units; export the job again with one setting, or split the file"
        )


def _polar_reading(reader: _GsiReader, values: dict[int, float]) -> tuple[float, float, float]:
    """Return the Hz, V and slope distance of a block, in face I."""
    missing = [i for i in _POLAR_WORDS if i not in values]
    if not missing:
        if values[31] <= 0.0:
            raise LineFault(f"slope distance (word 31) is {values[31]:g} m: none was measured")
        if not 0.0 < values[22] % (2.0 * np.pi) < 2.0 * np.pi or values[22] < 0.0:
            raise LineFault(f"V (word 22) is {np.rad2deg(values[22]):g} deg: no zenith angle")
        hz, v = face_one(values[21], values[22])
        return hz, v, values[31]
    if any(i in values for i in _POLAR_WORDS) and not all(i in values for i in _TARGET_WORDS):
        lost = ", ".join(f"{i} ({_name(i)})" for i in missing)
        raise LineFault(f"no word {lost}: cut off, or not exported?")
    lost_too = [f"{i} ({_name(i)})" for i in _TARGET_WORDS if i not in values]
    if lost_too:
        raise LineFault(f"no word {', '.join(lost_too)}: cut off, or not exported?")
    if reader.station is None:
        raise LineFault(
            "coordinates (81 to 83) without those of the station (84 to 86), here or above: where "
            "the instrument stood is unknown; export Hz, V and slope distance (21, 22, 31)"
        )
    place = np.array([values[i] for i in _TARGET_WORDS]) - np.array(reader.station)
    place[2] += values.get(87, 0.0)
    hz, v, distance = polar(place[None])[0]
    return float(hz), float(v), float(distance)
