"""Readers of the single fields of a robot file: from YAML values to SI numbers."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.terminal import has_control_characters
from carosac_toolkit.base.units import InvalidQuantity, describe, parse_quantity
from carosac_toolkit.robot.hardware import NET_ID_PATTERN, PORT_MAX

NET_ID_TEXT = "six numbers from 0 to 255 separated by dots, such as 192.168.0.10.1.1"
PORT_TEXT = f"a whole number, 1 to {PORT_MAX}"
SIGN_TEXT = "1 or -1"
NAME_TEXT = "a name on one line, without control characters"

Reader = Callable[[object], object]

INERTIA_TEXT = (
    "3 numbers (diagonal) or a 3x3 matrix about the body's own centre of mass, in axes of the "
    f"platform, each {describe('kg*m^2')}"
)
SPREAD_TEXT = f"{describe('m')}, > 0, or a list of 3 of them (x, y, z)"
COVARIANCE_TEXT = f"a symmetric positive semidefinite 3x3 matrix, each {describe('m^2')}"


class FieldFault(InvalidField, ValueError):
    """A fault of one field that only its neighbours reveal."""


def quantity_reader(unit: str, bound: str = "", most: float = math.inf) -> tuple[Reader, str]:
    """Make the reader of a number and the text of its allowed values.

    Args:
        unit: SI unit of the number.
        bound: ``> 0``, ``>= 0`` or nothing.
        most: Largest one.
    """
    allowed = describe(unit) + (f", {bound}" if bound else "")
    allowed += f", <= {most:g}" if math.isfinite(most) else ""

    def read(value: object) -> float:
        number = parse_quantity(value, unit)
        low = (bound == "> 0" and not number > 0.0) or (bound == ">= 0" and not number >= 0.0)
        if low or number > most:
            raise InvalidQuantity(value, allowed)
        return number

    return read, allowed


def list_reader(unit: str, count: int, meaning: str = "") -> tuple[Reader, str]:
    """Make a reader that only checks for a list of `count` entries, and the text of its fault."""
    allowed = f"a list of {count} numbers{' ' + meaning if meaning else ''}, each {describe(unit)}"

    def read(value: object) -> object:
        if not isinstance(value, list) or len(value) != count:
            raise InvalidQuantity(value, allowed)
        return value

    return read, allowed


def unit_length_reader(count: int, meaning: str) -> tuple[Reader, str]:
    """Make the reader of a direction or quaternion; it may be rounded in the fourth digit."""
    allowed = f"a list of {count} pure numbers {meaning} of length 1"

    def read(value: object) -> list[float]:
        if not isinstance(value, list) or len(value) != count:
            raise InvalidQuantity(value, allowed)
        numbers = [parse_quantity(entry, "1") for entry in value]
        length = float(np.linalg.norm(numbers))
        if abs(length - 1.0) > 1e-3:
            raise InvalidQuantity(value, f"{allowed}; its length is {length:.6g}")
        return [number / length for number in numbers]

    return read, allowed


def read_inertia(value: object) -> list[list[float]]:
    """Read an inertia of 3 numbers or 3x3 numbers that a real body can have [kg m^2]."""
    rows = value if isinstance(value, list) else []
    if len(rows) == 3 and not any(isinstance(row, list) for row in rows):
        rows = [[row if i == j else 0.0 for j in range(3)] for i, row in enumerate(rows)]
    matrix = _square(value, rows, "kg*m^2", INERTIA_TEXT)
    moments = np.linalg.eigvalsh(matrix)
    if not np.allclose(matrix, matrix.T, rtol=1e-9, atol=1e-12):
        raise InvalidQuantity(value, "a symmetric matrix")
    if moments[0] <= 0.0:
        raise InvalidQuantity(
            value, f"a positive definite inertia; its smallest moment is {moments[0]:.4g} kg*m^2"
        )
    if moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-9):
        raise InvalidQuantity(
            value,
            "principal moments that fulfil I_max <= sum of the other two; they are "
            + ", ".join(f"{moment:.4g}" for moment in moments),
        )
    return [[float(entry) for entry in row] for row in matrix]


def read_spread(value: object) -> list[float]:
    """Read standard deviations [m]: one number for all axes, or three."""
    entries = value if isinstance(value, list) else [value] * 3
    numbers = [parse_quantity(entry, "m") for entry in entries]
    if len(numbers) != 3 or min(numbers) <= 0.0:
        raise InvalidQuantity(value, SPREAD_TEXT)
    return numbers


def read_covariance(value: object) -> list[list[float]]:
    """Read a 3x3 covariance [m^2]."""
    matrix = _square(value, value if isinstance(value, list) else [], "m^2", COVARIANCE_TEXT)
    symmetric = np.allclose(matrix, matrix.T, rtol=1e-9, atol=1e-15)
    if not symmetric or np.linalg.eigvalsh(matrix)[0] < -1e-15:
        raise InvalidQuantity(value, COVARIANCE_TEXT)
    return [[float(entry) for entry in row] for row in matrix]


def read_text(value: object) -> str:
    """Read a non-empty text; a bare number is a valid name."""
    if isinstance(value, bool | list | dict) or value is None or not str(value).strip():
        raise InvalidQuantity(value, "a non-empty text")
    return f"{value:g}" if isinstance(value, float) else str(value).strip()


def read_name(value: object) -> str:
    """Read a text that may be printed in the middle of a line."""
    name = read_text(value)
    if has_control_characters(name):
        raise InvalidQuantity(name, NAME_TEXT)
    return name


def read_port(value: object) -> int:
    """Read a port number."""
    number = float(value) if isinstance(value, int | float) else 0.0
    if isinstance(value, bool) or number != round(number) or not 1 <= number <= PORT_MAX:
        raise InvalidQuantity(value, PORT_TEXT)
    return round(number)


def read_sign(value: object) -> float:
    """Read 1 or -1."""
    if isinstance(value, bool) or value not in (1, -1):
        raise InvalidQuantity(value, SIGN_TEXT)
    return float(str(value))


def read_net_id(value: object) -> str:
    """Read an AMS net id."""
    text = str(value).strip()
    if not NET_ID_PATTERN.fullmatch(text) or max(int(part) for part in text.split(".")) > 255:
        raise InvalidQuantity(value, NET_ID_TEXT)
    return text


def _square(value: object, rows: list[object], unit: str, allowed: str) -> Array:
    """Read a 3x3 matrix of numbers."""
    if len(rows) != 3 or not all(isinstance(row, list) and len(row) == 3 for row in rows):
        raise InvalidQuantity(value, allowed)
    entries = [[parse_quantity(x, unit) for x in row] for row in rows if isinstance(row, list)]
    return np.array(entries, dtype=np.float64)
