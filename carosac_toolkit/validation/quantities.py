"""Lengths in the unit that fits their size."""

from __future__ import annotations

LENGTH_UNITS = ((10.0, "m", 1.0), (1e-4, "mm", 1e3), (1e-7, "um", 1e6), (0.0, "nm", 1e9))
LENGTH_RESOLUTION_M = 1e-7  # [m]: no recording is as exact, so smaller lengths are not told apart


def unit_for(size: float) -> tuple[str, float]:
    """Choose the unit that suits lengths up to `size` [m], and how many of it make a metre."""
    if not size > 0.0:
        return "mm", 1e3
    return next((name, factor) for least, name, factor in LENGTH_UNITS if size >= least)


def say_length(metres: float) -> str:
    """Format a length with its unit: ``13.6 mm``, ``0.25 mm``, ``4.0 um``, ``< 0.1 um``."""
    size = abs(metres)
    if size < LENGTH_RESOLUTION_M:
        return "0" if size == 0.0 else "< 0.1 um"
    unit, factor = unit_for(size)
    return f"{metres * factor:.{2 if size < 1e-3 and unit == 'mm' else 1}f} {unit}"
