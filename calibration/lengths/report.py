"""Tables and the report of a calibration from lengths."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from calibration.lengths.pictures import images
from calibration.lengths.planning import SuggestedPoses
from calibration.lengths.result import LengthCalibration
from calibration.report import blunders_html, observability_html, parameters_html
from calibration.report import write_report as write_page
from carosac_toolkit.reports.page import bullets, table
from carosac_toolkit.text_tables import Rows

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
    """One row per cable."""
    robot, rows = result.robot, Rows()
    moved = np.linalg.norm(robot.exit_points - result.start.exit_points, axis=1)
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
    """One row per suggested pose; the first row is what is known before."""
    now = (f"{1e3 * suggested.sigma[0]:.2f}", f"{1e3 * suggested.worst[0]:.2f}")
    return [("now", "", "", "", *now)] + [
        (str(k + 1), *(f"{v:.2f}" for v in position), f"{1e3 * mean:.2f}", f"{1e3 * worst:.2f}")
        for k, (position, mean, worst) in enumerate(
            zip(suggested.position, suggested.sigma[1:], suggested.worst[1:], strict=True)
        )
    ]


def sentences(result: LengthCalibration) -> list[str]:
    """What was found, in sentences."""
    count = int(result.outlier.sum())
    said = [
        f"readings fit within {1e3 * result.residual_rms:.2f} mm RMS; with the robot as it was "
        f"{1e3 * result.residual_rms_before:.1f} mm",
        f"noise of one reading: {1e3 * result.length_noise:.2f} mm; {count} of "
        f"{result.outlier.size} readings were left out as blunders",
    ]
    if "length_delay" in result.estimate.names:
        row = result.estimate.index("length_delay")
        value, sigma = 1e3 * result.estimate.value[row], 1e3 * result.estimate.sigma[row]
        said.append(f"readings lead the measured poses by {value:.1f} ms (1 sigma {sigma:.1f} ms)")
    if result.inflation > 1.0:
        said.append(
            f"residuals are correlated in time: {result.inflation:.1f} samples count as one"
        )
    if result.gravity is not None:
        x, y = 1e3 * result.gravity.tilt
        said.append(
            f"the frame of the poses is tilted against gravity by {x:.1f} and {y:.1f} mrad about "
            f"x and y (1 sigma {1e3 * result.gravity.sigma.max():.1f} mrad)"
        )
    if not result.anchored:
        said.append(
            "the exit points are in the frame of the measured poses; covariances of the exit "
            "points in the robot file, as from a tachymeter, would make it the robot's own"
        )
    said += [f"left unused: {n} samples with {why}" for why, n in result.skipped.items() if n]
    return said


def write_report(
    folder: Path,
    result: LengthCalibration,
    suggested: SuggestedPoses | None,
    *,
    title: str,
    provenance: Mapping[str, str],
    words: list[str],
) -> list[Path]:
    """Write report.html and its pictures.

    Args:
        folder: Made if need be.
        result: What was found.
        suggested: Further poses, or None.
        title: Of the page.
        provenance: What went in.
        words: The command that repeats this.

    Returns:
        The files, the report last.
    """
    found = result.outliers()
    rows: Rows = [
        (
            entry["cable"], str(entry["sample"]), f"{entry['time_s']:.3f}",
            f"{1e3 * entry['residual_m']:.1f}", f"{entry['sigmas']:.0f}",
        )
        for entry in found[:BLUNDERS_SHOWN_MAX]
    ]  # fmt: skip
    more = (
        f"<p>The first {BLUNDERS_SHOWN_MAX} of {len(found)}.</p>"
        if len(found) > BLUNDERS_SHOWN_MAX
        else ""
    )
    parts = [
        "<h2>Cables</h2>" + table(CABLE_HEADER, cable_rows(result), left=1),
        observability_html(result.observability),
        bullets(result.sentences),
        parameters_html(result.estimate),
    ]
    if suggested is not None:
        note = "<p>Each is the best one together with those above it.</p>"
        poses = table(POSE_HEADER, pose_rows(suggested), left=1)
        parts.append(f"<h2>Poses to measure next</h2>{note}{poses}")
    parts.append(blunders_html(BLUNDER_HEADER, rows, left=1) + more)
    return write_page(
        folder, title, parts, said=sentences(result), warned=result.warnings,
        images=images(result, suggested), provenance=provenance, words=words,
    )  # fmt: skip
