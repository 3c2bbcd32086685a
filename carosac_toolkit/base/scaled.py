"""Numbers that grow with a robot: defaults stated at one size, for robots of every size.

A force in newtons, a distance in metres or a time in seconds that is right for one robot is wrong
for another. Such a default is a `Scaled` number: its value on the robot ``carosac``, and its unit.
For another robot it follows by Froude's law, under which the physics of cables and platforms stays
the same: a quantity of unit kg^a m^b s^c is larger by ``mass^a length^b time^c``, the ratios of
mass, length and ``sqrt(length / gravity)`` of the robots (`carosac_toolkit.physics.scales`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any, NamedTuple, NoReturn, TypeVar

from carosac_toolkit.base.errors import InvalidField

T = TypeVar("T")
_BASE_UNITS: Mapping[str, tuple[float, float, float]] = {  # exponents of kg, m, s
    "kg": (1, 0, 0), "m": (0, 1, 0), "s": (0, 0, 1), "rad": (0, 0, 0), "1": (0, 0, 0),
    "N": (1, 1, -2), "Hz": (0, 0, -1),
}  # fmt: skip
_FACTOR = re.compile(r"(?:sqrt\((?P<root>\w+)\)|(?P<name>[A-Za-z1]+))(?:\^(?P<power>\d+))?")


class Ratios(NamedTuple):
    """Mass, length and time of a robot over those of ``carosac``."""

    mass: float
    length: float
    time: float

    def of_unit(self, unit: str) -> float:
        """Return by how much a quantity of a unit is larger."""
        mass, length, time = exponents(unit)
        return float(self.mass**mass * self.length**length * self.time**time)


class Scaled(float):
    """A default for the robot ``carosac``, to be scaled to the robot at hand.

    It compares and prints as a number. It cannot be calculated with before `of` or `resolved` have
    turned it into the number of a robot, so that none is forgotten.

    Attributes:
        unit: Such as ``m/s^2`` or ``m/sqrt(s)``.
        least: What it never falls below, as what sensors resolve does not shrink with a robot.
        most: What it never exceeds, as what people stand beside does not grow with one.
    """

    unit: str
    least: float
    most: float
    __array_ufunc__ = None  # numpy leaves it to us, to refuse

    def __new__(
        cls, value: float, unit: str, *, least: float = 0.0, most: float = math.inf
    ) -> Scaled:
        """Take a value on ``carosac``, its unit and its bounds."""
        exponents(unit)
        number = super().__new__(cls, value)
        number.unit, number.least, number.most = unit, least, most
        return number

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what copies and other processes make one from."""
        return _scaled, (float(self), self.unit, self.least, self.most)

    def of(self, ratios: Ratios) -> float:
        """Return the number for a robot."""
        return min(max(float(self) * ratios.of_unit(self.unit), self.least), self.most)

    def _refused(self, *_: object) -> NoReturn:
        raise TypeError(f"{float(self)} {self.unit} on carosac: use `of` or `resolved` first")

    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = _refused
    __truediv__ = __rtruediv__ = __pow__ = __rpow__ = __neg__ = __mod__ = __rmod__ = _refused
    __floordiv__ = __rfloordiv__ = __divmod__ = __rdivmod__ = __abs__ = __round__ = _refused


def _scaled(value: float, unit: str, least: float, most: float) -> Scaled:
    """Make one again."""
    return Scaled(value, unit, least=least, most=most)


def exponents(unit: str) -> tuple[float, float, float]:
    """Return the exponents of kg, m and s of a unit such as ``N m``, ``1/m^2`` or ``m/sqrt(s)``.

    Raises:
        InvalidField: It has a part that is not known.
    """
    total = [0.0, 0.0, 0.0]
    for index, group in enumerate(unit.split("/")):
        for word in group.replace("*", " ").split():
            found = _FACTOR.fullmatch(word)
            name = (found["root"] or found["name"]) if found else ""
            if found is None or name not in _BASE_UNITS:
                raise InvalidField("unit", repr(unit), f"products of {sorted(_BASE_UNITS)}")
            power = float(found["power"] or 1) * (0.5 if found["root"] else 1.0)
            sign = power if index == 0 else -power
            total = [a + sign * b for a, b in zip(total, _BASE_UNITS[name], strict=True)]
    return (total[0], total[1], total[2])


def resolved(settings: T, ratios: Ratios) -> T:
    """Return settings in which every `Scaled` number is that of a robot.

    Args:
        settings: A dataclass; those inside it, and numbers in tuples, are resolved too.
        ratios: Of the robot.
    """
    changed = {}
    for item in fields(settings):  # type: ignore[arg-type]
        value = getattr(settings, item.name)
        new = _resolved_value(value, ratios)
        if new is not value:
            changed[item.name] = new
    return replace(settings, **changed) if changed else settings  # type: ignore[type-var]


def _resolved_value(value: Any, ratios: Ratios) -> Any:
    """Return a value of a field for a robot; the value itself where nothing scales."""
    if isinstance(value, Scaled):
        return value.of(ratios)
    if is_dataclass(value) and not isinstance(value, type):
        return resolved(value, ratios)
    if isinstance(value, tuple) and any(isinstance(x, Scaled) for x in value):
        return tuple(_resolved_value(x, ratios) for x in value)
    return value
