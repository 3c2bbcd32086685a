"""Pictures of a validation: paths, errors over axes and time, and cable-length errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.tables import counted
from carosac_toolkit.pictures.drawing import (
    DOTTED_SAMPLES_MAX,
    Path,
    draw_in_space,
    draw_violin,
    enlarged_text,
    enlargement,
    line_style,
    new_figure,
    number_below,
    put_legend,
    put_marks,
    rms,
    set_title,
    views,
)
from carosac_toolkit.pictures.style import (
    DOUBLE_COLUMN_INCH,
    MEASURED_COLOR,
    MODEL_NUMBERS,
    REST_COLOR,
    Series,
    looks_by_name,
    styled,
)
from carosac_toolkit.pictures.units import unit_of
from carosac_toolkit.studies.compare.results import AXIS_NAMES
from carosac_toolkit.validation.result import ModelResult, ValidationResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@styled
def draw_paths(result: ValidationResult) -> Figure:
    """Draw the measured and the modelled paths, their differences enlarged, in three views."""
    figure = new_figure(DOUBLE_COLUMN_INCH, 4.4)
    known, models = result.measured.position, _scored(result)
    errors = {name: _error(result, model) for name, (model, _) in models.items()}
    factor = enlargement(known, errors.values())
    black = {"color": MEASURED_COLOR, "lw": 1.2, **_dots(result)}
    paths: dict[str, Path] = {"measured": (known, black)}
    for name, (_, look) in models.items():
        paths[name] = (known + factor * errors[name], _line(result, look))
    draw_in_space(figure, paths, views(result.robot))
    set_title(
        figure,
        f"{result.robot.name}: path of the platform origin, "
        f"{counted(result.samples, 'sample')}, {enlarged_text(factor)}",
    )
    return figure


@styled
def draw_violins(result: ValidationResult) -> Figure:
    """Draw the distribution of the signed position error per axis, and of its norm."""
    figure = new_figure(DOUBLE_COLUMN_INCH, 3.0)
    models = _scored(result)
    panels = figure.subplots(1, 4, sharey=False)
    errors = {name: _error(result, model) for name, (model, _) in models.items()}
    unit, factor = unit_of(errors.values())
    for column, (title, axes) in enumerate(zip(AXIS_NAMES, panels, strict=True)):
        numbers: dict[float, float | None] = {}
        for place, (name, (_, look)) in enumerate(models.items()):
            error = factor * errors[name][np.isfinite(errors[name][:, 0])]
            size = np.linalg.norm(error, axis=1) if column == 3 else error[:, column]
            draw_violin(axes, size, place, look)
            numbers[place] = rms(size)
        axes.set_title(title)
        axes.set_xlim(-0.6, len(models) - 0.4)
        axes.margins(y=0.08)
        colors: dict[float, str] = {
            place: look.color for place, (_, look) in enumerate(models.values())
        }
        number_below(axes, numbers, f"RMSE [{unit}]", colors)
        axes.axhline(0.0, color=MEASURED_COLOR, lw=0.6, zorder=0)
        axes.grid(axis="y", alpha=0.25)
    panels[0].set_ylabel(f"model minus measured position [{unit}]")
    set_title(figure, f"{result.robot.name}: position error of all samples; marker: mean")
    put_marks(figure, _looks(models))
    return figure


@styled
def draw_time_series(result: ValidationResult) -> Figure:
    """Draw positions and errors over time, with the rests of the winches shaded."""
    figure = new_figure(DOUBLE_COLUMN_INCH, 8.0)
    models = _scored(result)
    panels = figure.subplots(6, 1, sharex=True, height_ratios=(1.25, 1.0) * 3)
    time, dots = result.time, _dots(result)
    unit, factor = unit_of(_error(result, model) for model, _ in models.values())
    for axis, name in enumerate("xyz"):
        place, below = panels[2 * axis], panels[2 * axis + 1]
        known = result.measured.position[:, axis]
        place.plot(time, known, color=MEASURED_COLOR, lw=1.4, label="measured", **dots)
        for label, (model, look) in models.items():
            style = _line(result, look)
            place.plot(time, _positions(model)[:, axis], label=label, **style)
            below.plot(time, _error(result, model)[:, axis] * factor, **style)
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
    set_title(
        figure,
        f"{result.robot.name}: position over time, measured and modelled, and error "
        "(model minus measured)",
    )
    put_legend(figure, panels[0])
    return figure


@styled
def draw_length_errors(result: ValidationResult) -> Figure:
    """Draw the distribution of the cable-length error, per cable and over all cables."""
    figure = new_figure(DOUBLE_COLUMN_INCH, 3.2)
    names = result.robot.cable_names
    models = _scored(result)
    each, everything = figure.subplots(1, 2, width_ratios=(1.7, 1.0))
    count = max(len(models), 1)
    width = 0.8 / count
    unit, factor = unit_of(_length_error(model) for model, _ in models.values())
    errors = [_length_error(model) * factor for model, _ in models.values()]
    pooled = np.concatenate([error[np.isfinite(error)] for error in errors] or [np.zeros(0)])
    bins = np.histogram_bin_edges(pooled, bins=40)
    for place, (error, (_, look)) in enumerate(zip(errors, models.values(), strict=True)):
        known = [column[np.isfinite(column)] for column in error.T]
        for cable, values in enumerate(known):
            offset = (place - (count - 1) / 2) * width
            draw_violin(each, values, cable + offset, look, width=0.9 * width)
        flat = np.concatenate(known)
        if len(flat):
            everything.hist(
                flat, bins=bins, histtype="step", density=True, color=look.color, ls=look.line,
                lw=1.2,
            )  # fmt: skip
    each.set_xticks(range(len(names)), names, rotation=35 if len(names) > 4 else 0)
    each.axhline(0.0, color=MEASURED_COLOR, lw=0.6)
    each.set_ylabel(f"measured minus predicted length [{unit}]")
    each.grid(axis="y", alpha=0.25)
    everything.set(xlabel=f"measured minus predicted length [{unit}]", ylabel=f"density [1/{unit}]")
    everything.set_title("all cables")
    everything.grid(alpha=0.25)
    each.set_title("per cable; marker: mean")
    set_title(figure, f"{result.robot.name}: cable-length error at the measured poses")
    put_marks(figure, _looks(models))
    return figure


VALIDATION_PICTURES: Mapping[str, Callable[[ValidationResult], Figure]] = {
    "paths": draw_paths,
    "error_violins": draw_violins,
    "time_series": draw_time_series,
    "length_errors": draw_length_errors,
}


def _scored(result: ValidationResult) -> dict[str, tuple[ModelResult, Series]]:
    """Return models with scores, each with a look that does not depend on the others' success."""
    looks = looks_by_name(list(result.models), MODEL_NUMBERS)
    return {
        name: (model, look)
        for (name, model), look in zip(result.models.items(), looks, strict=True)
        if model.scores is not None
    }


def _looks(models: Mapping[str, tuple[ModelResult, Series]]) -> dict[str, Series]:
    """Return the looks of models for a legend."""
    return {name: look for name, (_, look) in models.items()}


def _line(result: ValidationResult, look: Series) -> dict[str, Any]:
    """Return the style of the line of a model."""
    return line_style(look, result.samples) | {"lw": 1.0} | _dots(result)


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


def _dots(result: ValidationResult) -> dict[str, Any]:
    """Return markers, if so few samples would leave a line alone invisible."""
    return {"marker": "o", "ms": 3, "markevery": 1} if result.samples <= DOTTED_SAMPLES_MAX else {}
