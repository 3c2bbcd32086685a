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
from carosac_toolkit.pictures.drawing import new_figure, put_legend, set_plane, set_title, views
from carosac_toolkit.pictures.style import DOUBLE_COLUMN_INCH, MEASURED_COLOR, series, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@styled
def draw_poses(result: LengthCalibration, suggested: SuggestedPoses | None) -> Figure:
    """Draw where the platform was measured, and where it should be measured next."""
    figure = new_figure(DOUBLE_COLUMN_INCH, 3.4)
    robot, planned = result.robot, suggested is not None
    panels = figure.subplots(1, 2 + planned, width_ratios=(1.3, 1.3, 1.0)[: 2 + planned])
    for axes, (pair, title) in zip(panels, views(robot), strict=False):
        rows = list(pair)
        axes.plot(*result.position[:, rows].T, ".", color=MEASURED_COLOR, ms=1.5, label="measured")
        axes.plot(*robot.exit_points[:, rows].T, "s", color=COLOR_AFTER, label="exit points")
        if suggested is not None:
            axes.plot(
                *suggested.position[:, rows].T, "*", color=COLOR_OUTLIER, ms=8, label="suggested"
            )
        set_plane(axes, pair, title)
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.1)
    if suggested is not None:
        number = np.arange(len(suggested.sigma))
        last = panels[-1]
        for k, (sigma, label) in enumerate(
            ((suggested.worst, "worst coordinate"), (suggested.sigma, "mean (RMS)"))
        ):
            look = series(k)
            last.plot(
                number, 1e3 * sigma, color=look.color, ls=look.line, marker=look.marker, label=label
            )
        last.set(xlabel="further poses", ylabel="1 sigma of exit points [mm]", ylim=(0.0, None))
        last.xaxis.get_major_locator().set_params(integer=True)
        last.grid(alpha=0.25)
    set_title(figure, f"{robot.name}: poses of the platform origin")
    put_legend(figure, *panels)
    return figure


def images(
    result: LengthCalibration, suggested: SuggestedPoses | None
) -> dict[str, tuple[Figure, str]]:
    """Draw all pictures; return figure and caption by name."""
    robot, names = result.robot.name, result.robot.cable_names
    drawn = {}
    if any(name.startswith("exit_points") for name in result.estimate.names):
        assert result.robot.exit_covariance is not None
        drawn["exit_points"] = (
            draw_exit_points(
                robot, names, result.before.exit_points, result.exit_covariance_before,
                result.robot.exit_points, result.robot.exit_covariance,
            ),
            "Exit points before (grey) and after (blue) with their 95 % ellipses, relative to the "
            "calibrated ones.",
        )  # fmt: skip
    drawn["residuals"] = (
        draw_residuals(
            robot, result.time, result.residual, result.outlier, names, label="time [s]"
        ),
        "Readings less predictions of the calibrated robot over time; crosses: left out as "
        "blunders, drawn at the edge where they are outside.",
    )
    drawn["learnt"] = (
        draw_learnt(robot, result.estimate),
        "Posterior over prior standard deviation of each parameter, and how far it moved.",
    )
    drawn["poses"] = (
        draw_poses(result, suggested),
        "Measured poses of the platform"
        + (", which poses would teach most, and what they would." if suggested else "."),
    )
    return drawn
