"""Whether an estimator has found a centre of mass, or still takes one for granted."""

from __future__ import annotations

import numpy as np

from carosac_toolkit.base.arrays import Array

FOUND = 0.8  # of the deviation at the start: below it, measurements have said something


def found_center(center: Array, covariance: Array, start: float) -> Array | None:
    """The centre of mass, or None where nothing was learned of it.

    Args:
        center: Estimate in P [m], shape (3,).
        covariance: Of it, shape (3, 3).
        start: Standard deviation per axis at the start [m].

    Returns:
        The estimate, if it is known better than at the start in two of three directions: along the
        cables' pull, no platform tells.
    """
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance), 0.0))
    return np.asarray(center) if spread[1] < FOUND * start else None
