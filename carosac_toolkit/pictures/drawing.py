"""Shared drawing code: colours, figures, views, violins and legends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MEASURED_COLOR = "#202020"
REST_COLOR = "#d9dde2"
VIOLIN_VALUES_MIN = 5  # values that have a distribution
DOTTED_SAMPLES_MAX = 20  # samples up to which each is drawn as a dot
TURNED_VIEW_ASPECT_MIN = 2.0  # times as far along y as along x: the view from above is turned
LEGEND_CHARACTERS_PER_INCH = 11.0  # of a legend per inch
STANDARD_VIEWS = (((0, 1), "from above"), ((0, 2), "from the side, along y"))
SERIES_COLORS = (
    "#d1622b",
    "#1f6f8b",
    "#7b4fa3",
    "#4c8c2b",
    "#b8336a",
    "#8a6d1f",
    "#5a6b7b",
    "#c79a00",
)
Path = tuple[Array, Mapping[str, Any], Mapping[str, Any]]  # points, style in space, in a plane


def new_figure(width: float, height: float) -> Figure:
    """Make a figure without a window."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def views(robot: Robot) -> list[tuple[tuple[int, int], str]]:
    """Return axes to the right and up, and a title: the same for all recordings of a robot."""
    span = robot.workspace_max - robot.workspace_min
    if span[1] > TURNED_VIEW_ASPECT_MIN * span[0]:
        turned = "from above, turned: y to the right, x up"
        return [((1, 0), turned), ((1, 2), "from the side, along -x: y to the right")]
    return list(STANDARD_VIEWS)


def limits_of(paths: list[Array]) -> Array:
    """Return lower and upper end of the drawn range of each axis [m], shape (3, 2)."""
    points = np.vstack(paths)
    lower, upper = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    longest = max(float((upper - lower).max()), 1e-3)
    middle, half = (lower + upper) / 2, np.maximum(upper - lower, 0.15 * longest) / 2
    return np.stack([middle - half - 0.04 * longest, middle + half + 0.04 * longest], axis=1)


def set_space(
    axes: Any, limits: Array, *, zoom: float = 0.95, elev: float = 22.0, azim: float = -50.0
) -> None:
    """Set limits, aspect, view and labels of the view in three dimensions; angles in degrees."""
    from matplotlib.ticker import MaxNLocator

    axes.set(xlim=limits[0], ylim=limits[1], zlim=limits[2])
    spans = limits[:, 1] - limits[:, 0]
    axes.set_box_aspect(spans / spans.max(), zoom=zoom)
    axes.view_init(elev=elev, azim=azim)
    for axis, name, span in zip((axes.xaxis, axes.yaxis, axes.zaxis), "xyz", spans, strict=True):
        axis.set_label_text(f"{name} [m]")
        axis.labelpad = 12.0 * span / spans.max() - 2.0
        axis.set_major_locator(MaxNLocator(nbins=max(2, round(7 * span / spans.max()))))
        axis.set_tick_params(labelsize=8)


def draw_in_space(
    figure: Figure, paths: Mapping[str, Path], planes: Sequence[tuple[tuple[int, int], str]]
) -> None:
    """Draw paths in space and in planes beside it, with one legend.

    Args:
        figure: An empty figure.
        paths: Points in W [m], shape (K, 3), style in space and style in a plane, by label.
        planes: Axes to the right and up, and title, of each of the two planes.
    """
    grid = figure.add_gridspec(2, 2, width_ratios=(1.35, 1.0))
    space = figure.add_subplot(grid[:, 0], projection="3d")
    limits = limits_of([points for points, _, _ in paths.values()] or [np.zeros((1, 3))])
    for label, (points, style, _) in paths.items():
        space.plot(*points.T, label=label, **style)
    set_space(space, limits)
    for row, (pair, title) in enumerate(planes):
        axes = figure.add_subplot(grid[row, 1])
        for points, _, style in paths.values():
            axes.plot(*points[:, list(pair)].T, **style)
        set_plane(axes, pair, title, xlim=limits[pair[0]], ylim=limits[pair[1]])
    put_legend(figure, space)


def set_plane(axes: Any, pair: tuple[int, int], title: str, **limits: Any) -> None:
    """Set labels, equal scales, title and grid of a view with these axes to the right and up."""
    names = [f"{'xyz'[k]} [m]" for k in pair]
    axes.set(xlabel=names[0], ylabel=names[1], aspect="equal", **limits)
    axes.set_title(title, fontsize=9)
    axes.grid(alpha=0.25)


def draw_bell(axes: Any, values: Array, low: float, color: str) -> None:
    """Draw values as ticks below zero and, if there are enough, their normal distribution above."""
    axes.plot(values, np.full(len(values), low), "|", color=color, ms=7, alpha=0.7)
    mean, deviation = float(values.mean()), float(values.std(ddof=1)) if len(values) > 1 else 0.0
    text = f"{mean:.1f}"
    if deviation > 0.0 and len(values) >= VIOLIN_VALUES_MIN:
        text += f" ± {deviation:.1f}"
        grid = mean + deviation * np.linspace(-3.5, 3.5, 141)
        height = np.exp(-0.5 * ((grid - mean) / deviation) ** 2)
        axes.fill_between(grid, height, color=color, alpha=0.35, lw=1.2, edgecolor=color)
    beside = axes.get_yaxis_transform()
    axes.text(0.99, low, text, transform=beside, ha="right", va="center", color=color, fontsize=9)


def draw_violin(
    axes: Any, values: Array, place: float, color: str, *, width: float = 0.8, signed: bool = False
) -> None:
    """Draw one violin, or few samples as dots, with RMSE and median, or, if signed, the mean."""
    if len(values) == 0:
        return
    if len(values) <= DOTTED_SAMPLES_MAX:
        axes.plot(np.full(len(values), place), values, ".", color=color, ms=5, alpha=0.6)
    else:
        parts = axes.violinplot(values, positions=[place], widths=width, showextrema=False)
        parts["bodies"][0].set(facecolor=color, edgecolor=color, alpha=0.45)
    middle = values.mean() if signed else np.median(values)
    axes.plot(place, middle, "o", color=color, ms=4, mec="white", mew=0.6)
    if not signed:
        root = float(np.sqrt((values**2).mean()))
        axes.hlines(root, place - 0.25 * width, place + 0.25 * width, color=color, lw=2.0)
        axes.annotate(
            _number(root),
            (place + 0.27 * width, root),
            xytext=(2, 0), textcoords="offset points", va="center", fontsize=8,
        )  # fmt: skip


def _number(value: float) -> str:
    """Write a number beside its bar."""
    if value >= 0.1 or value == 0.0:
        return f"{value:.1f}"
    return f"{value:.1g}" if value >= 0.001 else "<0.001"


def put_legend(figure: Figure, axes: Any) -> None:
    """Put the labels of one panel below the figure."""
    handles, labels = axes.get_legend_handles_labels()
    columns = _columns(figure, labels)
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)


def put_patches(figure: Figure, colors: Mapping[str, str]) -> None:
    """Put one coloured patch per model below the figure."""
    from matplotlib.patches import Patch

    handles = [Patch(color=color, alpha=0.6, label=name) for name, color in colors.items()]
    columns = _columns(figure, list(colors))
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, frameon=False)


def _columns(figure: Figure, labels: Sequence[str]) -> int:
    """Return how many columns of a legend fit below a figure."""
    longest = max((len(label) for label in labels), default=1)
    fit = int(figure.get_size_inches()[0] * LEGEND_CHARACTERS_PER_INCH / (longest + 6))
    return max(1, min(len(labels), fit, 6))
