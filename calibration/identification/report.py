"""The report of an identification: what moved as measured, and what was learnt."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration.identification.pictures import draw_motion, draw_rests, draw_runs
from calibration.identification.result import Identification, ScoredRange
from calibration.pictures import draw_learnt
from calibration.report import ReportContent, observability_html, parameters_html
from carosac_toolkit.base.tables import Rows
from carosac_toolkit.pictures.saving import png
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.reports.page import table

SCORE_HEADER = (
    "samples", "robot", "x [mm]", "y [mm]", "z [mm]", "norm [mm]", "largest [mm]", "angle [deg]",
)  # fmt: skip


def score_rows(result: Identification) -> Rows:
    """Return the RMS errors before and after, of both ranges."""
    rows: Rows = []
    parts: list[tuple[str, ScoredRange | None]] = [
        ("fitted", result.train),
        ("kept back", result.test),
    ]
    for word, part in parts:
        if part is None:
            continue
        for robot, scores in (("before", part.before), ("after", part.after)):
            name = f"{part.words} ({word})" if robot == "before" else ""
            numbers = [f"{value * 1e3:.1f}" for value in (*scores.rmse, scores.max[3])]
            rows.append((name, robot, *numbers, f"{np.degrees(scores.orientation_rmse):.2f}"))
    return rows


def report_content(result: Identification, recordings: Sequence[Recording]) -> ReportContent:
    """Return tables and pictures of the report on an identification from recordings."""
    worst = int(np.argmax([run.rmse[1] for run in result.runs]))
    images = {
        "motion": (
            png(draw_motion(result, result.runs[worst], recordings[worst])),
            "Error of the open-loop simulation, before and after. Grey: the winches rest. White on "
            "the right of the line: samples that were not fitted.",
        ),
        "rests": (
            png(draw_rests(result)),
            "Mean measured position of each rest against the equilibrium of its lengths.",
        ),
        "learnt": (png(draw_learnt(result.estimate)), "Prior and posterior of each parameter."),
    }
    if len(recordings) > 1:
        words = "Error of each recording, before and after; the worst of them is drawn above."
        images["recordings"] = (png(draw_runs(result)), words)
    scores = (
        "<h2>Open-loop errors</h2><p>Root mean squares of simulated minus measured poses, in world "
        "frame W; no pose is fed back.</p>" + table(SCORE_HEADER, score_rows(result), left=2)
    )
    parts = [scores, parameters_html(result.estimate), observability_html(result.observability)]
    return ReportContent(parts=parts, images=images)
