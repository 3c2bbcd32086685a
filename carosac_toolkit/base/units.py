"""A small fixed table of units: ``10.55 g/m`` in a file becomes 0.01055 kg/m.

A bare number is SI. Inside the toolkit everything is SI; units live at the edge, in files.
"""

from __future__ import annotations

import difflib
import math
import re

from carosac_toolkit.base.errors import CarosacError

_UNIT_TABLE: dict[str, tuple[str, dict[str, float]]] = {
    "m": ("length", {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "km": 1e3}),
    "m^2": ("area or variance", {"mm^2": 1e-6, "cm^2": 1e-4, "m^2": 1.0}),
    "kg": ("mass", {"g": 1e-3, "kg": 1.0, "t": 1e3}),
    "kg/m": ("linear density", {"g/km": 1e-6, "g/m": 1e-3, "kg/km": 1e-3, "kg/m": 1.0}),
    "kg/m^3": ("density", {"kg/m^3": 1.0, "g/cm^3": 1e3}),
    "kg*m^2": (
        "inertia",
        {
            "g*mm^2": 1e-9,
            "g*cm^2": 1e-7,
            "kg*mm^2": 1e-6,
            "kg*cm^2": 1e-4,
            "g*m^2": 1e-3,
            "kg*m^2": 1.0,
        },
    ),
    "N": ("force", {"mN": 1e-3, "N": 1.0, "kN": 1e3, "MN": 1e6}),
    "N/m": ("force per length", {"N/m": 1.0, "N/mm": 1e3, "kN/m": 1e3}),
    "Pa": ("stress", {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "N/mm^2": 1e6, "GPa": 1e9}),
    "rad": ("angle", {"deg": math.pi / 180.0, "rad": 1.0}),
    "s": ("time", {"us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0}),
    "Hz": ("frequency", {"Hz": 1.0, "kHz": 1e3}),
    "1/s": ("rate", {"1/s": 1.0}),
    "m/s": ("speed", {"mm/s": 1e-3, "m/s": 1.0, "m/min": 1.0 / 60.0}),
    "m/s^2": ("acceleration", {"mm/s^2": 1e-3, "m/s^2": 1.0}),
    "m/s^2/sqrt(Hz)": ("acceleration density", {"mm/s^2/sqrt(Hz)": 1e-3, "m/s^2/sqrt(Hz)": 1.0}),
    "rad/s": ("angular speed", {"deg/s": math.pi / 180.0, "rad/s": 1.0}),
    "N*s": ("damping force per strain rate", {"N*s": 1.0, "kN*s": 1e3}),
    "N*s/m": ("damping", {"N*s/m": 1.0, "kN*s/m": 1e3}),
    "N*m": ("moment", {"N*mm": 1e-3, "N*m": 1.0, "kN*m": 1e3}),
    "N*m*s/rad": ("angular damping", {"N*m*s/rad": 1.0, "N*m*s": 1.0}),
    "1": ("pure number", {}),
}
_KIND_OF_UNIT = {name: kind for kind, units in _UNIT_TABLE.values() for name in units}
_QUANTITY_PATTERN = re.compile(
    r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?:\s+(.*?)|(\D.*?))?\s*"
)
_DECIMAL_COMMA_PATTERN = re.compile(r"\s*[+-]?\d+,\d")
_UNIT_SPELLINGS = str.maketrans({"·": "*", "⋅": "*", "²": "^2", "³": "^3", "µ": "u"})


class InvalidQuantity(CarosacError, ValueError):
    """A value that is no number in a unit of the right kind.

    Attributes:
        value: The value as the user wrote it.
        allowed: Accepted values.
    """

    def __init__(self, value: object, allowed: str) -> None:
        super().__init__(f"got {value!r}; allowed: {allowed}")
        self.value = value
        self.allowed = allowed


def describe(unit: str) -> str:
    """Describe the values of a field in this SI unit: ``a length in m (or mm, cm, km)``."""
    kind, units = _UNIT_TABLE[unit]
    article = "an" if kind[0] in "aeiou" else "a"
    others = [name for name in units if name != unit]
    if unit == "1":
        return f"{article} {kind}"
    return f"{article} {kind} in {unit}" + (f" (or {', '.join(others)})" if others else "")


def parse_quantity(value: object, unit: str) -> float:
    """Read a bare SI number, or a number with a unit of the same kind.

    Args:
        value: ``0.01055``, ``"1e5"`` or ``"10.55 g/m"``.
        unit: SI unit of the result, a key of the table; ``"1"`` for a pure number.

    Returns:
        The number in `unit`.

    Raises:
        InvalidQuantity: No finite number, an unknown unit (with the nearest one that fits), or a
            unit of another kind.
    """
    if isinstance(value, int | float) and not isinstance(value, bool):
        number, suffix = float(value), ""
    else:
        if isinstance(value, str) and _DECIMAL_COMMA_PATTERN.match(value):
            raise InvalidQuantity(value, f"{describe(unit)}; the decimal sign is a point")
        match = _QUANTITY_PATTERN.fullmatch(value) if isinstance(value, str) else None
        if match is None:
            raise InvalidQuantity(value, describe(unit))
        number, suffix = float(match[1]), match[2] or match[3] or ""
    if not math.isfinite(number):
        raise InvalidQuantity(value, f"{describe(unit)}, finite")
    return number * _factor(value, suffix, unit)


def is_quantity(value: object) -> bool:
    """Return True if a value of a file is a number, with or without a unit."""
    if isinstance(value, bool):
        return False
    return isinstance(value, int | float) or (
        isinstance(value, str) and _QUANTITY_PATTERN.fullmatch(value) is not None
    )


def _factor(value: object, suffix: str, unit: str) -> float:
    """Find the factor from the written unit to the SI unit."""
    units = _UNIT_TABLE[unit][1]
    written = _normal(suffix)
    if not written:
        return 1.0
    if written in units:
        return units[written]
    if written in _KIND_OF_UNIT:
        kind = _KIND_OF_UNIT[written]
        article = "an" if kind[0] in "aeiou" else "a"
        raise InvalidQuantity(value, f"{describe(unit)}; {written} is {article} {kind}")
    near = _nearest(written, units)
    raise InvalidQuantity(value, describe(unit) + (f"; did you mean {near}" if near else ""))


def _normal(suffix: str) -> str:
    """Bring the spelling of a unit to that of the table: ``N s/m`` and ``N·s/m`` are one."""
    text = suffix.strip().replace("°", "deg").translate(_UNIT_SPELLINGS).replace("**", "^")
    text = re.sub(r"\s*([*/^])\s*", r"\1", text)
    return re.sub(r"\s+", "*", text)


def _nearest(written: str, units: dict[str, float]) -> str | None:
    """Find the unit that was meant: equal but for case, else the most similar one."""
    for name in units:
        if name.casefold() == written.casefold():
            return name
    near = difflib.get_close_matches(written, units, n=1, cutoff=0.6)
    return near[0] if near else None
