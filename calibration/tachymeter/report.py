"""A survey as a folder: pictures, and one report.html that needs nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from calibration.pictures import draw_exit_points
from calibration.report import blunders_html, observability_html, parameters_html, write_report
from calibration.tachymeter.pictures import SIGMA_MAGNIFICATION, draw_shots, draw_site
from calibration.tachymeter.result import TachymeterResult
from calibration.tachymeter.tables import (
    BLUNDER_HEADER,
    EXIT_HEADER,
    SETUP_HEADER,
    SHOT_HEADER,
    blunder_rows,
    cautions,
    exit_rows,
    sentences,
    setup_rows,
    shot_rows,
)
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.reports.page import png, table


def write_survey_report(
    folder: Path, result: TachymeterResult, *, provenance: Mapping[str, str], words: Sequence[str]
) -> list[Path]:
    """Draw the pictures and write the report; every file appears whole, or nothing does.

    Args:
        folder: Made if need be; files of an earlier report in it are replaced.
        result: What was found.
        provenance: What went in.
        words: The command that repeats this.

    Returns:
        The files, the report last.
    """
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
            png(draw_site(result)),
            "Lines of sight; ellipses: 1 sigma of the exit points, "
            f"{SIGMA_MAGNIFICATION:.0f} times larger.",
        ),
        "exit_points": (
            png(draw_exit_points(result.cables, *_before(result), *_after(result))),
            "Exit points before and after; the ellipses hold 95 %.",
        ),
        "shots": (png(draw_shots(result)), "Residuals of all readings over their own sigmas."),
    }
    return write_report(
        folder,
        f"Tachymeter survey of {result.robot.name}",
        parts,
        said=sentences(result),
        warned=cautions(result),
        images=images,
        provenance=provenance,
        words=words,
    )


def _before(result: TachymeterResult) -> tuple[Array, Array | None]:
    """Exit points of the sighted cables before, with their covariances."""
    rows = [result.robot.cable_names.index(name) for name in result.cables]
    known = result.robot.exit_covariance
    return result.robot.exit_points[rows], None if known is None else known[rows]


def _after(result: TachymeterResult) -> tuple[Array, Array]:
    """The same after."""
    count = len(result.cables)
    blocks = result.exit_covariance.reshape(count, 3, count, 3)
    return result.exit_points, np.array([blocks[i, :, i] for i in range(count)])
