"""Units of drawn lengths."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.validation.quantities import unit_for

METRES_FROM_M = 2.0  # [m]: axes that reach farther are in metres


def unit_of(lengths: Iterable[Array]) -> tuple[str, float]:
    """Choose the unit for the largest of some lengths [m], and how many of it make a metre.

    Args:
        lengths: Arrays of any shape; values that are not finite do not count.
    """
    sizes = [np.abs(values[np.isfinite(values)]) for values in lengths]
    largest = max((float(size.max()) for size in sizes if size.size), default=0.0)
    return ("m", 1.0) if largest >= METRES_FROM_M else unit_for(largest)
