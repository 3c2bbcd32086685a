"""Pictures that all calibrations share: exit points, residuals and what was learnt."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from calibration.estimate import ParameterEstimate
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.pictures.drawing import new_figure
from carosac_toolkit.pictures.style import SERIES_COLORS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOR_BEFORE, COLOR_AFTER = "#9aa3ad", "#1f6f8b"
COLOR_OUTLIER = "#c0392b"
ELLIPSE_95_RADIUS = 2.4477  # radius of the 95 % ellipse of two dimensions, in standard deviations
PANEL_REACH_MIN, PANEL_REACH_MAX = (
    1.4,
    6.0,
)  # reach of a panel, in radii of the ellipse after the calibration
_COORDINATE_PLANES = ((0, 1), (0, 2), (1, 2))


def draw_exit_points(
    cable_names: Sequence[str],
    before: Array,
    before_covariance: Array | None,
    after: Array,
    after_covariance: Array,
) -> Figure:
    """Draw each exit point before and after, with its 95 % ellipse in three planes.

    A panel is as large as the ellipse after the calibration needs it; where the point was farther
    away before, an arrow comes in from the edge.

    Args:
        cable_names: n names.
        before: In W [m], shape (n, 3).
        before_covariance: [m^2], shape (n, 3, 3), or None where nothing was known.
        after: In W [m], shape (n, 3).
        after_covariance: [m^2], shape (n, 3, 3).
    """
    n = len(cable_names)
    figure = new_figure(10.5, 1.4 + 3.3 * n)
    grid = figure.subplots(n, 3, squeeze=False)
    for i, name in enumerate(cable_names):
        known = before_covariance is not None and np.isfinite(before_covariance[i]).all()
        for axes, plane in zip(grid[i], _COORDINATE_PLANES, strict=True):
            part = np.ix_(plane, plane)
            prior = before_covariance[i][part] if known and before_covariance is not None else None
            moved = (before[i] - after[i])[list(plane)] * 1e3
            _draw_point(axes, moved, prior, after_covariance[i][part])
            axes.set_xlabel(f"{'xyz'[plane[0]]} [mm]", fontsize=10)
            axes.set_ylabel(f"{'xyz'[plane[1]]} [mm]", fontsize=10)
        distance = 1e3 * float(np.linalg.norm(after[i] - before[i]))
        grid[i][0].set_title(
            f"{name}, moved by {distance:.3g} mm", loc="left", fontsize=11, fontweight="bold"
        )
    marks = {label: mark for axes in grid.flat for mark, label in _legend(axes)}
    figure.legend(marks.values(), marks.keys(), loc="outside lower center", ncols=4, fontsize=10)
    figure.suptitle("Exit points relative to the calibrated ones, with 95 % ellipses")
    return figure


def _draw_point(axes: Any, moved: Array, prior: Array | None, posterior: Array) -> None:
    """Draw one exit point in one plane; what is far away is cut at the edge of the panel.

    Args:
        axes: The panel.
        moved: Place of the point before, relative to its place now [mm], shape (2,).
        prior: Covariance before [m^2], shape (2, 2); None: nothing was known.
        posterior: Covariance after [m^2], shape (2, 2).
    """
    size = max(ELLIPSE_95_RADIUS * 1e3 * float(np.sqrt(np.diag(posterior).max())), 1e-6)
    furthest = float(np.abs(moved).max())
    reach = float(np.clip(1.2 * furthest, PANEL_REACH_MIN * size, PANEL_REACH_MAX * size))
    if prior is not None:
        _ellipse(axes, moved, prior, COLOR_BEFORE, "--", "known before")
    _ellipse(axes, np.zeros(2), posterior, COLOR_AFTER, "-", "known after")
    axes.plot(0.0, 0.0, "o", color=COLOR_AFTER, ms=5, label="after")
    start = moved
    if furthest < reach:
        axes.plot(*moved, "o", color=COLOR_BEFORE, ms=6, label="before")
    else:
        start = moved * reach / furthest
    if furthest > 0.05 * reach:
        arrow = {"arrowstyle": "->", "color": "#707880", "shrinkA": 0.0, "shrinkB": 3.0}
        axes.annotate("", (0.0, 0.0), tuple(start), arrowprops=arrow)
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
    axes.set_aspect("equal", adjustable="box")
    axes.tick_params(labelsize=9)
    axes.grid(alpha=0.25)


def _legend(axes: Any) -> list[tuple[Any, str]]:
    """Return the marks of a panel with their labels."""
    return list(zip(*axes.get_legend_handles_labels(), strict=True))


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
        color, good = SERIES_COLORS[i % len(SERIES_COLORS)], ~left_out[:, i]
        over, beside = grid[i]
        values = residual[:, i] * 1e3
        over.plot(where[good], values[good], ".", color=color, ms=3.5)
        outside = np.clip(values[~good], -reach, reach)
        if len(outside):
            over.plot(where[~good], outside, "x", color=COLOR_OUTLIER, ms=5, label="left out")
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


def draw_learnt(estimate: ParameterEstimate) -> Figure:
    """Draw what is left of the prior sigma of each parameter, and how far the parameter moved."""
    known = np.isfinite(estimate.prior_sigma)
    names = [name for name, has in zip(estimate.names, known, strict=True) if has]
    left = (estimate.sigma / estimate.prior_sigma)[known]
    moved = estimate.moved[known]
    figure = new_figure(9.5, 1.4 + 0.22 * len(names))
    first, second = figure.subplots(1, 2, sharey=True)
    place = np.arange(len(names))
    first.barh(place, left, color=COLOR_AFTER, alpha=0.75)
    first.set(xlabel="1 sigma after / before", xlim=(0.0, max(1.05, float(left.max(initial=0.0)))))
    first.set_yticks(place, names, fontsize=8)
    first.invert_yaxis()
    second.barh(place, moved, color=SERIES_COLORS[0], alpha=0.75)
    second.set(xlabel="moved by, in sigmas before")
    for axes in (first, second):
        axes.axvline(1.0, color="#808080", lw=0.8)
        axes.grid(alpha=0.25, axis="x")
    figure.suptitle("Learnt from the data: short bars on the left")
    return figure


def _ellipse(
    axes: Any, center: Array, covariance: Array, color: str, style: str, label: str
) -> None:
    """Draw the 95 % ellipse of a covariance [m^2] at a centre [mm]."""
    values, vectors = np.linalg.eigh(covariance)
    turn = np.linspace(0.0, 2.0 * np.pi, 73)
    unit = np.stack([np.cos(turn), np.sin(turn)])
    reach = ELLIPSE_95_RADIUS * 1e3 * np.sqrt(np.maximum(values, 0.0))
    x, y = center[:, None] + vectors @ (reach[:, None] * unit)
    axes.plot(x, y, style, color=color, lw=1.6, label=label)
