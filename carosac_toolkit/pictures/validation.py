"""Pictures of a validation: paths, errors over axes and time, and cable-length errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from carosac_toolkit.arrays import Array
from carosac_toolkit.validation.result import ModelResult, ValidationResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MEASURED = "#202020"
REST = "#d9dde2"
MODELS = ("#d1622b", "#1f6f8b", "#7b4fa3", "#4c8c2b", "#b8336a", "#8a6d1f", "#5a6b7b", "#c79a00")


def draw_paths(result: ValidationResult) -> Figure:
    """Draw the measured and the modelled paths in space, from above and from the side."""
    figure = _figure(12.0, 7.2)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.35, 1.0))
    space = figure.add_subplot(grid[:, 0], projection="3d")
    paths = {"measured": (result.measured.position, MEASURED)}
    for name, (model, color) in _scored(result).items():
        paths[name] = (_positions(model), color)
    limits = _limits([path for path, _ in paths.values()])
    for name, (path, color) in paths.items():
        width = 1.6 if name == "measured" else 1.0
        space.plot(*path.T, color=color, lw=width, label=name)
    _set_space(space, limits)
    across = (0, 1) if np.ptp(limits[0]) >= np.ptp(limits[1]) else (1, 0)
    for row, pair in enumerate((across, (across[0], 2))):
        axes = figure.add_subplot(grid[row, 1])
        for name, (path, color) in paths.items():
            axes.plot(*path[:, list(pair)].T, color=color, lw=1.4 if name == "measured" else 0.9)
        axes.set(xlabel=f"{'xyz'[pair[0]]} [m]", ylabel=f"{'xyz'[pair[1]]} [m]")
        axes.set(xlim=limits[pair[0]], ylim=limits[pair[1]], aspect="equal")
        side = f"from the side, along {'xy'[across[1]]}"
        axes.set_title("from above" if row == 0 else side, fontsize=9)
        axes.grid(alpha=0.25)
    figure.suptitle(f"{result.robot.name}: path of the platform origin, {result.samples} samples")
    _legend(figure, space)
    return figure


def draw_violins(result: ValidationResult) -> Figure:
    """Draw the distribution of the absolute position error, per axis and in norm."""
    figure = _figure(12.0, 4.8)
    models = _scored(result)
    panels = figure.subplots(1, 4, sharey=False)
    for column, axes in enumerate(panels):
        for place, (model, color) in enumerate(models.values()):
            error = _error(result, model)
            error = error[np.isfinite(error[:, 0])]
            size = np.linalg.norm(error, axis=1) if column == 3 else np.abs(error[:, column])
            _violin(axes, size * 1e3, place, color)
        axes.set_title("norm" if column == 3 else "xyz"[column], fontsize=10)
        axes.set_xticks([])
        axes.set_xlim(-0.6, len(models) - 0.4)
        axes.set_ylim(bottom=0.0)
        axes.grid(axis="y", alpha=0.25)
    panels[0].set_ylabel("absolute position error [mm]")
    figure.suptitle("Position error: distribution; bar: RMSE; dot: median")
    _patches(figure, {name: color for name, (_, color) in models.items()})
    return figure


def draw_time_series(result: ValidationResult) -> Figure:
    """Draw positions and errors over time, with the rests of the winches shaded."""
    figure = _figure(12.5, 12.0)
    models = _scored(result)
    panels = figure.subplots(6, 1, sharex=True, height_ratios=(1.25, 1.0) * 3)
    time = result.time
    for axis, name in enumerate("xyz"):
        place, below = panels[2 * axis], panels[2 * axis + 1]
        known = result.measured.position[:, axis]
        place.plot(time, known, color=MEASURED, lw=1.6, label="measured")
        for label, (model, color) in models.items():
            place.plot(time, _positions(model)[:, axis], color=color, lw=1.0, label=label)
            below.plot(time, _error(result, model)[:, axis] * 1e3, color=color, lw=1.0)
        below.axhline(0.0, color=MEASURED, lw=0.6)
        place.set_ylabel(f"{name} [m]")
        below.set_ylabel(f"error in {name} [mm]")
        for axes in (place, below):
            axes.grid(alpha=0.25)
            axes.margins(x=0.005)
    for axes in panels:
        for k, (first, end) in enumerate(result.rests):
            shade = axes.axvspan(time[first], time[end - 1], color=REST, lw=0, zorder=0)
            if k == 0 and axes is panels[0]:
                shade.set_label("winches at rest")
    figure.align_ylabels(panels)
    panels[-1].set_xlabel("time [s]")
    figure.suptitle("Measured and modelled position, and error (model minus measured), over time")
    _legend(figure, panels[0])
    return figure


def draw_length_errors(result: ValidationResult) -> Figure:
    """Draw the distribution of the cable-length error, per cable and over all cables."""
    figure = _figure(12.0, 4.8)
    names = result.robot.cable_names
    models = _scored(result)
    each, everything = figure.subplots(1, 2, width_ratios=(1.7, 1.0))
    count = max(len(models), 1)
    width = 0.8 / count
    errors = [_length_error(model) for model, _ in models.values()]
    pooled = np.concatenate([error[np.isfinite(error)] for error in errors] or [np.zeros(0)])
    bins = np.histogram_bin_edges(pooled, bins=40)
    for place, (error, (_, color)) in enumerate(zip(errors, models.values(), strict=True)):
        known = [column[np.isfinite(column)] for column in error.T]
        for cable, values in enumerate(known):
            offset = (place - (count - 1) / 2) * width
            _violin(each, values, cable + offset, color, width=0.9 * width, signed=True)
        flat = np.concatenate(known)
        if len(flat):
            everything.hist(flat, bins=bins, histtype="step", density=True, color=color, lw=1.5)
    each.set_xticks(range(len(names)), names, rotation=20 if len(names) > 4 else 0)
    each.axhline(0.0, color=MEASURED, lw=0.6)
    each.set_ylabel("measured minus predicted length [mm]")
    each.grid(axis="y", alpha=0.25)
    everything.set(xlabel="measured minus predicted length [mm]", ylabel="density [1/mm]")
    everything.set_title("all cables", fontsize=10)
    everything.grid(alpha=0.25)
    each.set_title("per cable; dot: mean", fontsize=10)
    figure.suptitle("Cable-length error at the measured poses")
    _patches(figure, {name: color for name, (_, color) in models.items()})
    return figure


PICTURES: Mapping[str, Callable[[ValidationResult], Figure]] = {
    "paths": draw_paths,
    "error_violins": draw_violins,
    "time_series": draw_time_series,
    "length_errors": draw_length_errors,
}


def _figure(width: float, height: float) -> Figure:
    """Make a figure without a window."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _scored(result: ValidationResult) -> dict[str, tuple[ModelResult, str]]:
    """Models with scores, each with its colour, which does not depend on the others' success."""
    return {
        name: (model, MODELS[k % len(MODELS)])
        for k, (name, model) in enumerate(result.models.items())
        if model.scores is not None
    }


