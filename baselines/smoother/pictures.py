"""Pictures of a smoothed recording."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from baselines.smoother.result import Smoothed
from carosac_toolkit.pictures.drawing import new_figure
from carosac_toolkit.pictures.style import MEASURED_COLOR, REST_COLOR, SERIES_COLORS
from carosac_toolkit.validation.phases import find_phases

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_estimate(result: Smoothed, robot: str) -> Figure:
    """Draw position and its error, or without poses to compare its two sigmas, over time."""
    figure = new_figure(13.0, 8.5)
    panels = figure.subplots(3, 2, sharex=True)
    band = 2e3 * result.sigma[:, :3]
    for i, (left, right) in enumerate(panels):
        _shade(result, left)
        _shade(result, right)
        left.plot(
            result.time, result.position[:, i], color=SERIES_COLORS[1], lw=1.2, label="smoothed"
        )
        right.fill_between(
            result.time, -band[:, i], band[:, i], color=SERIES_COLORS[1], alpha=0.2, lw=0,
            label="two sigmas",
        )  # fmt: skip
        if result.measured is not None and result.compared is not None:
            when, place = result.measured.time, result.measured.position[:, i]
            left.plot(when, place, ".", color=MEASURED_COLOR, ms=3.0, label="measured, not used")
            error = (result.compared.position[:, i] - place) * 1e3
            right.plot(
                when, error, ".-", color=SERIES_COLORS[0], ms=3.0, lw=0.8,
                label="smoothed minus measured",
            )  # fmt: skip
            widest = 1.3 * max(float(np.abs(error).max()), 0.5)
            end = max(widest, min(band[:, i].max(), 3.0 * widest))
            right.set_ylim(-end, end)
        left.set_ylabel(f"{'xyz'[i]} [m]")
        right.set_ylabel(f"error in {'xyz'[i]} [mm]")
    for axes in panels[-1]:
        axes.set_xlabel("time [s]")
    for axes in panels[0]:
        axes.legend(fontsize=9, loc="upper right", ncols=2)
    figure.suptitle(f"{robot}: smoothed position; grey: the winches rest")
    return figure


def draw_unknowns(result: Smoothed, robot: str) -> Figure:
    """Draw wind and length biases over time, each with two sigmas of what is left open."""
    figure = new_figure(11.0, 6.0)
    above, below = figure.subplots(2, 1, sharex=True)
    for i, axis in enumerate("xy"):
        above.plot(result.time, result.wind[:, i], color=SERIES_COLORS[i], lw=1.0, label=axis)
    for i in range(result.length_bias.shape[1]):
        color, bias = SERIES_COLORS[i % len(SERIES_COLORS)], result.length_bias[:, i] * 1e3
        sigma = result.length_bias_sigma[:, i] * 1e3
        below.plot(result.time, bias, color=color, lw=1.0, label=f"cable {i + 1}")
        below.fill_between(
            result.time, bias - 2 * sigma, bias + 2 * sigma, color=color, alpha=0.12, lw=0
        )
    above.set_ylabel("wind [N]")
    below.set(xlabel="time [s]", ylabel="readings too long by [mm]")
    for axes in (above, below):
        _shade(result, axes)
        axes.legend(fontsize=9, loc="upper right", ncols=4)
    figure.suptitle(f"{robot}: what beside the lengths moves the platform")
    return figure


def _shade(result: Smoothed, axes: Any) -> None:
    """Shade the times at which the winches rest."""
    time = result.time
    for first, end in find_phases(time, result.recording.unstrained_length).rests:
        axes.axvspan(time[first], time[end - 1], color=REST_COLOR, lw=0)
    axes.grid(alpha=0.25)
