"""Figures of the paper that are drawn from validations and studies."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.pictures.comparison import draw_time
from carosac_toolkit.pictures.drawing import (
    VIOLIN_VALUES_MIN,
    draw_violin,
    new_figure,
    put_marks,
    set_title,
)
from carosac_toolkit.pictures.groups import (
    Group,
    cable_names,
    groups_of,
    looks_of,
    robots_title,
)
from carosac_toolkit.pictures.paper_figure import Drawn, FigureSource, PaperFigure, of_kind
from carosac_toolkit.pictures.style import DOUBLE_COLUMN_INCH, MEASURED_COLOR, Series, styled
from carosac_toolkit.pictures.units import unit_of
from carosac_toolkit.pictures.validation import draw_length_errors, draw_paths, draw_violins
from carosac_toolkit.studies.compare.results import AXIS_NAMES, StudyResults, scored, tracked
from carosac_toolkit.studies.run.folder import read_rows
from carosac_toolkit.studies.run.run_case import plugin_name
from carosac_toolkit.validation.result import ValidationResult
from carosac_toolkit.validation.saved import read_samples

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEARNED, SOLVER = "td3", "kinematic_solver"  # whose scatter is compared
VALIDATE_COMMAND = "carosac validate RECORDING --models simulator kinematic_solver --output DIR"
COMPARE_COMMAND = "carosac compare --output DIR"
DRIVE_COMMAND = (
    "carosac compare --controllers kinematic_solver td3 --estimators dynamic_estimator "
    "--sensors lengths+imu --trajectories minimum_snap --speed 2.08 --acceleration 2 --output DIR"
)
BELL_LINE_RATIO = 0.11  # of the height of a bell: between the ticks of two groups below it
BELL_LINE_INCH = 0.14  # [inch] between the same
LENGTH_AXIS_PERCENTILE = 99.0  # percent of the values that the axis of lengths shows


def studies_of(sources: Sequence[FigureSource]) -> Iterator[tuple[Path, StudyResults]]:
    """Return the studies with at least one case that followed its path."""
    for folder in of_kind(sources, "study"):
        rows = tuple(read_rows(folder))
        if tracked(rows):
            yield folder, StudyResults(rows=rows, folder=folder)


@styled
def draw_commanded(results: StudyResults) -> Figure:
    """Draw the difference of unstrained from commanded lengths: per cable, and all together."""
    kept = length_errors(results)
    unit, factor = unit_of(errors for _, errors in kept)
    errors = [factor * values for _, values in kept]
    figure = new_figure(DOUBLE_COLUMN_INCH, 3.2)
    each, everything = figure.subplots(1, 2, width_ratios=(1.6, 1.0))
    cables = max(values.shape[1] for values in errors)
    end = max(float(np.percentile(np.abs(values), LENGTH_AXIS_PERCENTILE)) for values in errors)
    bins = np.linspace(-end, end, 61)
    width = 0.8 / len(kept)
    for k, ((group, _), values) in enumerate(zip(kept, errors, strict=True)):
        look = group.look
        for cable, column in enumerate(values.T):
            place = cable + (k - (len(errors) - 1) / 2) * width
            draw_violin(each, column, place, look, width=0.9 * width)
        everything.hist(
            values.ravel(), bins=bins, histtype="step", density=True, color=look.color,
            ls=look.line, lw=1.2,
        )  # fmt: skip
    names = cable_names(results, cables)
    each.set_xticks(range(cables), names, rotation=35 if cables > 4 else 0)
    each.set_ylabel(f"measured minus commanded length [{unit}]")
    each.set_title("per cable; marker: mean")
    everything.set(xlabel=f"measured minus commanded length [{unit}]", ylabel=f"density [1/{unit}]")
    everything.set_title(f"all cables; the middle {LENGTH_AXIS_PERCENTILE:g} %")
    for axes in (each, everything):
        axes.grid(axis="y", alpha=0.25)
        axes.set_axisbelow(True)
    set_title(figure, f"{robots_title(results)}: cable-length error of the winches, first seed")
    put_marks(figure, looks_of([group for group, _ in kept]))
    return figure


def length_errors(results: StudyResults) -> list[tuple[Group, Array]]:
    """Return measured minus commanded lengths of example cases [m], shape (S, n), by group."""
    errors = []
    for group in groups_of(results):
        series = [json.loads(str(row["series"])) for row in scored(group.rows) if row.get("series")]
        values = [np.array(one["length_error_m"]) for one in series if "length_error_m" in one]
        if values:
            errors.append((group, np.concatenate(values)))
    return errors


@styled
def draw_gaussians(results: StudyResults) -> Figure:
    """Draw the scatter of the RMSE over cases as the paper does: as a normal distribution.

    It reaches below zero where cases scatter much; other pictures show the distribution itself.
    """
    groups = groups_of(results)
    panel = BELL_LINE_INCH * (1.0 / BELL_LINE_RATIO + len(groups) + 1.0)
    figure = new_figure(DOUBLE_COLUMN_INCH, 2.0 * (panel + 0.6) + 0.5 + 0.1 * len(groups))
    panels = figure.subplots(2, 2).ravel()
    columns = {
        name: [np.array([row[f"tracking_rmse_{name}_m"] for row in tracked(group.rows)], float)
               for group in groups]
        for name in AXIS_NAMES
    }  # fmt: skip
    unit, factor = unit_of(values for some in columns.values() for values in some)
    for axes, (name, some) in zip(panels, columns.items(), strict=True):
        for place, (group, values) in enumerate(zip(groups, some, strict=True)):
            if len(values):
                _bell(axes, factor * values, -BELL_LINE_RATIO * (place + 1), group.look)
        axes.set_title(name)
        axes.set(
            xlabel=f"RMSE of a case [{unit}]",
            yticks=[],
            ylim=(-BELL_LINE_RATIO * (len(groups) + 0.8), 1.1),
        )
        axes.axhline(0.0, color=MEASURED_COLOR, lw=0.6)
        axes.grid(axis="x", alpha=0.25)
    set_title(
        figure,
        f"{robots_title(results)}: RMSE per case (ticks), mean ± standard deviation (right); "
        f"from {VIOLIN_VALUES_MIN} cases on their normal distribution",
    )
    put_marks(figure, looks_of(groups))
    return figure


def _bell(axes: Any, values: Array, low: float, look: Series) -> None:
    """Draw values as ticks below zero and, if there are enough, their normal distribution above."""
    color = look.color
    axes.plot(values, np.full(len(values), low), "|", color=color, ms=5, alpha=0.7)
    mean, deviation = float(values.mean()), float(values.std(ddof=1)) if len(values) > 1 else 0.0
    text = f"{mean:.1f}"
    if deviation > 0.0 and len(values) >= VIOLIN_VALUES_MIN:
        text += f" ± {deviation:.1f}"
        grid = mean + deviation * np.linspace(-3.5, 3.5, 141)
        height = np.exp(-0.5 * ((grid - mean) / deviation) ** 2)
        axes.fill_between(grid, height, color=color, alpha=0.2, lw=0.0)
        axes.plot(grid, height, color=color, ls=look.line)
        axes.plot(mean, 1.0, look.marker, color=color, ms=4.5, mec="white", mew=0.6)
    beside = axes.get_yaxis_transform()
    axes.text(1.02, low, text, transform=beside, ha="left", va="center", color=color, fontsize=7)


def _validated(draw: Callable[[ValidationResult], Figure]) -> Callable[..., list[Drawn]]:
    """Return a figure of the first validation that has a score."""

    def drawn(sources: Sequence[FigureSource]) -> list[Drawn]:
        for folder in of_kind(sources, "validation"):
            result = read_samples(folder)
            if any(model.scores is not None for model in result.models.values()):
                return [Drawn(figure=draw(result), source=folder)]
        return []

    return drawn


def _commanded(sources: Sequence[FigureSource]) -> list[Drawn]:
    """Draw the winches' lengths of the first study that kept them."""
    for folder, results in studies_of(sources):
        if length_errors(results):
            return [Drawn(figure=draw_commanded(results), source=folder)]
    return []


