"""Pictures of a study: errors over cases, time, space and regions, one look per group."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.pictures.drawing import (
    STANDARD_VIEWS,
    Path,
    draw_ecdf,
    draw_in_space,
    enlarged_text,
    enlargement,
    finish_ecdf,
    limits_of,
    line_style,
    new_figure,
    put_legend,
    put_marks,
    set_log,
    set_title,
    spans_decades,
)
from carosac_toolkit.pictures.estimates import draw_axis_violins, draw_estimates
from carosac_toolkit.pictures.groups import (
    Group,
    estimator_groups,
    groups_of,
    left_out,
    looks_of,
    robots_title,
)
from carosac_toolkit.pictures.path_grid import draw_path_grid
from carosac_toolkit.pictures.style import (
    DOUBLE_COLUMN_INCH,
    MEASURED_COLOR,
    REST_COLOR,
    SINGLE_COLUMN_INCH,
    styled,
)
from carosac_toolkit.pictures.units import unit_of
from carosac_toolkit.studies.compare.example_cases import Example, curves_of, examples_of
from carosac_toolkit.studies.compare.results import AXIS_NAMES, StudyResults, pooled, steps, tracked

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TIME_PLOT_TRAJECTORIES = (
    "waypoints",
    "minimum_snap",
)  # what is shown over time, first choice first
PATH_PLOT_TRAJECTORIES = ("spiral", "minimum_snap")
PATHS_TOGETHER_MAX = 4  # paths that can be followed in one view
REGIONS = ("centre", "boundary")


@dataclass(frozen=True, kw_only=True, eq=False)
class Curve:
    """One case of a group, to be drawn beside those of the others on the same plant and path."""

    group: Group
    example: Example

    @property
    def label(self) -> str:
        """Label of the group, marked if this case diverged."""
        return self.group.label + (" (diverged)" if self.example.diverged else "")


@styled
def draw_violins(results: StudyResults) -> Figure:
    """Draw the distribution of the signed tracking error over the samples of example cases."""
    groups = groups_of(results)
    figure = new_figure(DOUBLE_COLUMN_INCH, 3.0)
    panels = figure.subplots(1, 4)
    examples = {group.number: examples_of(group.rows) for group in groups}
    errors = {
        k: np.concatenate([one.error for one in some]) for k, some in examples.items() if some
    }
    unit = draw_axis_violins(panels, groups, errors)
    for axes in panels:
        axes.set_xlim(-0.6, len(groups) - 0.4)
        axes.grid(axis="y", alpha=0.25)
    panels[0].set_ylabel(f"tracking error [{unit}]")
    shown = {one.trajectory for some in examples.values() for one in some}
    count = f"{len(shown)} trajector" + ("ies" if len(shown) != 1 else "y")
    set_title(
        figure,
        f"{robots_title(results)}: tracking error of all samples of {count}, first seed; "
        "marker: mean",
        left_out(results),
    )
    put_marks(figure, looks_of(groups))
    return figure


@styled
def draw_distribution(results: StudyResults) -> Figure:
    """Draw the distribution of the RMSE over all cases: which share of them has at most that."""
    groups = groups_of(results)
    figure = new_figure(DOUBLE_COLUMN_INCH, 4.2)
    panels = figure.subplots(2, 2, sharey=True)
    columns = {name: [_rmse(group, name) for group in groups] for name in AXIS_NAMES}
    unit, factor = unit_of(values for some in columns.values() for values in some)
    for axes, (name, some) in zip(panels.ravel(), columns.items(), strict=True):
        for group, values in zip(groups, some, strict=True):
            draw_ecdf(axes, factor * values, len(group.rows), group.look, group.legend)
        axes.set_title(name)
    finish_ecdf(panels.ravel(), f"RMSE of a case [{unit}]")
    for axes in panels[:, 0]:
        axes.set_ylabel("share of cases [-]")
    set_title(
        figure,
        f"{robots_title(results)}: share of cases with at most this tracking RMSE",
        left_out(results),
    )
    put_legend(figure, panels[0, 0])
    return figure


def _rmse(group: Group, axis: str) -> Array:
    """Return the tracking RMSE of the cases of a group [m], shape (K,)."""
    column = [row[f"tracking_rmse_{axis}_m"] for row in tracked(group.rows)]
    return np.array(column, dtype=float)


@styled
def draw_time(results: StudyResults) -> Figure:
    """Draw the signed tracking error of one example case per axis, rests shaded.

    Panels are scaled to the cases that did not diverge; a curve that diverged ends in a cross at
    the edge.
    """
    figure = new_figure(DOUBLE_COLUMN_INCH, 5.2)
    curves = _same_example(results, TIME_PLOT_TRAJECTORIES)
    scaled = [one for one in curves if not one.example.diverged] or curves
    unit, factor = unit_of(one.example.error for one in scaled)
    panels = figure.subplots(3, 1, sharex=True)
    for axis, axes in enumerate(panels):
        ends = _ends([factor * one.example.error[:, axis] for one in scaled])
        axes.set_ylim(*ends)
        for one in curves:
            values = factor * one.example.error[:, axis]
            look = line_style(one.group.look, len(values), one.group.number)
            axes.plot(one.example.time, values, label=one.label, **look)
            if one.example.diverged:
                _cross(axes, one.example.time, values, ends, one.group.look.color)
        axes.axhline(0.0, color=MEASURED_COLOR, lw=0.6, zorder=0)
        for k, (first, end) in enumerate(curves[0].example.rests() if curves else []):
            shade = axes.axvspan(first, end, color=REST_COLOR, lw=0, zorder=-1)
            if axis == k == 0:
                shade.set_label("reference at rest")
        axes.set_ylabel(f"error in {AXIS_NAMES[axis]} [{unit}]")
        axes.margins(x=0.005)
        axes.grid(alpha=0.25)
    figure.align_ylabels(panels)
    panels[-1].set_xlabel("time [s]")
    set_title(figure, f"{robots_title(results)}: tracking error over time{_case_of(curves)}")
    put_legend(figure, panels[0])
    return figure


def _ends(curves: Sequence[Array]) -> tuple[float, float]:
    """Return the ends of an axis with zero and some curves on it, with some room."""
    points = np.concatenate([*curves, np.zeros(1)])
    low, high = float(points.min()), float(points.max())
    room = 0.08 * max(high - low, 1e-9)
    return low - room, high + room


def _cross(axes: Any, time: Array, values: Array, ends: tuple[float, float], color: str) -> None:
    """Mark where a curve leaves its panel, or else its end."""
    outside = np.flatnonzero((values < ends[0]) | (values > ends[1]))
    k = int(outside[0]) if len(outside) else len(values) - 1
    place = float(np.clip(values[k], *ends))
    axes.plot(time[k], place, "x", color=color, ms=7, mew=1.8, clip_on=False, zorder=5)


@styled
def draw_paths(results: StudyResults) -> Figure:
    """Draw the path of one example case in space and in two planes, its error enlarged.

    More than `PATHS_TOGETHER_MAX` paths have panels of their own, in two planes.
    """
    curves = _same_example(results, PATH_PLOT_TRAJECTORIES)
    scaled = [one.example for one in curves if not one.example.diverged]
    reference = curves[0].example.reference if curves else np.zeros((1, 3))
    factor = enlargement(reference, [one.error[:, :3] for one in scaled])
    paths: dict[str, Path] = {}
    for one in curves:
        drawn = _enlarged(one.example, factor)
        paths[one.label] = (drawn, line_style(one.group.look, len(drawn), one.group.number))
    dashes = {"color": MEASURED_COLOR, "lw": 0.8, "ls": "--"}
    limits = limits_of([reference, *(_enlarged(one, factor) for one in scaled)])
    text = (
        f"{robots_title(results)}: path of the platform origin{_case_of(curves)}, "
        + enlarged_text(factor)
    )
    if len(paths) > PATHS_TOGETHER_MAX:
        figure = draw_path_grid(paths, (reference, dashes | {"label": "reference"}), limits)
        set_title(figure, text, f"x-y {STANDARD_VIEWS[0][1]}; x-z {STANDARD_VIEWS[1][1]}")
        return figure
    figure = new_figure(DOUBLE_COLUMN_INCH, 4.4)
    if curves:
        paths["reference"] = (reference, dashes)
    draw_in_space(figure, paths, STANDARD_VIEWS, limits if curves else None)
    set_title(figure, text)
    return figure


def _enlarged(example: Example, factor: int) -> Array:
    """Return the path of an example with its error enlarged [m], shape (S, 3)."""
    return example.reference + factor * (example.position - example.reference)


@styled
def draw_regions(results: StudyResults) -> Figure:
    """Draw the tracking error in the centre of the workspace box and near its boundary."""
    groups = groups_of(results)
    figure = new_figure(SINGLE_COLUMN_INCH, 2.6 + 0.15 * len(groups))
    axes = figure.subplots()
    values = {group.number: _by_region(group) for group in groups}
    unit, factor = unit_of(values.values())
    for group in groups:
        shift = 0.7 * ((group.number + 0.5) / len(groups) - 0.5)
        axes.plot(
            np.arange(len(REGIONS)) + shift, factor * values[group.number], group.look.marker,
            color=group.look.color, ms=6, label=group.legend, clip_on=False, zorder=3,
        )  # fmt: skip
    axes.margins(y=0.12)
    if spans_decades(np.concatenate([*values.values(), np.zeros(0)])):
        set_log(axes, "y")
    else:
        axes.set_ylim(bottom=0.0)
    axes.set_xticks(range(len(REGIONS)), REGIONS)
    axes.set(xlim=(-0.5, len(REGIONS) - 0.5), ylabel=f"tracking RMSE [{unit}]", axisbelow=True)
    axes.axvline(0.5, color=MEASURED_COLOR, lw=0.4)
    axes.grid(axis="y", alpha=0.25)
    set_title(
        figure,
        f"{robots_title(results)}: tracking error by region of the workspace box",
        left_out(results),
    )
    put_legend(figure, axes)
    return figure


def in_both_regions(results: StudyResults) -> bool:
    """Return whether any paths came to the centre, and any to the boundary."""
    errors = np.array([_by_region(group) for group in groups_of(results)])
    return bool(np.isfinite(errors).any(axis=0).all())


def _by_region(group: Group) -> Array:
    """Return the pooled tracking RMSE of a group in each region [m], NaN where it never was."""
    rows = tracked(group.rows)
    inside = [float(row.get("centre_steps") or 0.0) for row in rows]
    outside = [count - k for count, k in zip(steps(rows), inside, strict=True)]
    errors = (
        pooled(rows, "tracking_centre_m", inside),
        pooled(rows, "tracking_boundary_m", outside),
    )
    return np.array([np.nan if error is None else error for error in errors])


@styled
def draw_estimation(results: StudyResults) -> Figure:
    """Draw estimation errors by estimator, and the consistency of the covariances."""
    return draw_estimates(estimator_groups(results), robots_title(results))


COMPARISON_PICTURES: Mapping[str, Callable[[StudyResults], Figure]] = {
    "paths": draw_paths,
    "error_over_time": draw_time,
    "error_violins": draw_violins,
    "rmse_distribution": draw_distribution,
    "regions": draw_regions,
    "estimation": draw_estimation,
}


def _same_example(results: StudyResults, wanted: Sequence[str]) -> list[Curve]:
    """Return one case of every group on the same plant and path."""
    first = results.summary[0]
    block = [
        (group, {example.trajectory: example for example in curves_of(group.rows)})
        for group in groups_of(results)
        if all(group.rows[0][name] == first[name] for name in ("robot", "perturbation"))
    ]
    have = dict.fromkeys(name for _, by_trajectory in block for name in by_trajectory)
    name = next((name for name in (*wanted, *have) if name in have), None)
    return [
        Curve(group=group, example=by_trajectory[name])
        for group, by_trajectory in block
        if name is not None and name in by_trajectory
    ]


def _case_of(curves: Sequence[Curve]) -> str:
    """Return path and seed of an example, for its title."""
    if not curves:
        return ": no case to show"
    return f" ({curves[0].example.trajectory}, seed {curves[0].example.seed})"
