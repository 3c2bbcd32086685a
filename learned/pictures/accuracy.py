"""Pictures of how well a policy does: errors over trajectories, axes and space."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations, product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from carosac_toolkit.base.arrays import Array, batch
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.pictures.drawing import (
    draw_ecdf,
    draw_violin,
    enlarged_text,
    enlargement,
    finish_ecdf,
    limits_of,
    line_style,
    new_figure,
    number_below,
    put_legend,
    rms,
    set_space,
    set_title,
    views,
)
from carosac_toolkit.pictures.style import (
    CONTROLLER_NUMBERS,
    DOUBLE_COLUMN_INCH,
    MEASURED_COLOR,
    REST_COLOR,
    SERIES_COLORS,
    SERIES_LINES,
    SINGLE_COLUMN_INCH,
    Series,
    looks_by_name,
    series,
    styled,
)
from carosac_toolkit.robot.robot import Robot
from learned.pictures.files import save

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MM_PER_M = 1e3
BOX_COLOR = "#8a8a8a"
HISTOGRAM_BINS = 40
SHOWN_PERCENT = 99.0  # percent of the values that a histogram must show
OUTLIER_RATIO = 1.5  # times as far as those: the rest is counted, not drawn
PATHS_DRAWN_MAX = len(SERIES_COLORS)  # paths that can be told apart


@styled
def error_histograms(
    mean_error: ArrayLike,
    mean_length_error: ArrayLike,
    path: str | Path,
    *,
    robot: Robot | None = None,
) -> Figure:
    """Draw how the errors of N trajectories are distributed.

    Args:
        mean_error: Mean distance to the reference over each trajectory [m], shape (N,).
        mean_length_error: Mean absolute length error over each, all cables [m], shape (N,).
        path: Picture file.
        robot: For the title.
    """
    figure = new_figure(DOUBLE_COLUMN_INCH, 2.8)
    panels = figure.subplots(1, 2)
    errors = {
        "mean position error": batch("mean_error", mean_error, ()),
        "mean |length error|": batch("mean_length_error", mean_length_error, ()),
    }
    for k, (axes, (label, values)) in enumerate(zip(panels, errors.items(), strict=True)):
        _histogram(axes, MM_PER_M * values, series(k))
        axes.set(xlabel=f"{label} of a trajectory [mm]", ylabel="trajectories [-]")
    count = len(errors["mean position error"])
    words = f"errors of {count} trajector{'y' if count == 1 else 'ies'}"
    set_title(figure, f"{robot.name}: {words}" if robot is not None else words)
    return save(figure, path)


@styled
def error_violins(
    errors: ArrayLike,
    path: str | Path,
    *,
    what: str = "position error",
    robot: Robot | None = None,
) -> Figure:
    """Draw the distribution of the signed error along each axis.

    Args:
        errors: Errors in W [m], shape (N, 3).
        path: Picture file.
        what: Of what they are errors.
        robot: For the title.
    """
    values = MM_PER_M * batch("errors", errors, (3,))
    figure = new_figure(SINGLE_COLUMN_INCH, 2.8)
    axes = figure.subplots()
    for place, column in enumerate(values.T):
        draw_violin(axes, column, place, series(place))
    numbers = {float(place): rms(column) for place, column in enumerate(values.T)}
    colors = {place: series(k).color for k, place in enumerate(numbers)}
    number_below(axes, numbers, "RMSE along x, y and z [mm]", colors)
    axes.set(xlim=(-0.6, 2.6), ylabel=f"{what} [mm]")
    axes.axhline(0.0, color=MEASURED_COLOR, lw=0.6, zorder=0)
    axes.grid(axis="y", alpha=0.25)
    axes.set_axisbelow(True)
    words = f"{what} at {len(values)} samples; marker: mean"
    set_title(figure, f"{robot.name}: {words}" if robot is not None else words)
    return save(figure, path)


@styled
def sample_paths(
    reference: ArrayLike, reached: ArrayLike, robot: Robot, path: str | Path
) -> Figure:
    """Draw K paths with their references in three views, errors enlarged.

    Args:
        reference: Wanted positions in W [m], shape (K, T, 3).
        reached: Reached positions in W [m], shape (K, T, 3).
        robot: Its workspace box is drawn.
        path: Picture file.
    """
    wanted = batch("reference", reference, (*np.shape(reference)[1:2], 3))
    reached_paths = batch("reached", reached, wanted.shape[1:])
    if len(reached_paths) != len(wanted) or len(wanted) > PATHS_DRAWN_MAX:
        allowed = f"as many as references, {PATHS_DRAWN_MAX} at most"
        raise InvalidField("reached", f"{len(reached_paths)} paths for {len(wanted)}", allowed)
    errors = [got - asked for got, asked in zip(reached_paths, wanted, strict=True)]
    extent = np.concatenate([*wanted])
    factor = enlargement(extent, errors)
    reached_paths = wanted + factor * (reached_paths - wanted)
    figure = new_figure(DOUBLE_COLUMN_INCH, 4.4)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.15, 1.0))
    space = figure.add_subplot(grid[:, 0], projection="3d")
    corners = np.stack([robot.workspace_min, robot.workspace_max])
    limits = limits_of([wanted.reshape(-1, 3), reached_paths.reshape(-1, 3), corners])
    _paths(space, wanted, reached_paths, robot, (0, 1, 2))
    set_space(space, limits)
    for row, (pair, title) in enumerate(views(robot)):
        axes = figure.add_subplot(grid[row, 1])
        _paths(axes, wanted, reached_paths, robot, pair)
        axes.set(xlabel=f"{'xyz'[pair[0]]} [m]", ylabel=f"{'xyz'[pair[1]]} [m]")
        axes.set(xlim=limits[pair[0]], ylim=limits[pair[1]], aspect="equal")
        axes.set_title(title)
        axes.grid(alpha=0.25)
    set_title(
        figure,
        f"{robot.name}: paths of the platform origin, {enlarged_text(factor)}; dot: start",
    )
    put_legend(figure, space)
    return save(figure, path)


@styled
def rmse_distribution(
    groups: Mapping[str, ArrayLike], path: str | Path, *, robot: Robot | None = None
) -> Figure:
    """Draw which share of the trajectories has at most an RMSE, a curve for each controller.

    Args:
        groups: RMSE of each trajectory along each axis of W [m], shape (N, 3), by name.
        path: Picture file.
        robot: For the title.
    """
    if not 0 < len(groups) <= PATHS_DRAWN_MAX:
        raise InvalidField("groups", len(groups), f"1 to {PATHS_DRAWN_MAX} groups")
    figure = new_figure(DOUBLE_COLUMN_INCH, 2.8)
    panels = figure.subplots(1, 3, sharey=True)
    looks = looks_by_name(list(groups), CONTROLLER_NUMBERS)
    for (name, errors), look in zip(groups.items(), looks, strict=True):
        values = MM_PER_M * batch(name, errors, (3,))
        for axes, column in zip(panels, values.T, strict=True):
            draw_ecdf(axes, column, len(column), look, name)
    for axes, name in zip(panels, "xyz", strict=True):
        axes.set_title(name)
    finish_ecdf(panels, "RMSE of a trajectory [mm]")
    panels[0].set_ylabel("share of trajectories [-]")
    words = "share of trajectories with at most this RMSE"
    set_title(figure, f"{robot.name}: {words}" if robot is not None else words)
    put_legend(figure, panels[0])
    return save(figure, path)


@styled
def errors_over_time(
    time: ArrayLike,
    errors: Mapping[str, ArrayLike],
    path: str | Path,
    *,
    rests: Sequence[tuple[float, float]] = (),
    marks: Sequence[float] = (),
) -> Figure:
    """Draw the signed error along each axis over time, with rests shaded.

    Args:
        time: Increasing [s], shape (T,).
        errors: Errors in W [m], shape (T, 3), by name.
        path: Picture file.
        rests: Start and end of each rest [s].
        marks: Where one trajectory ends and the next begins [s].
    """
    if not 0 < len(errors) <= PATHS_DRAWN_MAX:
        raise InvalidField("errors", len(errors), f"1 to {PATHS_DRAWN_MAX} of them")
    when = batch("time", time, ())
    figure = new_figure(DOUBLE_COLUMN_INCH, 5.0)
    panels = figure.subplots(3, 1, sharex=True)
    for k, (name, error) in enumerate(errors.items()):
        values = MM_PER_M * batch(name, error, (3,))
        if len(values) != len(when):
            raise InvalidField(name, f"{len(values)} errors", f"{len(when)}, one for each time")
        for axes, column in zip(panels, values.T, strict=True):
            axes.plot(when, column, label=name, **line_style(series(k), len(when), k))
    for axes, name in zip(panels, "xyz", strict=True):
        for k, (first, last) in enumerate(rests):
            label = None if k else "winches at rest"
            axes.axvspan(first, last, color=REST_COLOR, lw=0, zorder=0, label=label)
        for mark in marks:
            axes.axvline(mark, color=MEASURED_COLOR, lw=0.6, ls=":")
        axes.axhline(0.0, color=MEASURED_COLOR, lw=0.6, zorder=0)
        axes.set_ylabel(f"error in {name} [mm]")
        axes.margins(x=0.005)
        axes.grid(axis="y", alpha=0.25)
    panels[-1].set_xlabel("time [s]")
    figure.align_ylabels(panels)
    title = "Position error over time"
    set_title(figure, title + ("; dotted: the next trajectory" if len(marks) else ""))
    put_legend(figure, panels[0])
    return save(figure, path)


def _histogram(axes: Any, values: Array, look: Series) -> None:
    """Draw a histogram of what is not far away, its median and its 95th percentile."""
    end = OUTLIER_RATIO * float(np.percentile(values, SHOWN_PERCENT))
    shown = values[values <= end] if end > 0.0 else values
    ends = (0.0, float(shown.max()) or 1.0)
    axes.hist(shown, bins=HISTOGRAM_BINS, range=ends, color=look.color, alpha=0.6)
    for style, name, percent in (("-", "median", 50.0), ("--", "95th percentile", 95.0)):
        value = float(np.percentile(values, percent))
        axes.axvline(value, color=MEASURED_COLOR, lw=1.2, ls=style, label=f"{name} {value:.1f} mm")
    far = len(values) - len(shown)
    if far:
        axes.plot([], [], " ", label=f"not shown: {far}, up to {values.max():.0f} mm")
    axes.legend(
        loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, handlelength=1.4, columnspacing=1.2
    )
    axes.set_xlim(left=0.0)
    axes.grid(axis="y", alpha=0.25)
    axes.set_axisbelow(True)


def _paths(axes: Any, wanted: Array, paths: Array, robot: Robot, view: tuple[int, ...]) -> None:
    """Draw the workspace box and all paths in one view."""
    columns = list(view)
    ends = np.stack([robot.workspace_min, robot.workspace_max])[:, columns]
    corners = np.array(list(product(*ends.T)))
    for k, edge in enumerate([(a, b) for a, b in combinations(corners, 2) if (a != b).sum() == 1]):
        label = None if k else "workspace box"
        axes.plot(*np.stack(edge).T, color=BOX_COLOR, lw=0.9, ls=":", label=label)
    for k, reference in enumerate(wanted[..., columns]):
        label = None if k else "reference"
        axes.plot(*reference.T, color=MEASURED_COLOR, lw=0.9, ls="--", label=label, zorder=3)
        axes.plot(*reference[:1].T, "o", color=MEASURED_COLOR, ms=3.5, zorder=3)
    for k, reached in enumerate(paths[..., columns]):
        label = None if k else "reached"
        axes.plot(
            *reached.T, color=SERIES_COLORS[k], lw=1.2, ls=SERIES_LINES[k], label=label, zorder=2
        )
