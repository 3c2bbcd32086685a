"""Pictures of a calibration from rests."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from calibration.pictures import COLOR_AFTER, COLOR_OUTLIER, draw_learnt
from calibration.rests.result import RestCalibration
from calibration.sensor_errors import SENSOR_WORDS
from carosac_toolkit.pictures.drawing import new_figure, put_legend, set_plane, set_title, views
from carosac_toolkit.pictures.style import (
    DOUBLE_COLUMN_INCH,
    MEASURED_COLOR,
    SERIES_COLORS,
    styled,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@styled
def draw_poses(result: RestCalibration) -> Figure:
    """Draw where the platform rested; the first rest stands out."""
    figure = new_figure(DOUBLE_COLUMN_INCH, 3.4)
    panels = figure.subplots(1, len(views(result.robot)), squeeze=False)[0]
    for axes, (pair, title) in zip(panels, views(result.robot), strict=True):
        rows, exits = list(pair), result.robot.exit_points
        axes.plot(*result.position[:, rows].T, ".", color=MEASURED_COLOR, ms=6, label="rests")
        axes.plot(*result.position[0, rows], "*", color=COLOR_OUTLIER, ms=12, label="first rest")
        axes.plot(*exits[:, rows].T, "s", color=COLOR_AFTER, ms=6, label="exit points")
        set_plane(axes, pair, title)
    set_title(figure, f"{result.robot.name}: estimated positions of the platform origin")
    put_legend(figure, panels[0])
    return figure


@styled
def draw_sensor_residuals(result: RestCalibration) -> Figure:
    """Draw the residuals of each sensor by rest, in standard deviations of its noise."""
    figure = new_figure(DOUBLE_COLUMN_INCH, 0.8 + 1.3 * len(result.residual))
    panels = figure.subplots(len(result.residual), 1, sharex=True, squeeze=False)[:, 0]
    rests = np.arange(len(result.time))
    for axes, (name, residual) in zip(panels, result.residual.items(), strict=True):
        for j, column in enumerate(residual.T):
            axes.plot(rests, column, ".", color=SERIES_COLORS[j % len(SERIES_COLORS)], ms=5)
        axes.axhline(0.0, color="#808080", lw=0.8)
        axes.set_ylabel(f"{SENSOR_WORDS[name][0]}\n[sigmas]", fontsize=9)
        axes.grid(alpha=0.25)
    panels[-1].set_xlabel("rest")
    set_title(figure, f"{result.robot.name}: measured minus predicted readings")
    return figure


def images(result: RestCalibration) -> dict[str, tuple[Figure, str]]:
    """Draw all pictures; return each with its caption, by name."""
    drawn = {
        "poses": (draw_poses(result), "Where the platform rested."),
        "residuals": (
            draw_sensor_residuals(result),
            "Residuals by rest, one colour for each cable or axis; readings that were left out are "
            "not shown.",
        ),
    }
    if np.isfinite(result.estimate.prior_sigma).any():
        drawn["learnt"] = (
            draw_learnt(result.robot.name, result.estimate),
            "Prior and posterior of each parameter.",
        )
    return drawn
