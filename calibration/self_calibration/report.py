"""The report of a self-calibration: report.html and its pictures."""

from __future__ import annotations

import numpy as np

from calibration.pictures import draw_exit_points, draw_learnt, draw_residuals
from calibration.report import (
    ReportContent,
    blunders_html,
    observability_html,
    parameters_html,
)
from calibration.self_calibration.pictures import draw_layout, draw_left_out
from calibration.self_calibration.result import SelfCalibration
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.tables import Rows
from carosac_toolkit.reports.page import table

BLUNDER_HEADER = ("sample", "what was left out", "misfit [sigmas]")
LEFT_OUT_HEADER = ("sample", "x [mm]", "y [mm]", "z [mm]", "distance [mm]", "1 sigma x, y, z [mm]")
POSITION_HEADER = ("sample", "x [mm]", "y [mm]", "z [mm]", "1 sigma x, y, z [mm]", "")


def blunder_rows(result: SelfCalibration) -> Rows:
    """Return the samples that were left out."""
    return [(b.sample, b.what, f"{b.sigmas:.1f}") for b in result.blunders]


def left_out_rows(result: SelfCalibration) -> Rows:
    """Return predicted less known positions."""
    return [
        (
            one.sample,
            *("" if np.isnan(value) else f"{1e3 * value:+.2f}" for value in one.error),
            f"{1e3 * one.distance:.2f}",
            _triple(1e3 * one.sigma),
        )
        for one in result.left_out
    ]


def report_content(result: SelfCalibration) -> ReportContent:
    """Return tables and pictures of the report."""
    robot, names = result.before.name, result.before.cable_names
    numbers = np.arange(len(result.samples), dtype=np.float64)
    out = np.repeat(~result.used[:, None], len(names), axis=1)
    drawn = {
        "layout": (draw_layout(result), "Exit points before and after, and all positions."),
        "exit_points": (
            draw_exit_points(
                robot,
                names,
                result.before.exit_points,
                result.exit_covariance_before,
                *result.exit_points_of(names),
            ),
            "Exit points before (grey) and after (blue) with their 95 % ellipses, relative to the "
            "calibrated ones.",
        ),
        "residuals": (
            draw_residuals(robot, numbers, result.residual, out, names, label="sample, in order"),
            "Length by the drum less straight length, by cable.",
        ),
        "learnt": (draw_learnt(robot, result.estimate), "Prior and posterior of each parameter."),
    }
    if result.left_out:
        drawn["left_out"] = (draw_left_out(result), "Known positions predicted from all else.")
    parts = [
        parameters_html(result.estimate),
        observability_html(result.observability),
        "<h2>Known positions left out one at a time</h2><p>Predicted less known; sigma: of "
        "that difference.</p>" + table(LEFT_OUT_HEADER, left_out_rows(result), left=1),
        blunders_html(BLUNDER_HEADER, blunder_rows(result), left=2),
        "<h2>Positions</h2>" + table(POSITION_HEADER, _position_rows(result), left=1),
    ]
    return ReportContent(parts=parts, images=drawn)


def _position_rows(result: SelfCalibration) -> Rows:
    """Return the positions of all samples."""
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
    return ", ".join("-" if np.isnan(value) else f"{value:.1f}" for value in values)
