"""Tables and the report of a calibration from rests."""

from __future__ import annotations

import numpy as np

from calibration.report import (
    ReportContent,
    blunders_html,
    observability_html,
    parameters_html,
)
from calibration.rests.pictures import images
from calibration.rests.result import RestCalibration
from calibration.sensor_errors import SENSOR_WORDS, sensors_html
from carosac_toolkit.base.tables import Rows
from carosac_toolkit.reports.page import table

BLUNDER_HEADER = ("sensor", "cable", "rest", "sigmas")
BLUNDER_GROUPS = (2, 2)
REST_HEADER = (
    "rest", "time [s]", "x [m]", "y [m]", "z [m]", "1 sigma x, y, z [mm]",
    "1 sigma about x, y, z [degrees]",
)  # fmt: skip


def blunder_rows(result: RestCalibration) -> Rows:
    """Return the readings that were left out."""
    return [
        (SENSOR_WORDS[b.sensor][0], b.cable or "", str(b.rest), f"{b.sigmas:.0f}")
        for b in result.blunders
    ]


def report_content(result: RestCalibration) -> ReportContent:
    """Return tables and pictures of the report."""
    parts = [
        observability_html(result.observability),
        parameters_html(result.estimate),
        sensors_html(result.sensors),
        "<h2>Poses of rest</h2>" + table(REST_HEADER, _rest_rows(result), left=1),
        blunders_html(BLUNDER_HEADER, blunder_rows(result), left=2),
    ]
    return ReportContent(parts=parts, images=images(result))


def _rest_rows(result: RestCalibration) -> Rows:
    """Return one row for each rest."""
    rows: Rows = []
    for k, (time, place, sigma) in enumerate(
        zip(result.time, result.position, result.pose_sigma, strict=True)
    ):
        rows.append(
            (
                str(k), f"{time:.2f}", *(f"{x:.4f}" for x in place),
                ", ".join(f"{1e3 * x:.1f}" for x in sigma[:3]),
                ", ".join(f"{x:.2f}" for x in np.rad2deg(sigma[3:])),
            )
        )  # fmt: skip
    return rows
