"""Pictures of a smoothed recording."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from baselines.smoother.result import Smoothed
from carosac_toolkit.pictures.drawing import line_style, new_figure, put_legend, set_title
from carosac_toolkit.pictures.style import (
    DOUBLE_COLUMN_INCH,
    MEASURED_COLOR,
    REST_COLOR,
    SERIES_COLORS,
    series,
    styled,
)
from carosac_toolkit.validation.phases import find_phases

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SMOOTHED_COLOR, ERROR_COLOR = SERIES_COLORS[0], SERIES_COLORS[1]


@styled
def draw_estimate(result: Smoothed) -> Figure:
    """Draw position and its error, or without poses to compare its two sigmas, over time."""
    figure = new_figure(DOUBLE_COLUMN_INCH, 5.0)
    panels = figure.subplots(3, 2, sharex=True)
    band = 2e3 * result.sigma[:, :3]
    for i, (left, right) in enumerate(panels):
        _shade(result, left)
        _shade(result, right)
        left.plot(result.time, result.position[:, i], color=SMOOTHED_COLOR, label="smoothed")
        right.fill_between(
            result.time, -band[:, i], band[:, i], color=SMOOTHED_COLOR, alpha=0.25, lw=0,
            label="two sigmas",
        )  # fmt: skip
        right.axhline(0.0, color=MEASURED_COLOR, lw=0.6)
        if result.measured is not None and result.compared is not None:
            when, place = result.measured.time, result.measured.position[:, i]
            left.plot(when, place, ".", color=MEASURED_COLOR, ms=2.0, label="measured, not used")
            error = (result.compared.position[:, i] - place) * 1e3
            right.plot(
                when, error, ".-", color=ERROR_COLOR, ms=2.0, lw=0.7,
                label="smoothed minus measured",
            )  # fmt: skip
            widest = 1.3 * max(float(np.abs(error).max()), 0.5)
            end = max(widest, min(band[:, i].max(), 3.0 * widest))
            right.set_ylim(-end, end)
        left.set_ylabel(f"{'xyz'[i]} [m]")
        right.set_ylabel(f"error in {'xyz'[i]} [mm]")
    for column in panels.T:
        figure.align_ylabels(column)
        column[-1].set_xlabel("time [s]")
    set_title(figure, f"{result.robot.name}: smoothed position, and its error")
    put_legend(figure, *panels[0])
    return figure


@styled
def draw_unknowns(result: Smoothed) -> Figure:
    """Draw wind and length biases over time, each with two sigmas of what is left open."""
    figure = new_figure(DOUBLE_COLUMN_INCH, 4.4)
    above, below = figure.subplots(2, 1, sharex=True)
    count = len(result.time)
    for i, axis in enumerate("xy"):
        style = line_style(series(i), count, i)
        above.plot(result.time, result.wind[:, i], label=f"wind along {axis}", **style)
    for i, name in enumerate(result.robot.cable_names):
        look, bias = series(i), result.length_bias[:, i] * 1e3
        sigma = result.length_bias_sigma[:, i] * 1e3
        below.plot(result.time, bias, label=name, **line_style(look, count, i))
        below.fill_between(
            result.time, bias - 2 * sigma, bias + 2 * sigma, color=look.color, alpha=0.12, lw=0
        )
    for axes in (above, below):
        _shade(result, axes)
        axes.axhline(0.0, color=MEASURED_COLOR, lw=0.6)
    above.set_ylabel("wind [N]")
    below.set(xlabel="time [s]", ylabel="readings too long by [mm]")
    figure.align_ylabels([above, below])
    set_title(
        figure,
        f"{result.robot.name}: wind, and errors of the length readings with two sigmas",
    )
    put_legend(figure, above, below)
    return figure


def _shade(result: Smoothed, axes: Any) -> None:
    """Shade the times at which the winches rest."""
    time = result.time
    for k, (first, end) in enumerate(find_phases(time, result.recording.unstrained_length).rests):
        axes.axvspan(
            time[first], time[end - 1], color=REST_COLOR, lw=0, zorder=0,
            label="winches at rest" if k == 0 else None,
        )  # fmt: skip
    axes.grid(alpha=0.25)
    axes.margins(x=0.005)
