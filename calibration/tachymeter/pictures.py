"""Pictures of a survey: where it took place, and its residuals."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from calibration.pictures import COLOR_AFTER, COLOR_OUTLIER
from calibration.tachymeter.observations import READING_NAMES
from calibration.tachymeter.result import TachymeterResult
from calibration.tachymeter.survey_fit import BLUNDER_SIGMAS
from carosac_toolkit.pictures.drawing import new_figure
from carosac_toolkit.pictures.style import SERIES_COLORS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SETUP_COLORS = (*SERIES_COLORS[2:], SERIES_COLORS[0])
COLOR_KNOWN, COLOR_TIE = "#303030", "#a0a0a0"
SIGMA_MAGNIFICATION = 500.0  # times that sigmas are drawn


def draw_site(result: TachymeterResult) -> Figure:
    """Draw set-ups, known points and exit points from above, and their heights."""
    figure = new_figure(11.0, 6.4)
    above, side = figure.subplots(1, 2)
    places = np.array(list(result.points.values()))
    longer = int(np.argmax(np.ptp(places, axis=0)[:2]))
    for axes, (a, b) in ((above, (0, 1)), (side, (longer, 2))):
        _draw_sights(axes, result, a, b)
        _draw_points(axes, result, a, b)
        axes.set(xlabel=f"{'xyz'[a]} [m]", ylabel=f"{'xyz'[b]} [m]")
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.1)
        axes.grid(alpha=0.25)
    above.set_title("from above", fontsize=10)
    side.set_title(f"heights, over {'xyz'[longer]}", fontsize=10)
    handles, labels = above.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, frameon=False)
    return figure


def _draw_sights(axes: Any, result: TachymeterResult, a: int, b: int) -> None:
    """Draw lines of sight, the wrong ones in red."""
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
        axes.plot(where[a], where[b], "^", color=color, ms=9, label=f"set-up {name}", zorder=4)


def _draw_points(axes: Any, result: TachymeterResult, a: int, b: int) -> None:
    """Draw points, and the sigmas of the exit points, magnified."""
    known = {reference.name for reference in result.survey.known}
    kinds = {
        "exit point": (result.cables, "o", COLOR_AFTER),
        "known point": (sorted(known), "s", COLOR_KNOWN),
        "tie point": (sorted(set(result.points) - known - set(result.cables)), "D", COLOR_TIE),
    }
    for label, (names, marker, color) in kinds.items():
        if names:
            at = np.array([result.points[name] for name in names])
            axes.plot(at[:, a], at[:, b], marker, color=color, ms=6, label=label, zorder=3)
        for name in names if b == 1 else ():  # from above, where points do not hide each other
            at = result.points[name]
            axes.annotate(
                name, (at[a], at[b]), xytext=(5, 4), textcoords="offset points", fontsize=8
            )
    label = f"1 sigma, {SIGMA_MAGNIFICATION:.0f} times larger"
    for i, name in enumerate(result.cables):
        block = result.exit_covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
        values, vectors = np.linalg.eigh(block[np.ix_([a, b], [a, b])])
        turn = np.linspace(0.0, 2.0 * np.pi, 73)
        circle = vectors @ (np.sqrt(values)[:, None] * np.array([np.cos(turn), np.sin(turn)]))
        at = result.points[name][[a, b], None] + SIGMA_MAGNIFICATION * circle
        axes.plot(at[0], at[1], color=COLOR_AFTER, lw=1.0, label=label if i == 0 else None)


def draw_shots(result: TachymeterResult) -> Figure:
    """Draw the test value of every reading, shot by shot."""
    figure = new_figure(11.0, 6.4)
    grid = figure.subplots(len(READING_NAMES), 1, sharex=True)
    test, used = result.residuals.test, result.residuals.used
    number = np.arange(len(test)) + 1
    setups = [shot.setup for shot in result.survey.shots]
    for k, (axes, name) in enumerate(zip(grid, READING_NAMES, strict=True)):
        for j, setup in enumerate(result.survey.setups):
            mine = np.array([s == setup for s in setups]) & used[:, k]
            color = SETUP_COLORS[j % len(SETUP_COLORS)]
            axes.plot(number[mine], test[mine, k], "o", ms=4, color=color, label=f"set-up {setup}")
        for i in np.flatnonzero(~used[:, k]):
            at = float(np.clip(test[i, k], -5.5, 5.5))
            axes.plot(number[i], at, "x", color=COLOR_OUTLIER, ms=8, mew=2)
            text = f"shot {i + 1}: {test[i, k]:+.0f}"
            axes.annotate(
                text, (number[i], at), xytext=(7, -3), textcoords="offset points",
                fontsize=8, color=COLOR_OUTLIER,
            )  # fmt: skip
        for level in (-BLUNDER_SIGMAS, BLUNDER_SIGMAS):
            axes.axhline(level, color="#909090", lw=0.8, ls="--")
        axes.axhline(0.0, color="#909090", lw=0.6)
        axes.set(ylabel=f"{name}\n[sigmas]", ylim=(-6.5, 6.5))
        axes.grid(alpha=0.2)
    grid[-1].set_xlabel("shot")
    grid[0].set_title(
        "Residuals over their own sigmas; red: left out, dashed: the limit", fontsize=10
    )
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=6, frameon=False)
    return figure
