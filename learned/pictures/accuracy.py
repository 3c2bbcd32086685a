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
    MEASURED_COLOR,
    REST_COLOR,
    SERIES_COLORS,
    draw_bell,
    draw_violin,
    limits_of,
    new_figure,
    put_legend,
    put_patches,
    set_space,
    views,
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


def error_histograms(
    mean_error: ArrayLike, mean_length_error: ArrayLike, path: str | Path
) -> Figure:
    """Draw how the errors of N trajectories are distributed.

    Args:
        mean_error: Mean distance to the reference over each trajectory [m], shape (N,).
        mean_length_error: Mean absolute length error over each, all cables [m], shape (N,).
        path: Picture file.
    """
    figure = new_figure(11.0, 4.4)
    panels = figure.subplots(1, 2)
    errors = {
        "mean position error": batch("mean_error", mean_error, ()),
        "mean |length error|": batch("mean_length_error", mean_length_error, ()),
    }
    for axes, color, (label, values) in zip(panels, SERIES_COLORS, errors.items(), strict=False):
        _histogram(axes, MM_PER_M * values, color)
        axes.set(xlabel=f"{label} of a trajectory [mm]", ylabel="trajectories [-]")
    count = len(errors["mean position error"])
    figure.suptitle(f"Errors of {count} trajector{'y' if count == 1 else 'ies'}")
    return save(figure, path)


def error_violins(errors: ArrayLike, path: str | Path, *, what: str = "position error") -> Figure:
    """Draw the distribution of the absolute error along each axis.

    Args:
        errors: Errors in W [m], shape (N, 3); their signs do not matter.
        path: Picture file.
        what: Of what they are errors.
    """
    values = MM_PER_M * np.abs(batch("errors", errors, (3,)))
    figure = new_figure(6.4, 4.6)
    axes = figure.subplots()
    for place, (column, color) in enumerate(zip(values.T, SERIES_COLORS, strict=False)):
        draw_violin(axes, column, place, color)
    medians = np.median(values, axis=0)
    names = [f"{name}\nmedian {median:.1f} mm" for name, median in zip("xyz", medians, strict=True)]
    axes.set_xticks(range(3), names)
    top = axes.get_ylim()[1]
    axes.set(xlim=(-0.6, 2.8), ylim=(-0.02 * top, top), ylabel=f"absolute {what} [mm]")
    axes.grid(axis="y", alpha=0.25)
    axes.set_axisbelow(True)
    figure.suptitle(f"{len(values)} samples; bar: RMSE; dot: median")
    return save(figure, path)