def _scatter(sources: Sequence[FigureSource]) -> list[Drawn]:
    """Draw the scatter of the RMSE of policy and kinematic solver, in the first such study."""
    for folder, results in studies_of(sources):
        rows = tuple(
            row for row in results.rows
            if plugin_name(str(row["controller"])) in (LEARNED, SOLVER)
        )  # fmt: skip
        if {plugin_name(str(row["controller"])) for row in tracked(rows)} == {LEARNED, SOLVER}:
            return [Drawn(figure=draw_gaussians(replace(results, rows=rows)), source=folder)]
    return []


def _over_time(sources: Sequence[FigureSource]) -> list[Drawn]:
    """Draw errors over time of the first study that kept the time series of a case."""
    for folder, results in studies_of(sources):
        if any(row.get("series") for row in tracked(results.rows)):
            return [Drawn(figure=draw_time(results), source=folder)]
    return []


FIGURES = (
    PaperFigure(
        place=1, name="simulated_and_real_path", command=VALIDATE_COMMAND,
        draw=_validated(draw_paths), what="path in space, simulated against real",
    ),
    PaperFigure(
        place=2, name="simulation_error_violins", command=VALIDATE_COMMAND,
        draw=_validated(draw_violins), what="error of the simulator per axis",
    ),
    PaperFigure(
        place=3, name="measured_length_error", command=VALIDATE_COMMAND,
        draw=_validated(draw_length_errors),
        what="cable-length error at the measured poses",
    ),
    PaperFigure(
        place=4, name="commanded_length_error", command=COMPARE_COMMAND, draw=_commanded,
        what="cable-length error, commanded against measured",
    ),
    PaperFigure(
        place=10, name="rmse_gaussians", command=DRIVE_COMMAND, draw=_scatter,
        what="scatter of the RMSE over trajectories, learned against kinematic solver",
    ),
    PaperFigure(
        place=11, name="error_over_time", command=COMPARE_COMMAND, draw=_over_time,
        what="error over time per axis, rests shaded",
    ),
)  # fmt: skip
