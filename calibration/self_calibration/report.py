"""The report of a self-calibration: report.html and its pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calibration.pictures import draw_learnt, draw_residuals
from calibration.report import (
    blunders_html,
    observability_html,
    parameters_html,
)
from calibration.report import write_report as write_page
from calibration.self_calibration.pictures import draw_ellipses, draw_layout, draw_left_out
from calibration.self_calibration.result import SelfCalibration
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.tables import Rows
from carosac_toolkit.reports.page import png, table

BLUNDER_HEADER = ("sample", "what was left out", "misfit [sigmas]")
LEFT_OUT_HEADER = ("sample", "x [mm]", "y [mm]", "z [mm]", "distance [mm]", "1 sigma x, y, z [mm]")
POSITION_HEADER = ("sample", "x [mm]", "y [mm]", "z [mm]", "1 sigma x, y, z [mm]", "")


def sentences(result: SelfCalibration) -> list[str]:
    """What was found, in words."""
    residual, line = 1e3 * result.residual_rms, 1e3 * result.line_residual_rms
    sure = 1e3 * result.position_sigma[np.isfinite(result.position_sigma)]
    lines = [
        f"lengths of cable fit to {residual:.2f} mm RMS ({line:.2f} mm of line, which is the "
        f"length times the drum's advantage) over {int(result.used.sum())} of "
        f"{len(result.samples)} samples",
        f"the line has {1e3 * result.line_sigma:.2f} mm of noise, told by "
        f"{result.redundancy:.0f} lengths more than the unknowns take",
        f"positions are known to {sure.min():.1f} to {sure.max():.1f} mm (1 sigma per axis)",
    ]
    if result.left_out:
        error = [1e3 * float(np.linalg.norm(one.error)) for one in result.left_out]
        worst = result.left_out[int(np.argmax(error))].sample
        lines.append(
            f"known positions, left out one at a time, are predicted within {max(error):.1f} mm "
            f"(worst: sample {worst}), {np.sqrt(np.mean(np.square(error))):.1f} mm RMS"
        )
    else:
        lines.append("no known position can be left out: the others do not suffice to predict it")
    lines.append(
        "cables were taken as straight and stiff, as no tensions are known; what a constant "
        "tension stretches counts as drum radius"
    )
    return lines


def blunder_rows(result: SelfCalibration) -> Rows:
    """Samples that were left out."""
    return [(b.sample, b.what, f"{b.sigmas:.1f}") for b in result.blunders]


def left_out_rows(result: SelfCalibration) -> Rows:
    """Predicted less known positions."""
    return [
        (
            one.sample,
            *(f"{1e3 * value:+.2f}" for value in one.error),
            f"{1e3 * float(np.linalg.norm(one.error)):.2f}",
            _triple(1e3 * one.sigma),
        )
        for one in result.left_out
    ]


def write_report(
    folder: Path, result: SelfCalibration, source: Path, words: Sequence[str]
) -> list[Path]:
    """Write report.html and its pictures.

    Args:
        folder: Made if need be.
        result: What was found.
        source: The file of motor angles.
        words: The command that repeats it.
    """
    robot = result.robot
    numbers = np.arange(len(result.samples), dtype=np.float64)
    out = np.repeat(~result.used[:, None], robot.n, axis=1)
    drawn = {
        "layout": (draw_layout(result), "Exit points before and after, and all positions."),
        "exit_points": (
            draw_ellipses(result),
            "95 % ellipses of the exit points after the calibration; where they were before is in "
            "the first picture.",
        ),
        "residuals": (
            draw_residuals(
                numbers, result.residual, out, robot.cable_names, label="sample, in order"
            ),
            "Length by the drum less straight length, by cable.",
        ),
        "learnt": (draw_learnt(result.estimate), "What the data taught about each parameter."),
    }
    if result.left_out:
        drawn["left_out"] = (draw_left_out(result), "Known positions predicted from all else.")
    return write_page(
        folder,
        f"Self-calibration of {robot.name} from {source.name}",
        [
            parameters_html(result.estimate),
            observability_html(result.observability),
            "<h2>Known positions left out one at a time</h2><p>Predicted less known; sigma: of "
            "that difference.</p>" + table(LEFT_OUT_HEADER, left_out_rows(result), left=1),
            blunders_html(BLUNDER_HEADER, blunder_rows(result), left=2),
            "<h2>Positions</h2>" + table(POSITION_HEADER, _position_rows(result), left=1),
        ],
        said=sentences(result),
        warned=result.warnings,
        images={name: (png(figure), caption) for name, (figure, caption) in drawn.items()},
        provenance={
            "motor angles": str(source),
            "robot": f"{robot.name}: {robot.description}",
            "robot licence": robot.licence,
        },
        words=words,
    )


def _position_rows(result: SelfCalibration) -> Rows:
    """Where every sample was."""
    blunders = {b.sample: b.what for b in result.blunders}
    rows: Rows = []
    for k, name in enumerate(result.samples):
        sigma = result.position_sigma[k]
        note = f"{blunders[name]} left out" if name in blunders else ""
        rows.append(
            (
                name,
                *(f"{1e3 * value:.1f}" for value in result.position[k]),
                _triple(1e3 * sigma) if np.isfinite(sigma).all() else "unknown",
                note or ("known" if result.is_known[k] else ""),
            )
        )
    return rows


def _triple(values: Array) -> str:
    return ", ".join(f"{value:.1f}" for value in values)
