"""Conditions of one's own, in YAML (schema ``carosac-condition/1``)."""

from __future__ import annotations

import hashlib
import math
import re
from dataclasses import fields
from pathlib import Path
from typing import Any

from carosac_toolkit.base.errors import InvalidField, InvalidFile, MissingFile, did_you_mean
from carosac_toolkit.base.units import InvalidQuantity, parse_quantity
from carosac_toolkit.robot.perturbations import CONDITIONS_BY_NAME, Condition
from carosac_toolkit.robot.sizes import SIZES, Part

CONDITION_SCHEMA = "carosac-condition/1"
UNITS = {  # of the fields that are no shares
    "center_of_mass": "m", "exit_points": "m", "anchor_points": "m", "wind_force": "N",
    "wind_time": "s",
}  # fmt: skip
_SUFFIXES = (".yaml", ".yml")
_NUMBER = r"(?P<number>\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+)"
_SHARE = re.compile(rf"\s*{_NUMBER}\s*%\s*")
_FACTOR = re.compile(rf"\s*factor\s+{_NUMBER}\s*")
_PART = re.compile(rf"\s*{_NUMBER}\s*(?P<percent>%?)\s*of\s+(?P<size>\w+)\s*")


def find_condition(name: str) -> Condition:
    """Return a condition by its name, or from a file.

    Args:
        name: One of `CONDITIONS_BY_NAME`, or the path of a YAML file.

    Raises:
        InvalidField: There is none of that name.
        MissingFile: There is no such file.
        InvalidFile: All faults of the file.
    """
    if is_condition_file(name):
        return read_condition(condition_text(name), name)
    if name not in CONDITIONS_BY_NAME:
        known = sorted(CONDITIONS_BY_NAME)
        allowed = f"one of {known}, or a path to a .yaml file{did_you_mean(name, known)}"
        raise InvalidField("condition", repr(name), allowed)
    return CONDITIONS_BY_NAME[name]


def is_condition_file(name: str) -> bool:
    """Return True for the path of a file, False for the name of a condition."""
    return name.endswith(_SUFFIXES) or "/" in name or "\\" in name


def condition_digest(name: str) -> str | None:
    """Return sixteen hexadecimal digits of a file, or None for a condition of the toolkit."""
    if not is_condition_file(name):
        return None
    return hashlib.sha256(condition_text(name).encode()).hexdigest()[:16]


def condition_text(name: str) -> str:
    """Return the text of a file."""
    path = Path(name)
    if not path.exists():
        raise MissingFile(path, f"conditions of the toolkit are {sorted(CONDITIONS_BY_NAME)}")
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InvalidFile(path, [f"not UTF-8 text (byte {error.start})"]) from error
    except OSError as error:
        raise InvalidFile(path, [f"cannot be read: {error.strerror}"]) from error


def read_condition(text: str, path: str | Path) -> Condition:
    """Return the condition of a text.

    Args:
        text: YAML.
        path: Where it is from, for messages.

    Raises:
        InvalidFile: All faults.
    """
    from carosac_toolkit.base.yaml import read_yaml

    document = read_yaml(text)
    faults = list(document.faults)
    data = document.data if isinstance(document.data, dict) else {}
    if not faults and data.get("schema") != CONDITION_SCHEMA:
        found = InvalidField("schema", repr(data.get("schema")), CONDITION_SCHEMA)
        raise InvalidFile(path, [f"line {document.line(('schema',))}: {found}"])
    known = [item.name for item in fields(Condition)]
    values: dict[str, Any] = {}
    for name, value in data.items():
        try:
            if name == "schema" or (name == "description" and isinstance(value, str)):
                continue
            if name not in known:
                allowed = f"one of {[*known, 'description']}{did_you_mean(name, known)}"
                raise InvalidField(name, "a field", allowed)
            values[name] = _quantity(name, value) if name in UNITS else _share(name, value)
        except InvalidField as error:
            faults.append((document.line((name,)), str(error)))
    time = values.get("wind_time")
    if not faults and (time.amount if isinstance(time, Part) else time) == 0.0:
        fault = str(InvalidField("wind_time", "0.0 s", "wind_time > 0"))
        faults.append((document.line(("wind_time",)), fault))
    if faults:
        raise InvalidFile(path, [f"line {line}: {fault}" for line, fault in sorted(faults)])
    return Condition(**values)


def _share(name: str, value: Any) -> float:
    """Return a standard deviation of a logarithm, from ``3 %``, ``0.03`` or ``factor 1.5``."""
    text = value if isinstance(value, str) else ""
    share, factor = _SHARE.fullmatch(text), _FACTOR.fullmatch(text)
    if share is not None and math.isfinite(float(share["number"])):
        return 0.01 * float(share["number"])
    if factor is not None and 1.0 <= float(factor["number"]) < math.inf:
        return math.log(float(factor["number"]))
    if isinstance(value, int | float) and not isinstance(value, bool) and 0.0 <= value < math.inf:
        return float(value)
    raise InvalidField(name, repr(value), "a share >= 0, such as 3 %, 0.03 or factor 1.5")


def _quantity(name: str, value: Any) -> float | Part:
    """Return a quantity with its unit, or a part of a size of the robot."""
    unit = UNITS[name]
    sizes = [size for size, (of, _) in SIZES.items() if of == unit]
    allowed = f"a quantity such as 5 {unit}, or a part of the robot such as 0.1 % of {sizes[0]}"
    part = _PART.fullmatch(value) if isinstance(value, str) else None
    if part is not None:
        if part["size"] not in sizes:
            raise InvalidField(name, repr(value), f"a part of one of {sizes}")
        amount = float(part["number"]) * (0.01 if part["percent"] else 1.0)
        if not math.isfinite(amount):
            raise InvalidField(name, repr(value), f"{allowed}; finite")
        return Part(amount, part["size"])
    try:
        number = parse_quantity(value, unit)
    except InvalidQuantity as error:
        raise InvalidField(name, repr(value), f"{allowed}; {error.allowed}") from error
    if not 0.0 <= number < math.inf:
        raise InvalidField(name, f"{value}", f"{allowed}; >= 0")
    return number
