"""Shared drawing code: figures, titles, views, distributions and legends."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.pictures.style import Series
from carosac_toolkit.robot.robot import Robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

VIOLIN_VALUES_MIN = 5  # values that have a distribution
DOTTED_SAMPLES_MAX = 20  # samples up to which each is drawn as a dot
MARKED_SAMPLES = 10  # samples of a line that carry its marker
TURNED_VIEW_ASPECT_MIN = 2.0  # times as far along y as along x: the view from above is turned
TITLE_CHARACTERS_PER_INCH = 13.0  # of a title per inch
LEGEND_COLUMNS_MAX = 6
LEGEND_WIDTH_RATIO_MAX = 0.94  # of the width of its figure
UPRIGHT_LABEL_POINTS = 6.0  # [points] between the upper end of the z axis and its label
UPRIGHT_NUMBERS_MAX = 3  # numbers below an axis up to which they have room side by side
ENLARGED_ERROR_RATIO = 0.25  # of the extent of a path, to which its errors are enlarged at most
ENLARGED_ERROR_PERCENTILE = 95.0  # percent of the errors that are at most as large as is enlarged
ENLARGEMENTS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
LOG_AXIS_RATIO = 8.0  # ratio of values from which their axis is logarithmic
STANDARD_VIEWS = (((0, 1), "from above"), ((0, 2), "from the side, along y"))
Path = tuple[Array, Mapping[str, Any]]  # points, style


class Shades(tuple[Any, ...]):
    """Handles that stand side by side in one entry of a legend; those of a tuple coincide."""


def new_figure(width: float, height: float) -> Figure:
    """Make a figure without a window; sizes in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def set_title(figure: Figure, *lines: str) -> None:
    """Write the title of a figure; lines too long for it are broken."""
    fit = int(TITLE_CHARACTERS_PER_INCH * figure.get_size_inches()[0])
    figure.suptitle("\n".join(textwrap.fill(line, fit) for line in lines if line))


