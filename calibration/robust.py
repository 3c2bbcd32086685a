"""Robust weights and scales that all calibrations share.

A weight multiplies the square of a residual; a loss takes the place of that square in the cost.

References:
    Huber and Ronchetti, *Robust Statistics*, 2nd edition, Wiley, 2009. Yang, Antonante, Tzoumas,
    Carlone, *Graduated Non-Convexity for Robust Spatial Perception*, RA-L, 2020.
"""

from __future__ import annotations

import numpy as np

from carosac_toolkit.base.arrays import Array

NORMAL_MEDIAN = 0.6745  # median size of a standard normal variable
MAD_FACTOR = 1.4826  # its inverse: standard deviation of normal values over their median size


def cauchy(square: Array, knee: float) -> tuple[Array, Array]:
    """Return Cauchy's weights and losses of squared residuals.

    Args:
        square: Squared residuals in standard deviations, any shape.
        knee: Square at which the weight is one half.
    """
    return 1.0 / (1.0 + square / knee), knee * np.log1p(square / knee)


def pseudo_huber(residual: Array, knee: Array | float) -> tuple[Array, Array]:
    """Return weights and losses that grow as a square below the knee and linearly above it.

    Args:
        residual: Any shape.
        knee: Size in units of the residual that broadcasts to it; losses are squares of knees.
    """
    root = np.sqrt(1.0 + (residual / knee) ** 2)
    return 1.0 / root, 2.0 * (root - 1.0)


def truncated(residual: Array, cut: float, convexity: float) -> Array:
    """Return weights of truncated least squares in graduated non-convexity.

    Args:
        residual: Whitened residuals, any shape.
        cut: Residual from which the truncated cost is constant.
        convexity: Mu of Yang et al.: 0 makes all weights equal, infinity 0 or 1.
    """
    size = np.maximum(np.abs(residual), 1e-12)
    between = np.sqrt(cut**2 * convexity * (convexity + 1.0)) / size - convexity
    return np.asarray(np.clip(between, 0.0, 1.0))
