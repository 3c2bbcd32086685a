"""Pictures of a survey: where it took place, and its residuals."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from calibration.pictures import COLOR_AFTER, COLOR_OUTLIER
from calibration.tachymeter.observations import READING_NAMES
from calibration.tachymeter.result import TachymeterResult
from calibration.tachymeter.survey_fit import BLUNDER_SIGMAS
from carosac_toolkit.pictures.drawing import new_figure, put_legend, set_plane, set_title
from carosac_toolkit.pictures.point_names import name_points_in_plane
from carosac_toolkit.pictures.style import (
    DOUBLE_COLUMN_INCH,
    MEASURED_COLOR,
    SERIES_COLORS,
    SERIES_MARKERS,
    styled,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SETUP_COLORS = SERIES_COLORS[2:]
COLOR_KNOWN, COLOR_TIE = MEASURED_COLOR, "#a0a0a0"
SIGMA_MAGNIFICATION = 500.0  # times that sigmas are drawn
EDGE_SIGMAS = 6.0  # where test values beyond are drawn


@styled
def draw_site(result: TachymeterResult) -> Figure:
    """Draw set-ups, known points and exit points from above, and their heights."""
    figure = new_figure(DOUBLE_COLUMN_INCH, 4.2)
    above, side = figure.subplots(1, 2)
    places = np.array(list(result.points.values()))
    longer = int(np.argmax(np.ptp(places, axis=0)[:2]))
    heights = f"heights, over {'xyz'[longer]}"
    for axes, pair, title in ((above, (0, 1), "from above"), (side, (longer, 2), heights)):
        _draw_sights(axes, result, *pair)
        _draw_points(axes, result, *pair)
        set_plane(axes, pair, title)
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.2)
    set_title(figure, f"{result.before.name}: the survey; exit points with their uncertainty")
    put_legend(figure, above)
    # From above alone, where points do not hide each other.
    name_points_in_plane(above, [(name, at[:2]) for name, at in result.points.items()])
    return figure


def _draw_sights(axes: Any, result: TachymeterResult, a: int, b: int) -> None:
    """Draw lines of sight, those with a reading that was left out dashed."""
    used = [bool(row.all()) for row in result.residuals.used]
    for k, (name, station) in enumerate(result.stations.items()):
        color = SETUP_COLORS[k % len(SETUP_COLORS)]
        for shot, good in zip(result.survey.shots, used, strict=True):
            if shot.setup == name:
                ends = np.array([station.values[:3], result.points[shot.target]])
                axes.plot(
                    ends[:, a], ends[:, b], "-" if good else "--",
                    color=color if good else COLOR_OUTLIER, lw=0.5 if good else 1.3,
                    alpha=0.4 if good else 0.9, zorder=1 if good else 2,
                )  # fmt: skip
        where = station.values[:3]
        axes.plot(where[a], where[b], "^", color=color, ms=6, label=f"set-up {name}", zorder=4)
    if not all(used):
        axes.plot([], [], "--", color=COLOR_OUTLIER, lw=1.3, label="a reading left out")


def _draw_points(axes: Any, result: TachymeterResult, a: int, b: int) -> None:
    """Draw points, and the sigmas of the exit points, magnified."""
    known = {reference.name for reference in result.survey.known}
    kinds = {
        "exit point": (result.cables, "o", COLOR_AFTER, 2.5),
        "known point": (sorted(known), "s", COLOR_KNOWN, 4.5),
        "tie point": (sorted(set(result.points) - known - set(result.cables)), "D", COLOR_TIE, 4.5),
    }
    for label, (names, marker, color, size) in kinds.items():
        if names:
            at = np.array([result.points[name] for name in names])
            axes.plot(at[:, a], at[:, b], marker, color=color, ms=size, label=label, zorder=3)
    label = f"1 sigma, {SIGMA_MAGNIFICATION:.0f} times larger"
    for i, name in enumerate(result.cables):
        block = result.exit_covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
        values, vectors = np.linalg.eigh(block[np.ix_([a, b], [a, b])])
        turn = np.linspace(0.0, 2.0 * np.pi, 73)
        circle = vectors @ (np.sqrt(values)[:, None] * np.array([np.cos(turn), np.sin(turn)]))
        at = result.points[name][[a, b], None] + SIGMA_MAGNIFICATION * circle
        axes.plot(at[0], at[1], color=COLOR_AFTER, lw=1.0, label=label if i == 0 else None)


@styled
def draw_shots(result: TachymeterResult) -> Figure:
    """Draw the test value of every reading, shot by shot."""
    figure = new_figure(DOUBLE_COLUMN_INCH, 4.6)
    grid = figure.subplots(len(READING_NAMES), 1, sharex=True)
    test, used = result.residuals.test, result.residuals.used
    number = np.arange(len(test)) + 1
    setups = [shot.setup for shot in result.survey.shots]
    for k, (axes, name) in enumerate(zip(grid, READING_NAMES, strict=True)):
        for j, setup in enumerate(result.survey.setups):
            mine = np.array([s == setup for s in setups]) & used[:, k]
            axes.plot(
                number[mine], test[mine, k], SERIES_MARKERS[j % len(SERIES_MARKERS)], ms=3,
                color=SETUP_COLORS[j % len(SETUP_COLORS)], label=f"set-up {setup}",
            )  # fmt: skip
        out = ~used[:, k]
        axes.plot(
            number[out], np.clip(test[out, k], -EDGE_SIGMAS, EDGE_SIGMAS), "x", ms=6, mew=1.5,
            color=COLOR_OUTLIER, label="left out; at the edge: farther out",
        )  # fmt: skip
        for level in (-BLUNDER_SIGMAS, BLUNDER_SIGMAS):
            axes.axhline(
                level, color=MEASURED_COLOR, lw=0.7, ls="--",
                label="limit of blunders" if level > 0.0 else None,
            )  # fmt: skip
        axes.axhline(0.0, color=MEASURED_COLOR, lw=0.6)
        axes.set(ylabel=f"{name} [sigmas]", ylim=(-1.1 * EDGE_SIGMAS, 1.1 * EDGE_SIGMAS))
        axes.grid(alpha=0.25)
    figure.align_ylabels(grid)
    grid[-1].set_xlabel("shot")
    set_title(figure, f"{result.before.name}: residuals of all readings over their own sigmas")
    put_legend(figure, grid[0])
    return figure
