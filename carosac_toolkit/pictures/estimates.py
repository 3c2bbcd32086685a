"""Picture of estimates: their errors, and the consistency of their covariances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.consistency import POSE_SIZE, band
from carosac_toolkit.pictures.drawing import (
    draw_violin,
    new_figure,
    number_below,
    put_marks,
    rms,
    set_log,
    set_title,
)
from carosac_toolkit.pictures.groups import Group, colors_of
from carosac_toolkit.pictures.style import DOUBLE_COLUMN_INCH, MEASURED_COLOR, REST_COLOR
from carosac_toolkit.pictures.units import unit_of
from carosac_toolkit.studies.compare.example_cases import estimates_of
from carosac_toolkit.studies.compare.results import AXIS_NAMES, scored
from carosac_toolkit.studies.run.rows import Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_axis_violins(
    panels: Sequence[Any], groups: Sequence[Group], errors: Mapping[int, Array]
) -> str:
    """Draw signed errors per axis and their norm, one panel each, with the RMSE below.

    Args:
        panels: Four of them.
        groups: All groups, of which some may have no errors.
        errors: Samples [m] by the number of the group, shape (K, 4).

    Returns:
        The unit in which they are drawn.
    """
    unit, factor = unit_of(errors.values())
    for column, (name, axes) in enumerate(zip(AXIS_NAMES, panels, strict=True)):
        numbers: dict[float, float | None] = {}
        for group in groups:
            if group.number in errors:
                values = factor * errors[group.number][:, column]
                draw_violin(axes, values, group.number, group.look)
                numbers[group.number] = rms(values)
        axes.set_title(name)
        number_below(axes, numbers, f"RMSE [{unit}]", colors_of(groups))
        axes.axhline(0.0, color=MEASURED_COLOR, lw=0.6, zorder=0)
    return unit


def draw_estimates(groups: Sequence[Group], robots: str) -> Figure:
    """Draw the signed estimation error over the samples of example cases, and all cases' NEES.

    Args:
        groups: One per estimator.
        robots: Names of the robots, for the title.
    """
    figure = new_figure(DOUBLE_COLUMN_INCH, 3.0)
    squares = {group.number: _squares(group.rows) for group in groups}
    known = any(squares.values())
    panels = figure.subplots(1, 5 if known else 4)
    examples = {group.number: estimates_of(group.rows) for group in groups}
    errors = {
        k: np.concatenate([one.estimation_error for one in some])
        for k, some in examples.items()
        if some
    }
    unit = draw_axis_violins(panels[:4], groups, errors)
    panels[0].set_ylabel(f"estimation error [{unit}]")
    if known:
        _draw_squares(panels[4], groups, squares)
    for axes in panels:
        axes.set(xlim=(-0.6, len(groups) - 0.4), axisbelow=True)
        axes.grid(axis="y", alpha=0.25)
    controllers = len({row["controller"] for group in groups for row in group.rows})
    under = f", under {controllers} controllers" if controllers > 1 else ""
    set_title(
        figure,
        f"{robots}: estimation error of all samples, first seed{under}; marker: mean",
        "NEES of all cases; grey: where 95 % of the means of a consistent estimator are"
        if known
        else "",
    )
    drawn = errors.keys() | {k for k, some in squares.items() if some}
    put_marks(
        figure,
        {g.label + ("" if g.number in drawn else " (no estimate)"): g.look for g in groups},
    )
    return figure


def _draw_squares(
    axes: Any, groups: Sequence[Group], squares: Mapping[int, dict[int, list[float]]]
) -> None:
    """Draw the NEES of each case as a dot, its mean as a marker, and the band of the mean."""
    numbers: dict[float, float | None] = {}
    for group in groups:
        by_seed, place, look = squares[group.number], group.number, group.look
        if not by_seed:
            continue
        low, high = band(POSE_SIZE, len(by_seed))
        axes.fill_between([place - 0.4, place + 0.4], low, high, color=REST_COLOR, lw=0, zorder=0)
        values = np.concatenate(list(by_seed.values()))
        axes.plot(np.full(len(values), place), values, ".", color=look.color, ms=4, alpha=0.5)
        numbers[place] = float(values.mean())
        axes.plot(place, values.mean(), look.marker, color=look.color, ms=4.5, mec="white", mew=0.6)
    axes.axhline(1.0, color=MEASURED_COLOR, lw=0.8, ls="--")
    set_log(axes, "y")
    axes.set_ylabel("NEES / degrees of freedom [-]")
    axes.set_title("NEES of the pose")
    number_below(axes, numbers, "mean [-]", colors_of(groups))


def _squares(rows: Sequence[Row]) -> dict[int, list[float]]:
    """Return the NEES of the cases that have one, by seed."""
    by_seed: dict[int, list[float]] = {}
    for row in scored(rows):
        if row.get("nees_pose") is not None:
            by_seed.setdefault(int(row["seed"] or 0), []).append(float(row["nees_pose"] or 0.0))
    return by_seed
