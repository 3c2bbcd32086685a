"""A survey as a folder: pictures, and one report.html that needs nothing else."""

from __future__ import annotations

from calibration.pictures import draw_exit_points
from calibration.report import ReportContent, blunders_html, observability_html, parameters_html
from calibration.tachymeter.pictures import SIGMA_MAGNIFICATION, draw_shots, draw_site
from calibration.tachymeter.result import TachymeterResult
from calibration.tachymeter.tables import (
    BLUNDER_HEADER,
    EXIT_HEADER,
    SETUP_HEADER,
    SHOT_HEADER,
    blunder_rows,
    exit_rows,
    setup_rows,
    shot_rows,
)
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.reports.page import table


def report_content(result: TachymeterResult) -> ReportContent:
    """Return tables and pictures of the report."""
    parts = [
        "<h2>Exit points</h2>",
        table(EXIT_HEADER, exit_rows(result), left=1),
        "<h2>Set-ups</h2>",
        table(SETUP_HEADER, setup_rows(result), left=1),
        blunders_html(BLUNDER_HEADER, blunder_rows(result), left=4),
        observability_html(result.observability),
        parameters_html(result.estimate),
        "<h2>Shots</h2><p>Measured minus model, and the same over its own standard deviation; in "
        "brackets: left out.</p>",
        table(SHOT_HEADER, shot_rows(result), left=4),
    ]
    images = {
        "site": (
            draw_site(result),
            "Lines of sight; ellipses: 1 sigma of the exit points, "
            f"{SIGMA_MAGNIFICATION:.0f} times larger.",
        ),
        "exit_points": (
            draw_exit_points(
                result.before.name,
                result.cables,
                *_before(result),
                *result.exit_points_of(result.cables),
            ),
            "Exit points before and after; the ellipses hold 95 %.",
        ),
        "shots": (draw_shots(result), "Residuals of all readings over their own sigmas."),
    }
    return ReportContent(parts=parts, images=images)


def _before(result: TachymeterResult) -> tuple[Array, Array | None]:
    """Return the exit points of the sighted cables before, with their covariances."""
    rows = [result.before.cable_names.index(name) for name in result.cables]
    known = result.before.exit_covariance
    return result.before.exit_points[rows], None if known is None else known[rows]
