"""The highest value of a function that is smooth between breaks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from carosac_toolkit.base.arrays import Array

GRID_SAMPLES_MAX = 200_000  # of all pieces, where these are many and short
PIECE_SAMPLES_MIN = 8
PIECE_SAMPLES = 64  # per smooth piece: |v|^2 of a septic polynomial has at most six maxima there
PEAK_CANDIDATES = 16
REFINEMENT_ROUNDS = 5
REFINEMENT_SAMPLES = 17


def highest(measure: Callable[[Array], Array], breaks: Array) -> tuple[float, float]:
    """Find the global maximum by dense sampling, then by narrowing around the best samples.

    Args:
        measure: From times (K,) to values (K,).
        breaks: Times at which smooth pieces meet, shape (S + 1,).

    Returns:
        The maximum, and the time where it is. A smooth maximum is found to about 1e-12 relative.
    """
    count = min(PIECE_SAMPLES, max(PIECE_SAMPLES_MIN, GRID_SAMPLES_MAX // (len(breaks) - 1)))
    fraction = np.arange(count) / count
    grid = breaks[:-1, None] + np.diff(breaks)[:, None] * fraction
    grid = np.append(grid.ravel(), breaks[-1])
    values = measure(grid)
    padded = np.concatenate([[-np.inf], values, [-np.inf]])
    peaks = np.flatnonzero((values >= padded[:-2]) & (values >= padded[2:]))
    peaks = peaks[np.argsort(values[peaks])[::-1][:PEAK_CANDIDATES]]
    low, high = grid[np.maximum(peaks - 1, 0)], grid[np.minimum(peaks + 1, len(grid) - 1)]
    best, where = float(values.max()), float(grid[int(np.argmax(values))])
    for _ in range(REFINEMENT_ROUNDS):
        fine = np.linspace(low, high, REFINEMENT_SAMPLES, axis=1)  # (C, REFINEMENT_SAMPLES)
        values = measure(fine.ravel()).reshape(fine.shape)
        top = np.argmax(values, axis=1)
        rows = np.arange(len(fine))
        winner = int(np.argmax(values[rows, top]))
        if values[winner, top[winner]] > best:
            best, where = float(values[winner, top[winner]]), float(fine[winner, top[winner]])
        low, high = (
            fine[rows, np.maximum(top - 1, 0)],
            fine[rows, np.minimum(top + 1, REFINEMENT_SAMPLES - 1)],
        )
    return best, where
