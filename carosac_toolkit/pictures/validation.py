"""Pictures of a validation: paths, errors over axes and time, and cable-length errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.pictures.drawing import (
    DOTTED_SAMPLES_MAX,
    MEASURED_COLOR,
    REST_COLOR,
    SERIES_COLORS,
    draw_in_space,
    draw_violin,
    new_figure,
    put_legend,
    put_patches,
    views,
)
from carosac_toolkit.validation.quantities import unit_for
from carosac_toolkit.validation.result import ModelResult, ValidationResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_paths(result: ValidationResult) -> Figure:
    """Draw the measured and the modelled paths in space, from above and from the side."""
    figure = new_figure(12.0, 7.2)
    dots = _dots(result)
    black = {"color": MEASURED_COLOR, **dots}
    paths = {"measured": (result.measured.position, {"lw": 1.6, **black}, {"lw": 1.4, **black})}
    for name, (model, color) in _scored(result).items():
        style = {"color": color, **dots}
        paths[name] = (_positions(model), {"lw": 1.0, **style}, {"lw": 0.9, **style})
    draw_in_space(figure, paths, views(result.robot))
    figure.suptitle(f"{result.robot.name}: path of the platform origin, {_count(result)}")
    return figure


def draw_violins(result: ValidationResult) -> Figure:
    """Draw the distribution of the absolute position error, per axis and in norm."""
    figure = new_figure(12.0, 4.8)
    models = _scored(result)
    panels = figure.subplots(1, 4, sharey=False)
    unit, factor = _unit([_error(result, model) for model, _ in models.values()])
    for column, axes in enumerate(panels):
        for place, (model, color) in enumerate(models.values()):
            error = _error(result, model)
            error = error[np.isfinite(error[:, 0])]
            size = np.linalg.norm(error, axis=1) if column == 3 else np.abs(error[:, column])
            draw_violin(axes, size * factor, place, color)
        axes.set_title("norm" if column == 3 else "xyz"[column], fontsize=10)
        top = axes.get_ylim()[1]
        ends = (-0.04 * top, 1.04 * top)  # an error of zero stands clear of the edge
        axes.set(xticks=[], xlim=(-0.6, len(models) - 0.4), ylim=ends)
        axes.grid(axis="y", alpha=0.25)
    panels[0].set_ylabel(f"absolute position error [{unit}]")
    figure.suptitle("Position error: distribution; bar: RMSE; dot: median")
    put_patches(figure, {name: color for name, (_, color) in models.items()})
    return figure


def draw_time_series(result: ValidationResult) -> Figure:
    """Draw positions and errors over time, with the rests of the winches shaded."""
    figure = new_figure(12.5, 12.0)
    models = _scored(result)
    panels = figure.subplots(6, 1, sharex=True, height_ratios=(1.25, 1.0) * 3)
    time, dots = result.time, _dots(result)
    unit, factor = _unit([_error(result, model) for model, _ in models.values()])
    for axis, name in enumerate("xyz"):
        place, below = panels[2 * axis], panels[2 * axis + 1]
        known = result.measured.position[:, axis]
        place.plot(time, known, color=MEASURED_COLOR, lw=1.6, label="measured", **dots)
        for label, (model, color) in models.items():
            place.plot(time, _positions(model)[:, axis], color=color, lw=1.0, label=label, **dots)
            below.plot(time, _error(result, model)[:, axis] * factor, color=color, lw=1.0, **dots)
        below.axhline(0.0, color=MEASURED_COLOR, lw=0.6)
        place.set_ylabel(f"{name} [m]")
        below.set_ylabel(f"error in {name} [{unit}]")
    for axes in panels:
        axes.grid(alpha=0.25)
        axes.margins(x=0.005)
        for k, (first, end) in enumerate(result.rests):
            shade = axes.axvspan(time[first], time[end - 1], color=REST_COLOR, lw=0, zorder=0)
            if k == 0 and axes is panels[0]:
                shade.set_label("winches at rest")
    figure.align_ylabels(panels)
    panels[-1].set_xlabel("time [s]")
    figure.suptitle("Measured and modelled position, and error (model minus measured), over time")
    put_legend(figure, panels[0])
    return figure


def draw_length_errors(result: ValidationResult) -> Figure:
    """Draw the distribution of the cable-length error, per cable and over all cables."""
    figure = new_figure(12.0, 4.8)
    names = result.robot.cable_names
    models = _scored(result)
    each, everything = figure.subplots(1, 2, width_ratios=(1.7, 1.0))
    count = max(len(models), 1)
    width = 0.8 / count
    unit, factor = _unit([_length_error(model) for model, _ in models.values()])
    errors = [_length_error(model) * factor for model, _ in models.values()]
    pooled = np.concatenate([error[np.isfinite(error)] for error in errors] or [np.zeros(0)])
    bins = np.histogram_bin_edges(pooled, bins=40)
    for place, (error, (_, color)) in enumerate(zip(errors, models.values(), strict=True)):
        known = [column[np.isfinite(column)] for column in error.T]
        for cable, values in enumerate(known):
            offset = (place - (count - 1) / 2) * width
            draw_violin(each, values, cable + offset, color, width=0.9 * width, signed=True)
        flat = np.concatenate(known)
        if len(flat):
            everything.hist(flat, bins=bins, histtype="step", density=True, color=color, lw=1.5)
    each.set_xticks(range(len(names)), names, rotation=20 if len(names) > 4 else 0)
    each.axhline(0.0, color=MEASURED_COLOR, lw=0.6)
    each.set_ylabel(f"measured minus predicted length [{unit}]")
    each.grid(axis="y", alpha=0.25)
    everything.set(xlabel=f"measured minus predicted length [{unit}]", ylabel=f"density [1/{unit}]")
    everything.set_title("all cables", fontsize=10)
    everything.grid(alpha=0.25)
    each.set_title("per cable; dot: mean", fontsize=10)
    figure.suptitle("Cable-length error at the measured poses")
    put_patches(figure, {name: color for name, (_, color) in models.items()})
    return figure


VALIDATION_PICTURES: Mapping[str, Callable[[ValidationResult], Figure]] = {
    "paths": draw_paths,
    "error_violins": draw_violins,
    "time_series": draw_time_series,
    "length_errors": draw_length_errors,
}


def _scored(result: ValidationResult) -> dict[str, tuple[ModelResult, str]]:
    """Yield models with scores, each with a colour that does not depend on the others' success."""
    return {
        name: (model, SERIES_COLORS[k % len(SERIES_COLORS)])
        for k, (name, model) in enumerate(result.models.items())
        if model.scores is not None
    }


def _positions(model: ModelResult) -> Array:
    """Return positions [m], (S, 3), NaN where the model failed: a gap in the line."""
    assert model.pose is not None and model.converged is not None
    return np.asarray(np.where(model.converged[:, None], model.pose.position, np.nan))


def _error(result: ValidationResult, model: ModelResult) -> Array:
    """Return model minus measured position [m], shape (S, 3), NaN where the model failed."""
    return _positions(model) - result.measured.position


def _length_error(model: ModelResult) -> Array:
    """Return measured minus predicted lengths [m], shape (S, n)."""
    assert model.length_error is not None
    return model.length_error


def _unit(errors: list[Array]) -> tuple[str, float]:
    """Return the unit for the largest of some errors [m], and its number per metre."""
    known = [np.abs(error[np.isfinite(error)]) for error in errors]
    return unit_for(max((float(error.max()) for error in known if error.size), default=0.0))


def _dots(result: ValidationResult) -> dict[str, Any]:
    """Return markers, if so few samples would leave a line alone invisible."""
    return {"marker": "o", "ms": 4} if result.samples <= DOTTED_SAMPLES_MAX else {}


def _count(result: ValidationResult) -> str:
    return f"{result.samples} sample" + ("s" if result.samples != 1 else "")
