"""Tables and sentences on a survey, for terminal and report."""

from __future__ import annotations

import numpy as np

from calibration.tachymeter.observations import READING_NAMES
from calibration.tachymeter.result import READING_SCALE, TachymeterResult
from carosac_toolkit.base.tables import Rows

EXIT_HEADER = (
    "cable",
    "x before [m]", "y before [m]", "z before [m]",
    "x [m]", "y [m]", "z [m]",
    "sigma x [mm]", "sigma y [mm]", "sigma z [mm]",
    "moved by [mm]",
)  # fmt: skip
EXIT_GROUPS = (1, 3, 3, 3, 1)
BLUNDER_HEADER = ("shot", "set-up", "target", "reading", "off by", "sigmas", "or else", "line")
SETUP_HEADER = (
    "set-up", "x [m]", "y [m]", "z [m]", "heading [deg]", "shots", "RMS Hz [arcsec]",
    "RMS V [arcsec]", "RMS distance [mm]",
)  # fmt: skip
SETUP_GROUPS = (1, 4, 4)
SHOT_HEADER = (
    "shot", "set-up", "target", "sighted", "Hz [arcsec]", "sigmas", "V [arcsec]", "sigmas",
    "distance [mm]", "sigmas", "line",
)  # fmt: skip


def exit_rows(result: TachymeterResult) -> Rows:
    """Return one row for each cable, measured or not."""
    rows: Rows = []
    for i, name in enumerate(result.before.cable_names):
        before = result.before.exit_points[i]
        start = (name, *(f"{value:.4f}" for value in before))
        if name not in result.cables:
            rows.append((*start, *("-",) * 6, "not sighted"))
            continue
        after = result.points[name]
        sigma = result.exit_sigma[result.cables.index(name)]
        moved = 1e3 * float(np.linalg.norm(after - before))
        rows.append(
            (
                *start,
                *(f"{value:.4f}" for value in after),
                *(f"{1e3 * value:.2f}" for value in sigma),
                f"{moved:.1f}",
            )
        )
    return rows


def blunder_rows(result: TachymeterResult) -> Rows:
    """Return one row for each reading left out, the worst first."""
    return [
        (
            str(b.shot or "-"), b.setup or "-", b.target, b.reading, b.size, f"{b.sigmas:.1f}",
            b.or_else or "-", b.source or "-",
        )
        for b in result.blunders
    ]  # fmt: skip


def setup_rows(result: TachymeterResult) -> Rows:
    """Return one row for each set-up."""
    rows: Rows = []
    residuals = result.residuals
    for name, station in result.stations.items():
        mine = np.array([shot.setup == name for shot in result.survey.shots])
        used = residuals.used[mine]
        square = (residuals.value[mine] ** 2 * used).sum(axis=0)
        rms = np.sqrt(square / np.maximum(used.sum(axis=0), 1)) * READING_SCALE
        heading = float(np.rad2deg(station.values[3]) % 360.0)
        rows.append(
            (
                name,
                *(f"{value:.3f}" for value in station.values[:3]),
                f"{heading:.3f}",
                str(int(mine.sum())),
                f"{rms[0]:.1f}",
                f"{rms[1]:.1f}",
                f"{rms[2]:.2f}",
            )
        )
    return rows


def shot_rows(result: TachymeterResult) -> Rows:
    """Return one row for each shot, with residuals; those left out in brackets."""
    rows: Rows = []
    residuals = result.residuals
    for i, shot in enumerate(result.survey.shots):
        cells = []
        for k in range(len(READING_NAMES)):
            value = f"{residuals.value[i, k] * READING_SCALE[k]:+.{2 if k == 2 else 1}f}"
            test = f"{residuals.test[i, k]:+.1f}"
            cells += [value, test] if residuals.used[i, k] else [f"({value})", f"({test})"]
        rows.append(
            (str(i + 1), shot.setup, shot.target, shot.sighting.kind, *cells, shot.source or "-")
        )
    return rows
