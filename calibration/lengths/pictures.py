"""Pictures of a calibration from lengths."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from calibration.lengths.planning import SuggestedPoses
from calibration.lengths.result import LengthCalibration
from calibration.pictures import (
    COLOR_AFTER,
    COLOR_OUTLIER,
    draw_exit_points,
    draw_learnt,
    draw_residuals,
)
from carosac_toolkit.pictures.drawing import new_figure, put_legend, set_plane, views
from carosac_toolkit.pictures.saving import png
from carosac_toolkit.pictures.style import MEASURED_COLOR, SERIES_COLORS

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_poses(result: LengthCalibration, suggested: SuggestedPoses | None) -> Figure:
    """Draw where the platform was measured, and where it should be measured next."""
    figure = new_figure(11.0, 5.0)
    panels = figure.subplots(1, len(views(result.robot)) + (suggested is not None))
    robot = result.robot
    for axes, (pair, title) in zip(panels, views(robot), strict=False):
        rows = list(pair)
        axes.plot(*result.position[:, rows].T, ".", color=MEASURED_COLOR, ms=2.5, label="measured")
        axes.plot(*robot.exit_points[:, rows].T, "s", color=COLOR_AFTER, ms=6, label="exit points")
        if suggested is not None:
            axes.plot(
                *suggested.position[:, rows].T, "*", color=COLOR_OUTLIER, ms=11, label="suggested"
            )
        set_plane(axes, pair, title)
    if suggested is not None:
        number = np.arange(len(suggested.sigma))
        last = panels[-1]
        last.plot(
            number, 1e3 * suggested.worst, "o-", color=SERIES_COLORS[0], label="worst coordinate"
        )
        last.plot(number, 1e3 * suggested.sigma, "o-", color=SERIES_COLORS[1], label="mean (RMS)")
        last.set(xlabel="further poses", ylabel="1 sigma of exit points [mm]", ylim=(0.0, None))
        last.legend(frameon=False, fontsize=8)
        last.grid(alpha=0.25)
    figure.suptitle("Poses of the platform origin")
    put_legend(figure, panels[0])
    return figure


def images(
    result: LengthCalibration, suggested: SuggestedPoses | None
) -> dict[str, tuple[bytes, str]]:
    """Draw all pictures; return PNG and caption by name."""
    names = result.robot.cable_names
    drawn = {}
    if any(name.startswith("exit_points") for name in result.estimate.names):
        assert result.robot.exit_covariance is not None
        drawn["exit_points"] = (
            png(
                draw_exit_points(
                    names, result.before.exit_points, result.exit_covariance_before,
                    result.robot.exit_points, result.robot.exit_covariance,
                )
            ),
            "Exit points before (grey) and after (blue) with their 95 % ellipses, relative to the "
            "calibrated ones.",
        )  # fmt: skip
    drawn["residuals"] = (
        png(draw_residuals(result.time, result.residual, result.outlier, names, label="time [s]")),
        "Readings less predictions of the calibrated robot over time; crosses: left out as "
        "blunders, drawn at the edge where they are outside.",
    )
    drawn["learnt"] = (
        png(draw_learnt(result.estimate)),
        "Posterior over prior standard deviation of each parameter, and how far it moved.",
    )
    drawn["poses"] = (
        png(draw_poses(result, suggested)),
        "Measured poses of the platform"
        + (", which poses would teach most, and what they would." if suggested else "."),
    )
    return drawn