def sample_paths(
    reference: ArrayLike, reached: ArrayLike, robot: Robot, path: str | Path
) -> Figure:
    """Draw K paths with their references in space, from above and from the side.

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
    figure = new_figure(12.0, 7.2)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.35, 1.0))
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
        axes.set_title(title, fontsize=9)
        axes.grid(alpha=0.25)
    figure.suptitle(f"{robot.name}: paths of the platform origin, one colour each; dot: start")
    put_legend(figure, space)
    return save(figure, path)


def rmse_gaussians(groups: Mapping[str, ArrayLike], path: str | Path) -> Figure:
    """Draw how the RMSE of a trajectory scatters: a normal distribution for each controller.

    Args:
        groups: RMSE of each trajectory along each axis of W [m], shape (N, 3), by name.
        path: Picture file.
    """
    if not 0 < len(groups) <= PATHS_DRAWN_MAX:
        raise InvalidField("groups", len(groups), f"1 to {PATHS_DRAWN_MAX} groups")
    figure = new_figure(12.0, 4.6)
    panels = figure.subplots(1, 3)
    colors = dict(zip(groups, SERIES_COLORS, strict=False))
    for place, (name, errors) in enumerate(groups.items()):
        values = MM_PER_M * batch(name, errors, (3,))
        for axes, column in zip(panels, values.T, strict=True):
            draw_bell(axes, column, -0.13 * (place + 1), colors[name])
    for axes, name in zip(panels, "xyz", strict=True):
        axes.set_title(name, fontsize=10)
        end = axes.get_xlim()[1]
        axes.set(xlabel="RMSE of a trajectory [mm]", xlim=(-0.02 * end, 1.1 * end))
        axes.set(yticks=[], ylim=(-0.13 * (len(groups) + 0.6), 1.08))
        axes.axhline(0.0, color=MEASURED_COLOR, lw=0.6)
        axes.grid(axis="x", alpha=0.25)
    figure.suptitle(
        "RMSE per trajectory: its normal distribution, scaled to one height; "
        "ticks: the trajectories; number: mean ± standard deviation"
    )
    put_patches(figure, colors)
    return save(figure, path)


def errors_over_time(
    time: ArrayLike,
    errors: Mapping[str, ArrayLike],
    path: str | Path,
    *,
    rests: Sequence[tuple[float, float]] = (),
    marks: Sequence[float] = (),
) -> Figure:
    """Draw the absolute error along each axis over time, with rests shaded.

    Args:
        time: Increasing [s], shape (T,).
        errors: Errors in W [m], shape (T, 3), by name; their signs do not matter.
        path: Picture file.
        rests: Start and end of each rest [s].
        marks: Where one trajectory ends and the next begins [s].
    """
    if not 0 < len(errors) <= PATHS_DRAWN_MAX:
        raise InvalidField("errors", len(errors), f"1 to {PATHS_DRAWN_MAX} of them")
    when = batch("time", time, ())
    figure = new_figure(12.0, 7.6)
    panels = figure.subplots(3, 1, sharex=True)
    for (name, series), color in zip(errors.items(), SERIES_COLORS, strict=False):
        values = MM_PER_M * np.abs(batch(name, series, (3,)))
        if len(values) != len(when):
            raise InvalidField(name, f"{len(values)} errors", f"{len(when)}, one for each time")
        for axes, column in zip(panels, values.T, strict=True):
            axes.plot(when, column, color=color, lw=1.2, label=name)
    for axes, name in zip(panels, "xyz", strict=True):
        for k, (first, last) in enumerate(rests):
            label = None if k else "winches at rest"
            axes.axvspan(first, last, color=REST_COLOR, lw=0, zorder=0, label=label)
        for mark in marks:
            axes.axvline(mark, color=MEASURED_COLOR, lw=0.6, ls=":")
        axes.set(ylabel=f"|error| in {name} [mm]", ylim=(0.0, None))
        axes.margins(x=0.005)
        axes.grid(axis="y", alpha=0.25)
    panels[-1].set_xlabel("time [s]")
    figure.align_ylabels(panels)
    title = "Absolute position error over time"
    figure.suptitle(title + ("; dotted: the next trajectory" if len(marks) else ""))
    put_legend(figure, panels[0])
    return save(figure, path)


def _histogram(axes: Any, values: Array, color: str) -> None:
    """Draw a histogram of what is not far away, its median and its 95th percentile."""
    end = OUTLIER_RATIO * float(np.percentile(values, SHOWN_PERCENT))
    shown = values[values <= end] if end > 0.0 else values
    axes.hist(
        shown, bins=HISTOGRAM_BINS, range=(0.0, float(shown.max()) or 1.0), color=color, alpha=0.6
    )
    for style, name, percent in (("-", "median", 50.0), ("--", "95th percentile", 95.0)):
        value = float(np.percentile(values, percent))
        axes.axvline(value, color=MEASURED_COLOR, lw=1.2, ls=style, label=f"{name} {value:.1f} mm")
    far = len(values) - len(shown)
    if far:
        axes.plot([], [], " ", label=f"not shown: {far}, up to {values.max():.0f} mm")
    axes.legend(
        loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False, fontsize=8,
        handlelength=1.4, columnspacing=1.2,
    )  # fmt: skip
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
        axes.plot(*reached.T, color=SERIES_COLORS[k], lw=1.5, label=label, zorder=2)
