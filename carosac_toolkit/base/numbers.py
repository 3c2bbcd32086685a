"""Range checks of settings with field, value and allowed values in messages; numbers as text."""

from __future__ import annotations

import sys
from collections.abc import Iterable

import numpy as np

from carosac_toolkit.base.errors import InvalidField

FLOAT_MAX = sys.float_info.max  # a whole number may be larger


def check_positive(name: str, value: object, unit: str = "") -> None:
    """Refuse anything but a positive finite number."""
    if not is_number(value) or not 0.0 < value <= FLOAT_MAX:  # type: ignore[operator]
        raise InvalidField(name, _shown(value, unit), f"{name} > 0, finite")


def check_not_negative(name: str, value: object, unit: str = "") -> None:
    """Refuse anything but a finite number >= 0."""
    if not is_number(value) or not 0.0 <= value <= FLOAT_MAX:  # type: ignore[operator]
        raise InvalidField(name, _shown(value, unit), f"{name} >= 0, finite")


def check_fraction(name: str, value: object) -> None:
    """Refuse anything but a number between 0 and 1, both excluded."""
    if not is_number(value) or not 0.0 < value < 1.0:  # type: ignore[operator]
        raise InvalidField(name, _shown(value, ""), f"0 < {name} < 1")


def check_whole(name: str, value: object, lowest: int, highest: int | None = None) -> None:
    """Refuse anything but a whole number in a range."""
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or value < lowest or (highest is not None and value > highest):  # type: ignore[operator]
        top = "" if highest is None else f" to {highest}"
        raise InvalidField(name, repr(value), f"a whole number from {lowest}{top}")


def check_period(duration: float, period: float, whose: str) -> None:
    """Refuse to wait for another duration [s] than the period, for which limits count."""
    if not abs(duration - period) <= 1e-9 * period:
        raise InvalidField("duration", f"{duration} s", f"the {whose}'s period, {period} s")


def check_fields(
    settings: object, *, positive: Iterable[str] = (), not_negative: Iterable[str] = ()
) -> None:
    """Check fields of a settings dataclass, by name."""
    for name in positive:
        check_positive(name, getattr(settings, name))
    for name in not_negative:
        check_not_negative(name, getattr(settings, name))


def plain(value: float, digits: int) -> str:
    """Write a number with some significant digits, and its whole part in full: 15302, 0.0123.

    Args:
        value: The number; tiny ones keep an exponent.
        digits: Significant digits of numbers that have no more of them before the point.
    """
    text = f"{value:.{digits}g}"
    return f"{value:.0f}" if "e+" in text else text


def is_number(value: object) -> bool:
    """Return True for a single number; True and False are none."""
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def _shown(value: object, unit: str) -> str:
    """Format a value for a message."""
    return f"{value} {unit}".rstrip() if is_number(value) else repr(value)
