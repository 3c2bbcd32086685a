"""Test whether an estimator has learned a centre of mass, or still assumes its prior."""

from __future__ import annotations

import numpy as np

from carosac_toolkit.base.arrays import Array

LEARNED_DEVIATION_RATIO = 0.8  # to the prior: above it, measurements have hardly reduced the doubt


def learned_center_of_mass(center: Array, covariance: Array, start: float) -> Array | None:
    """Return the centre of mass, or None if nothing was learned of it.

    Args:
        center: Estimate in P [m], shape (3,).
        covariance: Covariance of the estimate [m^2], shape (3, 3).
        start: Standard deviation per axis at the start [m].

    Returns:
        The estimate, if it is better known than at the start in two of three directions: no
        measurement tells its position along the pull of the cables.
    """
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance), 0.0))
    return np.asarray(center) if spread[1] < LEARNED_DEVIATION_RATIO * start else None
