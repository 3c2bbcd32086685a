"""Picture of estimates: their errors, and the consistency of their covariances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from carosac_toolkit.loop.consistency import POSE_SIZE, band
from carosac_toolkit.pictures.drawing import (
    MEASURED_COLOR,
    REST_COLOR,
    draw_violin,
    new_figure,
    put_patches,
)
from carosac_toolkit.studies.compare.example_cases import estimates_of
from carosac_toolkit.studies.compare.results import AXIS_NAMES, scored
from carosac_toolkit.studies.run.rows import Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Groups = Mapping[str, tuple[Sequence[Row], str]]


def draw_estimates(groups: Groups, note: str = "") -> Figure:
    """Draw the absolute estimation error over the samples of example cases, and all cases' NEES.

    Args:
        groups: Rows and colour by label.
        note: Added to the title.
    """
    figure = new_figure(12.0, 4.8)
    squares = {label: _squares(rows) for label, (rows, _) in groups.items()}
    known = any(squares.values())
    panels = figure.subplots(1, 5 if known else 4)
    for place, (rows, color) in enumerate(groups.values()):
        examples = [example.estimation_error for example in estimates_of(rows)]
        for column, axes in enumerate(panels[:4] if examples else ()):
            draw_violin(axes, np.concatenate(examples)[:, column], place, color)
    for name, axes in zip(AXIS_NAMES, panels[:4], strict=True):
        axes.set_title(name, fontsize=10)
        axes.set_ylim(-0.04 * axes.get_ylim()[1], axes.get_ylim()[1])
    panels[0].set_ylabel("absolute estimation error [mm]")
    if known:
        _draw_squares(panels[4], groups, squares)
    for axes in panels:
        axes.set(xticks=[], xlim=(-0.6, len(groups) - 0.2), axisbelow=True)
        axes.grid(axis="y", alpha=0.25)
    title = "Estimation error of all samples, first seed; bar: RMSE; dot: median"
    more = "; NEES of all cases: grey is where 95 % of their means are" if known else ""
    figure.suptitle(title + more + note)
    put_patches(figure, {label: color for label, (_, color) in groups.items()})
    return figure


def _draw_squares(axes: Any, groups: Groups, squares: Mapping[str, dict[int, list[float]]]) -> None:
    """Draw the NEES of each case as a dot, its mean as a bar, and the band of the mean."""
    for place, (label, (_, color)) in enumerate(groups.items()):
        by_seed = squares[label]
        if not by_seed:
            continue
        low, high = band(POSE_SIZE, len(by_seed))
        axes.fill_between([place - 0.4, place + 0.4], low, high, color=REST_COLOR, lw=0, zorder=0)
        values = np.concatenate(list(by_seed.values()))
        axes.plot(np.full(len(values), place), values, ".", color=color, ms=5, alpha=0.5)
        mean = float(values.mean())
        axes.hlines(mean, place - 0.3, place + 0.3, color=color, lw=2.0)
        axes.annotate(f"{mean:.2g}", (place + 0.3, mean), xytext=(2, 0), fontsize=8,
                      textcoords="offset points", va="center")  # fmt: skip
    axes.axhline(1.0, color=MEASURED_COLOR, lw=0.8, ls="--")
    axes.set(yscale="log", ylabel="over its degrees of freedom [-]")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_title("NEES of the pose", fontsize=10)


def _squares(rows: Sequence[Row]) -> dict[int, list[float]]:
    """Return the NEES of the cases that have one, by seed."""
    by_seed: dict[int, list[float]] = {}
    for row in scored(rows):
        if row.get("nees_pose") is not None:
            by_seed.setdefault(int(row["seed"] or 0), []).append(float(row["nees_pose"] or 0.0))
    return by_seed
