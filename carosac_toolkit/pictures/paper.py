"""Figures of the paper that are drawn from validations and studies."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.pictures.comparison import draw_gaussians, draw_time
from carosac_toolkit.pictures.drawing import SERIES_COLORS, draw_violin, new_figure, put_patches
from carosac_toolkit.pictures.paper_figure import Drawn, FigureSource, PaperFigure, of_kind
from carosac_toolkit.pictures.validation import draw_length_errors, draw_paths, draw_violins
from carosac_toolkit.studies.compare.results import StudyResults, scored, tracked
from carosac_toolkit.studies.run.folder import read_rows
from carosac_toolkit.studies.run.run_case import plugin_name
from carosac_toolkit.validation.result import ValidationResult
from carosac_toolkit.validation.saved import read_samples

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MM_PER_M = 1e3
LEARNED, SOLVER = "td3", "kinematic_solver"  # whose scatter is compared
VALIDATE_COMMAND = "carosac validate RECORDING --models simulator kinematic_solver --output DIR"
COMPARE_COMMAND = "carosac compare --output DIR"
DRIVE_COMMAND = (
    "carosac compare --controllers kinematic_solver td3 --estimators dynamic_estimator "
    "--sensors lengths+imu --trajectories minimum_snap --speed 2.08 --acceleration 2 --output DIR"
)
GROUPS_MAX = len(SERIES_COLORS)
LENGTH_AXIS_PERCENTILE = 99.0  # percent of the values that the axis of lengths shows


def studies_of(sources: Sequence[FigureSource]) -> Iterator[tuple[Path, StudyResults]]:
    """Return the studies with at least one case that followed its path."""
    for folder in of_kind(sources, "study"):
        rows = tuple(read_rows(folder))
        if tracked(rows):
            yield folder, StudyResults(rows=rows, folder=folder)


def draw_commanded(results: StudyResults) -> Figure:
    """Draw the difference of unstrained from commanded lengths: per cable, and all together."""
    errors = length_errors(results)
    colors = dict(zip(errors, SERIES_COLORS, strict=False))
    figure = new_figure(12.0, 4.8)
    each, everything = figure.subplots(1, 2, width_ratios=(1.6, 1.0))
    cables = max(values.shape[1] for values in errors.values())
    end = max(
        float(np.percentile(np.abs(values), LENGTH_AXIS_PERCENTILE)) for values in errors.values()
    )
    bins = np.linspace(-end, end, 61)
    width = 0.8 / len(errors)
    for k, (label, values) in enumerate(errors.items()):
        for cable, column in enumerate(values.T):
            place = cable + (k - (len(errors) - 1) / 2) * width
            draw_violin(each, column, place, colors[label], width=0.9 * width, signed=True)
        flat = values.ravel()
        everything.hist(flat, bins=bins, histtype="step", density=True, color=colors[label], lw=1.5)
    each.set_xticks(range(cables), [f"cable {k + 1}" for k in range(cables)])
    each.set_ylabel("measured minus commanded length [mm]")
    each.set_title("per cable; dot: mean", fontsize=10)
    everything.set(xlabel="measured minus commanded length [mm]", ylabel="density [1/mm]")
    everything.set_title(f"all cables; drawn where {LENGTH_AXIS_PERCENTILE:g} % are", fontsize=10)
    for axes in (each, everything):
        axes.grid(axis="y", alpha=0.25)
        axes.set_axisbelow(True)
    figure.suptitle("Cable-length error of the winches: measured minus commanded, first seed")
    put_patches(figure, colors)
    return figure


def length_errors(results: StudyResults) -> dict[str, Array]:
    """Return measured minus commanded lengths of example cases [mm], shape (S, n), by label."""
    errors = {}
    for label, rows in list(zip(results.labels, results.groups, strict=True))[:GROUPS_MAX]:
        series = [json.loads(str(row["series"])) for row in scored(rows) if row.get("series")]
        values = [
            MM_PER_M * np.array(one["length_error_m"]) for one in series if "length_error_m" in one
        ]
        if values:
            errors[label] = np.concatenate(values)
    return errors


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
        draw=_validated(draw_violins), what="absolute error of the simulator per axis",
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
        what="absolute error over time per axis, rests shaded",
    ),
)  # fmt: skip