def line_style(look: Series, samples: int, place: int = 0) -> dict[str, Any]:
    """Return the style of a line: colour, dashes, and a marker on some of its samples.

    Args:
        look: Look of the series.
        samples: Number of samples of the line.
        place: Number of the series, so that markers of several lines do not coincide.
    """
    every = max(1, samples // MARKED_SAMPLES)
    return {
        "color": look.color, "ls": look.line, "marker": look.marker, "ms": 3.2,
        "mew": 0.0, "markevery": (min((place * every) // 8, samples - 1) if samples else 0, every),
    }  # fmt: skip


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
    axes: Any, limits: Array, *, zoom: float = 1.0, elev: float = 22.0, azim: float = -50.0
) -> None:
    """Set limits, aspect, view and labels of the view in three dimensions; angles in degrees."""
    from matplotlib.ticker import MaxNLocator

    axes.set(xlim=limits[0], ylim=limits[1], zlim=limits[2])
    spans = limits[:, 1] - limits[:, 0]
    axes.set_box_aspect(spans / spans.max(), zoom=zoom)
    axes.view_init(elev=elev, azim=azim)
    for axis, name, span in zip((axes.xaxis, axes.yaxis, axes.zaxis), "xyz", spans, strict=True):
        axis.set_label_text(f"{name} [m]")
        axis.labelpad = 6.0 * span / spans.max() - 1.0
        axis.set_major_locator(MaxNLocator(nbins=max(2, round(7 * span / spans.max()))))
        axis.set_tick_params(pad=0.0)
    _name_upright_axis(axes, limits)


def _name_upright_axis(axes: Any, limits: Array) -> None:
    """Write the label of the z axis above its upper end.

    The library puts it beside the middle, at a distance that grows with the horizontal extent, so
    that in views of flat scenes it is closer to other panels than to its axis.
    """
    from mpl_toolkits.mplot3d.proj3d import proj_transform

    axes.set_zlabel("")
    ends = [(x, y, limits[2, 1]) for x, y in product(limits[0], limits[1])]
    top = max(
        (proj_transform(*end, axes.get_proj())[:2] for end in ends), key=lambda place: place[0]
    )
    axes.annotate(
        "z [m]", top, xytext=(0.0, UPRIGHT_LABEL_POINTS), textcoords="offset points", ha="center",
        va="bottom", fontsize=axes.zaxis.label.get_fontsize(), annotation_clip=False,
    )  # fmt: skip


def draw_in_space(
    figure: Figure,
    paths: Mapping[str, Path],
    planes: Sequence[tuple[tuple[int, int], str]],
    limits: Array | None = None,
) -> None:
    """Draw paths in space and in planes beside it, with one legend.

    Args:
        figure: An empty figure.
        paths: Points in W [m], shape (K, 3), and style, by label.
        planes: Axes to the right and up, and title, of each of the two planes.
        limits: Lower and upper end of each axis [m], shape (3, 2); by default all points are
            inside. What is outside is cut off.
    """
    grid = figure.add_gridspec(2, 2, width_ratios=(1.15, 1.0))
    space = figure.add_subplot(grid[:, 0], projection="3d")
    if limits is None:
        limits = limits_of([points for points, _ in paths.values()] or [np.zeros((1, 3))])
    for label, (points, style) in paths.items():
        beyond = (points < limits[:, 0]) | (points > limits[:, 1])
        inside = np.where(beyond.any(axis=1, keepdims=True), np.nan, points)
        space.plot(*inside.T, label=label, **style)
    set_space(space, limits)
    for row, (pair, title) in enumerate(planes):
        axes = figure.add_subplot(grid[row, 1])
        for points, style in paths.values():
            axes.plot(*points[:, list(pair)].T, **style)
        set_plane(axes, pair, title, xlim=limits[pair[0]], ylim=limits[pair[1]])
    put_legend(figure, space)


def set_plane(axes: Any, pair: tuple[int, int], title: str, **limits: Any) -> None:
    """Set labels, equal scales, title and grid of a view with these axes to the right and up."""
    names = [f"{'xyz'[k]} [m]" for k in pair]
    axes.set(xlabel=names[0], ylabel=names[1], aspect="equal", **limits)
    axes.set_title(title)
    axes.grid(alpha=0.25)


def draw_violin(
    axes: Any, values: Array, place: float, look: Series, *, width: float = 0.8
) -> None:
    """Draw one violin, or few samples as dots, with a marker at their mean."""
    if len(values) == 0:
        return
    if len(values) <= DOTTED_SAMPLES_MAX:
        axes.plot(np.full(len(values), place), values, ".", color=look.color, ms=4, alpha=0.6)
    else:
        parts = axes.violinplot(values, positions=[place], widths=width, showextrema=False)
        parts["bodies"][0].set(
            facecolor=look.color, edgecolor=look.color, alpha=0.45, hatch=look.hatch
        )
    axes.plot(place, values.mean(), look.marker, color=look.color, ms=4.5, mec="white", mew=0.6)


def number_below(
    axes: Any, numbers: Mapping[float, float | None], label: str, colors: Mapping[float, str]
) -> None:
    """Write a number for each place below the panel, in its colour: the panel has no axis there.

    Args:
        axes: The panel.
        numbers: Number by its place on the axis; None where there is none.
        label: Meaning and unit of the numbers.
        colors: Colour of the number by its place.
    """
    known = {place: value for place, value in numbers.items() if value is not None}
    axes.set_xticks(list(known), [short_number(value) for value in known.values()])
    upright = len(known) > UPRIGHT_NUMBERS_MAX
    axes.tick_params(axis="x", length=0, rotation=90 if upright else 0)
    for place, text in zip(known, axes.get_xticklabels(), strict=True):
        text.set(color=colors[place], fontweight="bold")
    axes.spines[["bottom", "top"]].set_visible(False)
    axes.set_xlabel(label)


def short_number(value: float) -> str:
    """Write a number that stands beside its mark."""
    if value == 0.0:
        return "0"
    if abs(value) < 0.001:
        return "<0.001"
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def rms(values: Array) -> float | None:
    """Return the root mean square of some values; None of none."""
    return float(np.sqrt((values**2).mean())) if len(values) else None


def draw_ecdf(axes: Any, values: Array, count: int, look: Series, label: str) -> None:
    """Draw which share of cases has at most an error: a step for every case.

    Args:
        axes: The panel.
        values: Errors of the cases that have one.
        count: Number of all cases: those without an error are never below any.
        look: Look of the curve.
        label: For the legend.
    """
    order = np.sort(values)
    share = np.arange(1, len(order) + 1) / max(count, 1)
    start, every = order[:1], max(1, len(order) // MARKED_SAMPLES)
    axes.plot(
        np.concatenate([start, order]), np.concatenate([[0.0] * len(start), share]),
        **line_style(look, len(order)) | {"markevery": slice(1, None, every)},
        drawstyle="steps-post", label=label,
    )  # fmt: skip


def finish_ecdf(panels: Sequence[Any], label: str) -> None:
    """Scale and name the axes of panels of distributions, all in one way."""
    known = [np.concatenate([x.get_xdata() for x in a.lines] or [np.zeros(0)]) for a in panels]
    logarithmic = any(spans_decades(values) for values in known)
    for axes, values in zip(panels, known, strict=True):
        axes.set(xlabel=label, ylim=(-0.03, 1.03))
        if logarithmic and (values > 0.0).all():
            set_log(axes, "x")
        else:
            axes.set_xlim(left=0.0)
        axes.grid(alpha=0.25)


def spans_decades(values: Array) -> bool:
    """Return whether values, of which those that are not finite do not count, need a log axis."""
    known = values[np.isfinite(values)]
    return bool(len(known) and known.min() > 0.0 and known.max() > LOG_AXIS_RATIO * known.min())


def enlargement(reference: Array, errors: Iterable[Array]) -> int:
    """Return how many times larger errors are drawn so that paths that overlap can be told apart.

    Args:
        reference: Path that the errors are relative to [m], shape (S, 3).
        errors: Errors of each path [m], shape (S, 3); rows that are not finite do not count. The
            largest become at most `ENLARGED_ERROR_RATIO` of the extent of the path.
    """
    sizes = [np.linalg.norm(error[np.isfinite(error[:, 0])], axis=1) for error in errors]
    largest = max(
        (float(np.percentile(size, ENLARGED_ERROR_PERCENTILE)) for size in sizes if len(size)),
        default=0.0,
    )
    extent = float(np.ptp(reference, axis=0).max())
    ratio = ENLARGED_ERROR_RATIO * extent / largest if largest > 0.0 else 1.0
    return max([factor for factor in ENLARGEMENTS if factor <= ratio], default=1)


def enlarged_text(factor: int) -> str:
    """Say in a title how errors are drawn."""
    return f"errors drawn {factor} times larger" if factor > 1 else "to scale"


def set_log(axes: Any, which: str) -> None:
    """Make an axis logarithmic, with plain numbers at decades and, if these are few, 2 and 5."""
    from matplotlib.ticker import LogLocator, NullFormatter

    getattr(axes, f"set_{which}scale")("log")
    low, high = getattr(axes, f"get_{which}lim")()
    subs = (1.0, 2.0, 5.0) if high < 100.0 * low else (1.0,)
    axis = getattr(axes, f"{which}axis")
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def put_legend(figure: Figure, *panels: Any) -> None:
    """Put the labels of some panels below the figure, each label once."""
    marks = {
        label: mark
        for axes in panels
        for mark, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    put_handles(figure, marks.values(), list(marks))


def put_marks(figure: Figure, looks: Mapping[str, Series]) -> None:
    """Put the look of each series below the figure: marker, colour and hatch."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [
        (
            Patch(facecolor=look.color, edgecolor=look.color, alpha=0.45, hatch=look.hatch),
            Line2D([], [], color=look.color, marker=look.marker, ls="", mec="white", mew=0.6, ms=5),
        )
        for look in looks.values()
    ]
    put_handles(figure, handles, list(looks))


def put_points(figure: Figure, looks: Mapping[str, Series]) -> None:
    """Put the marker of each series below the figure."""
    from matplotlib.lines import Line2D

    marks = [Line2D([], [], color=k.color, marker=k.marker, ls="", ms=5) for k in looks.values()]
    put_handles(figure, marks, list(looks))


def put_handles(figure: Figure, handles: Iterable[Any], labels: Sequence[str]) -> None:
    """Put a legend below the figure, in as many columns as it has room for."""
    from matplotlib.legend_handler import HandlerTuple

    known, side_by_side = list(handles), {Shades: HandlerTuple(ndivide=None, pad=0.0)}
    room = LEGEND_WIDTH_RATIO_MAX * figure.bbox.width
    for columns in range(max(1, min(len(labels), LEGEND_COLUMNS_MAX)), 0, -1):
        legend = figure.legend(
            known, labels, loc="outside lower center", ncols=columns, handler_map=side_by_side
        )
        if columns == 1 or legend.get_window_extent().width <= room:
            return
        legend.remove()
