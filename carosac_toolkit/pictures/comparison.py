"""Pictures of a study: errors over cases, time, space and regions, one colour per group."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.pictures.drawing import (
    MEASURED_COLOR,
    REST_COLOR,
    SERIES_COLORS,
    STANDARD_VIEWS,
    VIOLIN_VALUES_MIN,
    Path,
    draw_bell,
    draw_in_space,
    draw_violin,
    new_figure,
    put_legend,
    put_patches,
)
from carosac_toolkit.pictures.estimates import draw_estimates
from carosac_toolkit.studies.compare.example_cases import MM_PER_M, Example, examples_of
from carosac_toolkit.studies.compare.results import AXIS_NAMES, StudyResults, tracked
from carosac_toolkit.studies.run.rows import Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LABELLED_GROUPS_MAX = 4  # groups up to which bars have room for their numbers
GROUPS_MAX = len(SERIES_COLORS)  # groups that can be told apart
TIME_PLOT_TRAJECTORIES = (
    "waypoints",
    "minimum_snap",
)  # what is shown over time, first choice first
PATH_PLOT_TRAJECTORIES = ("spiral", "minimum_snap")


def draw_violins(results: StudyResults) -> Figure:
    """Draw the distribution of the absolute tracking error over the samples of example cases."""
    figure = new_figure(12.0, 4.8)
    groups = _groups(results)
    panels = figure.subplots(1, 4)
    shown: set[str] = set()
    for place, (rows, color) in enumerate(groups.values()):
        examples = examples_of(rows)
        shown |= {example.trajectory for example in examples}
        errors = [example.error for example in examples]
        for column, axes in enumerate(panels if errors else ()):
            draw_violin(axes, np.concatenate(errors)[:, column], place, color)
    for name, axes in zip(AXIS_NAMES, panels, strict=True):
        top = axes.get_ylim()[1]
        axes.set(xticks=[], xlim=(-0.6, len(groups) - 0.2), ylim=(-0.04 * top, top))
        axes.set_title(name, fontsize=10)
        axes.grid(axis="y", alpha=0.25)
    panels[0].set_ylabel("absolute tracking error [mm]")
    count = f"{len(shown)} trajector" + ("ies" if len(shown) != 1 else "y")
    figure.suptitle(
        f"Tracking error of all samples of {count}, first seed; bar: RMSE; dot: median"
        + _left_out(results)
    )
    put_patches(figure, _colors(groups))
    return figure


def draw_gaussians(results: StudyResults) -> Figure:
    """Draw the scatter of the RMSE over cases: a normal distribution over the cases themselves."""
    figure = new_figure(12.0, 7.0)
    groups = _groups(results)
    panels = figure.subplots(2, 2).ravel()
    for axes, name in zip(panels, AXIS_NAMES, strict=True):
        for place, (rows, color) in enumerate(groups.values()):
            column = [row[f"tracking_rmse_{name}_m"] for row in tracked(rows)]
            _bell(axes, MM_PER_M * np.array(column, dtype=float), place, color)
        axes.set_title(name, fontsize=10)
        end = axes.get_xlim()[1]
        axes.set(xlabel="RMSE of a case [mm]", yticks=[], xlim=(-0.02 * end, 1.1 * end))
        axes.axhline(0.0, color=MEASURED_COLOR, lw=0.6)
        axes.grid(axis="x", alpha=0.25)
    figure.suptitle(
        "RMSE per case; ticks: the cases; number: mean and standard deviation; bell, from "
        f"{VIOLIN_VALUES_MIN} cases on: their normal distribution, scaled to one height"
        + _left_out(results)
    )
    put_patches(figure, _colors(groups))
    return figure


def draw_time(results: StudyResults) -> Figure:
    """Draw the absolute tracking error of one example case per axis, rests shaded."""
    figure = new_figure(12.0, 8.0)
    examples = _same_example(results, TIME_PLOT_TRAJECTORIES)
    panels = figure.subplots(3, 1, sharex=True)
    for axis, axes in enumerate(panels):
        for label, (example, color) in examples.items():
            axes.plot(example.time, example.error[:, axis], color=color, lw=1.2, label=label)
        rests = next(iter(examples.values()))[0].rests() if examples else []
        for k, (first, end) in enumerate(rests):
            shade = axes.axvspan(first, end, color=REST_COLOR, lw=0, zorder=0)
            if axis == k == 0:
                shade.set_label("reference at rest")
        axes.set(ylabel=f"|error| in {AXIS_NAMES[axis]} [mm]", ylim=(0.0, None))
        axes.margins(x=0.005)
        axes.grid(alpha=0.25)
    figure.align_ylabels(panels)
    panels[-1].set_xlabel("time [s]")
    figure.suptitle(f"Tracking error over time{_title_of(examples)}")
    put_legend(figure, panels[0])
    return figure


def draw_paths(results: StudyResults) -> Figure:
    """Draw the path of one example case in space, from above and from the side."""
    figure = new_figure(12.0, 7.2)
    examples = _same_example(results, PATH_PLOT_TRAJECTORIES)
    paths: dict[str, Path] = {}
    for label, (example, color) in examples.items():
        paths[label] = (example.position, {"color": color, "lw": 1.5}, {"color": color, "lw": 1.2})
    if examples:
        dashed = {"color": MEASURED_COLOR, "ls": "--"}
        reference = next(iter(examples.values()))[0].reference
        paths["reference"] = (reference, {"lw": 1.1, **dashed}, {"lw": 0.9, **dashed})
    draw_in_space(figure, paths, STANDARD_VIEWS)
    figure.suptitle(f"Path of the platform origin{_title_of(examples)}")
    return figure


def draw_bars(results: StudyResults) -> Figure:
    """Draw the regions of large tracking error, and the estimation error."""
    figure = new_figure(12.0, 4.6)
    groups = _groups(results)
    lines = dict(zip(results.labels, results.summary, strict=True))
    where, estimate = figure.subplots(1, 2, width_ratios=(1.0, 1.5))
    for place, (label, (_, color)) in enumerate(groups.items()):
        line = lines[label]
        regions = [line["tracking_centre_m"], line["tracking_boundary_m"]]
        errors = [line["estimation_rmse_m"][name] for name in AXIS_NAMES]
        for axes, values in ((where, regions), (estimate, errors)):
            _bars(axes, values, place, len(groups), color)
    titles = ("tracking error by region", f"estimation error{_of_estimator(results)}")
    columns = (("centre", "boundary"), AXIS_NAMES)
    kinds = ("tracking", "estimation")
    for axes, title, names, kind in zip((where, estimate), titles, columns, kinds, strict=True):
        axes.set_xticks(range(len(names)), names)
        axes.set(ylabel=f"RMSE of the {kind} error [mm]", axisbelow=True)
        axes.set_title(title, fontsize=10)
        axes.grid(axis="y", alpha=0.25)
        axes.margins(y=0.12)
    figure.suptitle(
        "Errors over all cases; centre: the middle half of each side of the workspace box"
        + _left_out(results)
    )
    put_patches(figure, _colors(groups))
    return figure


def draw_beliefs(results: StudyResults) -> Figure:
    """Draw estimation errors, and the consistency of the estimators' covariances."""
    return draw_estimates(_groups(results), _of_estimator(results) + _left_out(results))


