"""The report of an identification: what moved as measured, and what was learnt."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from calibration.identification.frequencies import FREQUENCY_HEADER
from calibration.identification.pictures import draw_motion, draw_rests, draw_runs
from calibration.identification.result import Identification, ScoredRange
from calibration.pictures import draw_learnt
from calibration.report import ReportContent, observability_html, parameters_html
from carosac_toolkit.base.tables import Rows
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.reports.page import table
from carosac_toolkit.reports.validation import EFFECTS_TEXT
from carosac_toolkit.validation.residual_effects import ResidualEffects, effects_sentence
from carosac_toolkit.validation.tables import EFFECT_HEADER, effect_rows

IDENTIFIED = "the identified robot"
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


def report_content(
    result: Identification, recordings: Sequence[Recording], effects: ResidualEffects | str
) -> ReportContent:
    """Return tables and pictures of the report on an identification from recordings.

    Args:
        result: The identification.
        recordings: In the order of its runs.
        effects: What the errors of its recordings look like, or why that cannot be told.
    """
    worst = result.worst
    images = {
        "motion": (
            draw_motion(result, result.runs[worst], recordings[worst]),
            "Error of the open-loop simulation, before and after. Samples on the right of the line "
            "were not fitted.",
        ),
        "rests": (
            draw_rests(result),
            "Mean measured position of each rest against the equilibrium of its lengths.",
        ),
        "learnt": (
            draw_learnt(result.robot.name, result.estimate),
            "Prior and posterior of each parameter.",
        ),
    }
    if len(recordings) > 1:
        words = "Error of each recording, before and after; the worst of them is drawn above."
        images["recordings"] = (draw_runs(result), words)
    scores = (
        "<h2>Open-loop errors</h2><p>Root mean squares of simulated minus measured poses, in world "
        "frame W; no pose is fed back.</p>" + table(SCORE_HEADER, score_rows(result), left=2)
    )
    left = f"<p>{escape(effects_sentence(effects, IDENTIFIED))}</p>"
    if isinstance(effects, ResidualEffects):
        left = EFFECTS_TEXT + table(EFFECT_HEADER, effect_rows(effects), left=1)
    left = f"<h2>What the remaining error looks like</h2>{left}"
    found, frequencies = result.frequencies, ""
    if found is not None:
        frequencies = "<h2>Natural frequencies</h2>" + table(FREQUENCY_HEADER, found.rows(), left=1)
    parts = [
        scores,
        frequencies,
        left,
        parameters_html(result.estimate),
        observability_html(result.observability),
    ]
    return ReportContent(parts=parts, images=images)