def _positions(model: ModelResult) -> Array:
    """Positions [m], (S, 3), NaN where the model found none: a gap in the line."""
    assert model.pose is not None and model.converged is not None
    return np.asarray(np.where(model.converged[:, None], model.pose.position, np.nan))


def _error(result: ValidationResult, model: ModelResult) -> Array:
    """Model minus measured position [m], shape (S, 3), NaN where the model found none."""
    return _positions(model) - result.measured.position


def _length_error(model: ModelResult) -> Array:
    """Measured minus predicted lengths [mm], shape (S, n)."""
    assert model.length_error is not None
    return np.asarray(1e3 * model.length_error)


def _limits(paths: list[Array]) -> Array:
    """Lower and upper end of the drawn range of each axis [m], shape (3, 2)."""
    points = np.vstack(paths)
    lower, upper = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    longest = max(float((upper - lower).max()), 1e-3)
    middle, half = (lower + upper) / 2, np.maximum(upper - lower, 0.15 * longest) / 2
    return np.stack([middle - half - 0.04 * longest, middle + half + 0.04 * longest], axis=1)


def _set_space(axes: Any, limits: Array) -> None:
    """Set limits, aspect, view and labels of the view in three dimensions."""
    from matplotlib.ticker import MaxNLocator

    axes.set(xlim=limits[0], ylim=limits[1], zlim=limits[2])
    spans = limits[:, 1] - limits[:, 0]
    axes.set_box_aspect(spans / spans.max(), zoom=0.95)
    axes.view_init(elev=22.0, azim=-50.0)
    for axis, name, span in zip((axes.xaxis, axes.yaxis, axes.zaxis), "xyz", spans, strict=True):
        axis.set_label_text(f"{name} [m]")
        axis.labelpad = 12.0 * span / spans.max() - 2.0
        axis.set_major_locator(MaxNLocator(nbins=max(2, round(7 * span / spans.max()))))
        axis.set_tick_params(labelsize=8)


def _violin(
    axes: Any, values: Array, place: float, color: str, *, width: float = 0.8, signed: bool = False
) -> None:
    """Draw one violin [mm] with its RMSE and median, or, if signed, its mean."""
    if len(values) == 0:
        return
    body = axes.violinplot(values, positions=[place], widths=width, showextrema=False)["bodies"][0]
    body.set(facecolor=color, edgecolor=color, alpha=0.45)
    middle = values.mean() if signed else np.median(values)
    axes.plot(place, middle, "o", color=color, ms=4, mec="white", mew=0.6)
    if not signed:
        root = float(np.sqrt((values**2).mean()))
        axes.hlines(root, place - 0.25 * width, place + 0.25 * width, color=color, lw=2.0)
        axes.annotate(
            f"{root:.1f}" if root >= 0.1 else f"{root:.1g}", (place + 0.27 * width, root),
            xytext=(2, 0), textcoords="offset points", va="center", fontsize=8,
        )  # fmt: skip


def _legend(figure: Figure, axes: Any) -> None:
    """Put the labels of one panel below the figure."""
    handles, labels = axes.get_legend_handles_labels()
    columns = min(len(labels), 6)
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)


def _patches(figure: Figure, colors: Mapping[str, str]) -> None:
    """Put one coloured patch per model below the figure."""
    from matplotlib.patches import Patch

    handles = [Patch(color=color, alpha=0.6, label=name) for name, color in colors.items()]
    columns = min(max(len(handles), 1), 6)
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, frameon=False)
