"""Vector algebra that several calibrations share."""

from __future__ import annotations

import numpy as np

from carosac_toolkit.base.arrays import Array


def cross_matrix(vector: Array) -> Array:
    """Return the matrices of the cross product with vectors (..., 3), shape (..., 3, 3)."""
    matrix = np.zeros((*vector.shape, 3))
    matrix[..., 0, 1], matrix[..., 0, 2] = -vector[..., 2], vector[..., 1]
    matrix[..., 1, 0], matrix[..., 1, 2] = vector[..., 2], -vector[..., 0]
    matrix[..., 2, 0], matrix[..., 2, 1] = -vector[..., 1], vector[..., 0]
    return matrix
