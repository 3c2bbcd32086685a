"""Tables and the report of a calibration from lengths."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration.lengths.pictures import images
from calibration.lengths.planning import SuggestedPoses
from calibration.lengths.result import LengthCalibration
from calibration.report import (
    ReportContent,
    blunders_html,
    observability_html,
    parameters_html,
)
from calibration.sensor_errors import SensorError, sensors_html
from carosac_toolkit.base.tables import Rows
from carosac_toolkit.reports.page import bullets, table

CABLE_HEADER = (
    "cable", "RMS before [mm]", "RMS after [mm]", "exit point moved [mm]", "known to [mm]",
    "offset [mm]", "left out",
)  # fmt: skip
CABLE_GROUPS = (1, 2, 2, 2)
BLUNDER_HEADER = ("cable", "sample", "time [s]", "residual [mm]", "sigmas")
POSE_HEADER = ("pose", "x [m]", "y [m]", "z [m]", "exit points to, RMS [mm]", "worst [mm]")
POSE_GROUPS = (1, 3, 2)
BLUNDERS_SHOWN_MAX = 200  # blunders in the report


def cable_rows(result: LengthCalibration) -> Rows:
    """Return one row per cable."""
    robot, rows = result.robot, Rows()
    moved = np.linalg.norm(robot.exit_points - result.before.exit_points, axis=1)
    offset = np.zeros(robot.n) if robot.length_offset is None else robot.length_offset
    for i, name in enumerate(robot.cable_names):
        kept = ~result.outlier[:, i]
        before = np.sqrt(np.mean(result.residual_before[kept, i] ** 2))
        after = np.sqrt(np.mean(result.residual[kept, i] ** 2))
        block = None if robot.exit_covariance is None else robot.exit_covariance[i]
        known = "-" if block is None else f"{1e3 * np.sqrt(np.trace(block)):.1f}"
        rows.append(
            (
                name,
                f"{1e3 * before:.1f}",
                f"{1e3 * after:.2f}",
                f"{1e3 * moved[i]:.1f}",
                known,
                f"{1e3 * offset[i]:.1f}",
                str(int((~kept).sum())),
            )
        )
    return rows


def pose_rows(suggested: SuggestedPoses) -> Rows:
    """Return one row per suggested pose; the first row is what is known before."""
    now = (f"{1e3 * suggested.sigma[0]:.2f}", f"{1e3 * suggested.worst[0]:.2f}")
    return [("now", "", "", "", *now)] + [
        (str(k + 1), *(f"{v:.2f}" for v in position), f"{1e3 * mean:.2f}", f"{1e3 * worst:.2f}")
        for k, (position, mean, worst) in enumerate(
            zip(suggested.position, suggested.sigma[1:], suggested.worst[1:], strict=True)
        )
    ]


def report_content(
    result: LengthCalibration,
    suggested: SuggestedPoses | None,
    sensors: Sequence[SensorError] = (),
) -> ReportContent:
    """Return tables and pictures of the report, with further poses and sensors if there are any."""
    outliers = result.outliers()
    rows: Rows = [
        (
            entry["cable"], str(entry["sample"]), f"{entry['time_s']:.3f}",
            f"{1e3 * entry['residual_m']:.1f}", f"{entry['sigmas']:.0f}",
        )
        for entry in outliers[:BLUNDERS_SHOWN_MAX]
    ]  # fmt: skip
    parts = [
        "<h2>Cables</h2>" + table(CABLE_HEADER, cable_rows(result), left=1),
        observability_html(result.observability),
        bullets(result.notes),
        parameters_html(result.estimate),
        sensors_html(sensors),
    ]
    if suggested is not None:
        note = "<p>Each is the best one together with those above it.</p>"
        poses = table(POSE_HEADER, pose_rows(suggested), left=1)
        parts.append(f"<h2>Poses to measure next</h2>{note}{poses}")
    parts.append(blunders_html(BLUNDER_HEADER, rows, left=1))
    if len(outliers) > len(rows):
        parts.append(f"<p>The first {len(rows)} of {len(outliers)}.</p>")
    return ReportContent(parts=parts, images=images(result, suggested))