COMPARISON_PICTURES: Mapping[str, Callable[[StudyResults], Figure]] = {
    "paths": draw_paths,
    "error_over_time": draw_time,
    "error_violins": draw_violins,
    "rmse_gaussians": draw_gaussians,
    "regions_and_estimates": draw_bars,
    "estimation": draw_beliefs,
}


def _groups(results: StudyResults) -> dict[str, tuple[list[Row], str]]:
    """Return rows and colour of the first groups, by label."""
    pairs = zip(
        results.labels[:GROUPS_MAX], results.groups[:GROUPS_MAX], SERIES_COLORS, strict=False
    )
    return {label: (rows, color) for label, rows, color in pairs}


def _of_estimator(results: StudyResults) -> str:
    """Name the estimator if all rows share it; rows then differ in something else."""
    names = {str(line["estimator"]) for line in results.summary}
    return f" (of the estimator {names.pop()})" if len(names) == 1 else ""


def _left_out(results: StudyResults) -> str:
    """Note that some groups are not shown."""
    count = len(results.labels)
    return f" (the first {GROUPS_MAX} of {count} rows of the table)" if count > GROUPS_MAX else ""


def _colors(groups: Mapping[str, tuple[list[Row], str]]) -> dict[str, str]:
    return {label: color for label, (_, color) in groups.items()}


def _same_example(results: StudyResults, wanted: tuple[str, ...]) -> dict[str, tuple[Example, str]]:
    """Return one case of every group on the same plant and path, by label, with its colour."""
    groups = _groups(results)
    first = results.summary[0]
    block = {
        label: ({e.trajectory: e for e in examples_of(rows)}, color)
        for label, (rows, color) in groups.items()
        if (rows[0]["robot"], rows[0]["perturbation"]) == (first["robot"], first["perturbation"])
    }
    have = dict.fromkeys(name for by_trajectory, _ in block.values() for name in by_trajectory)
    name = next((name for name in (*wanted, *have) if name in have), None)
    return {
        label: (by_trajectory[name], color)
        for label, (by_trajectory, color) in block.items()
        if name is not None and name in by_trajectory
    }


def _title_of(examples: Mapping[str, tuple[Example, str]]) -> str:
    """Return the title of an example."""
    titles = [example.title for example, _ in examples.values()]
    return f": {titles[0]}" if titles else ": no case to show"


def _bell(axes: Any, values: Array, place: int, color: str) -> None:
    """Draw a group's values below zero, and their normal distribution above."""
    if len(values) == 0:
        return
    low = -0.11 * (place + 1)
    draw_bell(axes, values, low, color)
    axes.set_ylim(bottom=min(low - 0.09, axes.get_ylim()[0]), top=1.1)


def _bars(axes: Any, values: list[float | None], place: int, count: int, color: str) -> None:
    """Draw one group's bars, with their numbers."""
    width = 0.8 / count
    for position, value in enumerate(values):
        if value is None:
            continue
        where = position + (place - (count - 1) / 2) * width
        axes.bar(where, MM_PER_M * value, 0.92 * width, color=color, alpha=0.75)
        if count > LABELLED_GROUPS_MAX:
            continue
        axes.annotate(f"{MM_PER_M * value:.1f}", (where, MM_PER_M * value), xytext=(0, 2),
                      fontsize=8, textcoords="offset points", ha="center")  # fmt: skip
