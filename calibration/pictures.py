"""Pictures that all calibrations share: exit points, residuals and what was learnt."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from calibration.estimate import Estimate
from carosac_toolkit.arrays import Array
from carosac_toolkit.pictures.drawing import COLORS, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BEFORE, AFTER = "#9aa3ad", "#1f6f8b"
OUTLIER = "#c0392b"
QUANTILE_95 = 2.4477  # radius of the 95 % ellipse of two dimensions, in standard deviations
_PLANES = ((0, 1), (0, 2), (1, 2))


def draw_exit_points(
    cable_names: Sequence[str],
    before: Array,
    before_covariance: Array | None,
    after: Array,
    after_covariance: Array,
) -> Figure:
    """Draw each exit point before and after, with its 95 % ellipse in three planes.

    Args:
        cable_names: n names.
        before: In W [m], shape (n, 3).
        before_covariance: [m^2], shape (n, 3, 3), or None where nothing was known.
        after: In W [m], shape (n, 3).
        after_covariance: [m^2], shape (n, 3, 3).
    """
    n = len(cable_names)
    figure = new_figure(9.5, 1.0 + 2.7 * n)
    grid = figure.subplots(n, 3, squeeze=False)
    for i, name in enumerate(cable_names):
        for axes, plane in zip(grid[i], _PLANES, strict=True):
            rows = list(plane)
            start = (before[i] - after[i])[rows] * 1e3
            if before_covariance is not None:
                block = before_covariance[i][np.ix_(rows, rows)]
                _ellipse(axes, start, block, BEFORE, "--")
            block = after_covariance[i][np.ix_(rows, rows)]
            _ellipse(axes, np.zeros(2), block, AFTER, "-")
            axes.plot(*start, "o", color=BEFORE, ms=5, label="before")
            axes.plot(0.0, 0.0, "o", color=AFTER, ms=5, label="after")
            axes.annotate(
                "", (0.0, 0.0), tuple(start), arrowprops={"arrowstyle": "->", "color": "#707880"}
            )
            axes.set(xlabel=f"{'xyz'[plane[0]]} [mm]", ylabel=f"{'xyz'[plane[1]]} [mm]")
            axes.set_aspect("equal", adjustable="datalim")
            axes.grid(alpha=0.25)
        grid[i][0].set_title(name, loc="left", fontsize=10, fontweight="bold")
    grid[0][2].legend(fontsize=8)
    figure.suptitle("Exit points relative to the calibrated ones, with 95 % ellipses")
    return figure


def draw_residuals(
    where: Array,
    residual: Array,
    left_out: NDArray[np.bool_],
    cable_names: Sequence[str],
    *,
    label: str,
) -> Figure:
    """Draw the residuals of each cable in order, and their distribution.

    Args:
        where: Time [s] or number of each sample, shape (N,).
        residual: Measured minus modelled length [m], shape (N, n).
        left_out: Blunders, shape (N, n).
        cable_names: n names.
        label: Of the axis of `where`.
    """
    n = residual.shape[1]
    figure = new_figure(11.0, 1.2 + 1.6 * n)
    grid = figure.subplots(n, 2, squeeze=False, sharex="col", width_ratios=(3.2, 1.0))
    kept = residual[~left_out]
    reach = 1.15e3 * float(np.abs(kept).max(initial=1e-6))
    for i, name in enumerate(cable_names):
        color, good = COLORS[i % len(COLORS)], ~left_out[:, i]
        over, beside = grid[i]
        values = residual[:, i] * 1e3
        over.plot(where[good], values[good], ".", color=color, ms=3.5)
        outside = np.clip(values[~good], -reach, reach)
        if len(outside):
            over.plot(where[~good], outside, "x", color=OUTLIER, ms=5, label="left out")
            over.legend(fontsize=8, loc="upper right")
        over.set(ylabel=f"{name}\n[mm]", ylim=(-reach, reach))
        over.axhline(0.0, color="#808080", lw=0.6)
        over.grid(alpha=0.25)
        beside.hist(values[good], bins=31, range=(-reach, reach), color=color, alpha=0.7)
        rms = float(np.sqrt(np.mean(values[good] ** 2))) if good.any() else float("nan")
        beside.set_title(f"RMS {rms:.2f} mm", fontsize=9)
        beside.set_yticks([])
    grid[-1][0].set_xlabel(label)
    grid[-1][1].set_xlabel("[mm]")
    figure.suptitle("Residuals: measured minus modelled length")
    return figure


def draw_learnt(estimate: Estimate) -> Figure:
    """Draw what is left of the prior sigma of each parameter, and how far the parameter moved."""
    known = np.isfinite(estimate.prior_sigma)
    names = [name for name, has in zip(estimate.names, known, strict=True) if has]
    left = (estimate.sigma / estimate.prior_sigma)[known]
    moved = (np.abs(estimate.value - estimate.start) / estimate.prior_sigma)[known]
    figure = new_figure(9.5, 1.4 + 0.22 * len(names))
    first, second = figure.subplots(1, 2, sharey=True)
    place = np.arange(len(names))
    first.barh(place, left, color=AFTER, alpha=0.75)
    first.axvline(1.0, color="#808080", lw=0.8)
    first.set(xlabel="1 sigma after / before", xlim=(0.0, max(1.05, float(left.max(initial=0.0)))))
    first.set_yticks(place, names, fontsize=8)
    first.invert_yaxis()
    second.barh(place, moved, color=COLORS[0], alpha=0.75)
    second.axvline(1.0, color="#808080", lw=0.8)
    second.set(xlabel="moved by, in sigmas before")
    for axes in (first, second):
        axes.grid(alpha=0.25, axis="x")
    figure.suptitle("What the data taught: short bars on the left were learnt")
    return figure


def _ellipse(axes: Any, center: Array, covariance: Array, color: str, style: str) -> None:
    """Draw the 95 % ellipse of a covariance [m^2] at a centre [mm]."""
    values, vectors = np.linalg.eigh(covariance)
    turn = np.linspace(0.0, 2.0 * np.pi, 73)
    unit = np.stack([np.cos(turn), np.sin(turn)])
    reach = QUANTILE_95 * 1e3 * np.sqrt(np.maximum(values, 0.0))
    x, y = center[:, None] + vectors @ (reach[:, None] * unit)
    axes.plot(x, y, style, color=color, lw=1.2)
