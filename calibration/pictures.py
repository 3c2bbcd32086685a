"""Pictures that all calibrations share: exit points, residuals and what was learnt."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from calibration.estimate import ParameterEstimate
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.pictures.drawing import new_figure, put_legend, set_title
from carosac_toolkit.pictures.style import (
    DOUBLE_COLUMN_INCH,
    MEASURED_COLOR,
    SERIES_COLORS,
    styled,
)
from carosac_toolkit.validation.quantities import say_length

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOR_BEFORE, COLOR_AFTER, COLOR_OUTLIER = "#8a929b", SERIES_COLORS[0], SERIES_COLORS[1]
BAR_WIDTH = 0.4  # of two bars that stand side by side, in distances between pairs
ELLIPSE_95_RADIUS = 2.4477  # radius of the 95 % ellipse of two dimensions, in standard deviations
PANEL_REACH_MIN, PANEL_REACH_MAX = (
    1.4,
    6.0,
)  # reach of a panel, in radii of the ellipse after the calibration
_COORDINATE_PLANES = ((0, 1), (0, 2), (1, 2))


@styled
def draw_exit_points(
    robot: str,
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
        robot: Name of the robot.
        cable_names: n names.
        before: In W [m], shape (n, 3).
        before_covariance: [m^2], shape (n, 3, 3), or None where nothing was known.
        after: In W [m], shape (n, 3).
        after_covariance: [m^2], shape (n, 3, 3).
    """
    n = len(cable_names)
    figure = new_figure(DOUBLE_COLUMN_INCH, 0.9 + 2.1 * n)
    grid = figure.subplots(n, 3, squeeze=False)
    for i, name in enumerate(cable_names):
        known = before_covariance is not None and np.isfinite(before_covariance[i]).all()
        for axes, plane in zip(grid[i], _COORDINATE_PLANES, strict=True):
            part = np.ix_(plane, plane)
            prior = before_covariance[i][part] if known and before_covariance is not None else None
            moved = (before[i] - after[i])[list(plane)] * 1e3
            _draw_point(axes, moved, prior, after_covariance[i][part])
            axes.set(xlabel=f"{'xyz'[plane[0]]} [mm]", ylabel=f"{'xyz'[plane[1]]} [mm]")
        distance = say_length(float(np.linalg.norm(after[i] - before[i])))
        grid[i][0].set_title(f"{name}, moved by {distance}", loc="left", fontweight="bold")
    set_title(
        figure,
        f"{robot}: exit points relative to the calibrated ones, with 95 % ellipses",
        "arrows: from the points before",
    )
    put_legend(figure, *grid.flat)
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
    axes.plot(0.0, 0.0, "o", color=COLOR_AFTER, label="after")
    start = moved
    if furthest < reach:
        axes.plot(*moved, "s", color=COLOR_BEFORE, label="before")
    else:
        start = moved * reach / furthest
    if furthest > 0.05 * reach:
        arrow = {"arrowstyle": "->", "color": "#707880", "shrinkA": 0.0, "shrinkB": 3.0}
        axes.annotate("", (0.0, 0.0), tuple(start), arrowprops=arrow)
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
    axes.set_aspect("equal", adjustable="box")
    axes.grid(alpha=0.25)


@styled
def draw_residuals(
    robot: str,
    where: Array,
    residual: Array,
    left_out: NDArray[np.bool_],
    cable_names: Sequence[str],
    *,
    label: str,
) -> Figure:
    """Draw the residuals of each cable in order, and their distribution.

    Args:
        robot: Name of the robot.
        where: Time [s] or number of each sample, shape (N,).
        residual: Measured minus modelled length [m], shape (N, n).
        left_out: Blunders, shape (N, n).
        cable_names: n names.
        label: Of the axis of `where`.
    """
    n = residual.shape[1]
    figure = new_figure(DOUBLE_COLUMN_INCH, 0.9 + 0.95 * n)
    grid = figure.subplots(n, 2, squeeze=False, sharex="col", width_ratios=(3.2, 1.0))
    kept = residual[~left_out]
    reach = 1.15e3 * float(np.abs(kept).max(initial=1e-6))
    for i, name in enumerate(cable_names):
        good = ~left_out[:, i]
        over, beside = grid[i]
        values = residual[:, i] * 1e3
        over.plot(where[good], values[good], ".", color=COLOR_AFTER, ms=2.5)
        if not good.all():  # nothing drawn beyond the axes would leave no room for them
            over.plot(
                where[~good], np.clip(values[~good], -reach, reach), "x", color=COLOR_OUTLIER,
                ms=4, clip_on=False,
            )  # fmt: skip
        over.set(ylabel=f"{name}\n[mm]", ylim=(-reach, reach))
        over.axhline(0.0, color=MEASURED_COLOR, lw=0.6)
        over.grid(alpha=0.25)
        beside.hist(values[good], bins=31, range=(-reach, reach), color=COLOR_AFTER, alpha=0.7)
        rms = float(np.sqrt(np.mean(values[good] ** 2))) if good.any() else float("nan")
        beside.set_title(f"RMS {rms:.2f} mm")
        beside.set_yticks([])
    figure.align_ylabels(grid[:, 0])
    grid[-1][0].set_xlabel(label)
    grid[-1][1].set_xlabel("[mm]")
    set_title(
        figure,
        f"{robot}: residuals, measured minus modelled length",
        "crosses: left out, at the edge where they are outside" if left_out.any() else "",
    )
    return figure


@styled
def draw_learnt(robot: str, estimate: ParameterEstimate) -> Figure:
    """Draw what is left of the prior sigma of each parameter, and how far the parameter moved."""
    known = np.isfinite(estimate.prior_sigma)
    names = [name for name, has in zip(estimate.names, known, strict=True) if has]
    left, moved = estimate.kept[known], estimate.moved[known]
    figure = new_figure(DOUBLE_COLUMN_INCH, 0.9 + 0.15 * len(names))
    first, second = figure.subplots(1, 2, sharey=True)
    place = np.arange(len(names))
    first.barh(place, left, color=COLOR_AFTER, alpha=0.75)
    first.set(xlabel="1 sigma after / before [-]", ylim=(len(names) - 0.4, -0.6))
    first.set_xlim(0.0, 1.05 * max(1.0, float(left.max(initial=0.0))))
    first.set_yticks(place, names)
    second.barh(place, moved, color=COLOR_OUTLIER, alpha=0.75)
    second.set(xlabel="after minus before, in sigmas before [-]")
    for axes, levels in ((first, (1.0,)), (second, (-1.0, 0.0, 1.0))):
        for level in levels:
            axes.axvline(level, color=MEASURED_COLOR, lw=0.6, ls="--" if level else "-")
        axes.grid(alpha=0.25, axis="x")
    set_title(figure, f"{robot}: learnt from the data (short bars on the left), and change")
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
    axes.plot(x, y, style, color=color, label=label)
