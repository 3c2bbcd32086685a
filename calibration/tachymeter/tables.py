"""Tables and sentences on a survey, for terminal and report."""

from __future__ import annotations

import numpy as np

from calibration.tachymeter.observations import ARCSEC_RAD, READING_NAMES
from calibration.tachymeter.result import BLUNDER_SHARE_MAX, CHI2_PROBABILITY, TachymeterResult
from carosac_toolkit.text_tables import Rows

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
BLUNDERS_NAMED_MAX = 10  # blunders that are named in sentences
_READING_SCALE = np.array([1.0 / ARCSEC_RAD, 1.0 / ARCSEC_RAD, 1e3])


def exit_rows(result: TachymeterResult) -> Rows:
    """One row for each cable, measured or not."""
    rows: Rows = []
    for i, name in enumerate(result.robot.cable_names):
        before = result.robot.exit_points[i]
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
    """One row for each reading left out, the worst first."""
    return [
        (
            str(b.shot or "-"), b.setup or "-", b.target, b.reading, b.size, f"{b.sigmas:.1f}",
            b.or_else or "-", b.source or "-",
        )
        for b in result.blunders
    ]  # fmt: skip


def setup_rows(result: TachymeterResult) -> Rows:
    """One row for each set-up."""
    rows: Rows = []
    residuals = result.residuals
    for name, station in result.stations.items():
        mine = np.array([shot.setup == name for shot in result.survey.shots])
        used = residuals.used[mine]
        square = (residuals.value[mine] ** 2 * used).sum(axis=0)
        rms = np.sqrt(square / np.maximum(used.sum(axis=0), 1)) * _READING_SCALE
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
    """One row for each shot, with residuals; those left out in brackets."""
    rows: Rows = []
    residuals = result.residuals
    for i, shot in enumerate(result.survey.shots):
        cells = []
        for k in range(len(READING_NAMES)):
            value = f"{residuals.value[i, k] * _READING_SCALE[k]:+.{2 if k == 2 else 1}f}"
            test = f"{residuals.test[i, k]:+.1f}"
            cells += [value, test] if residuals.used[i, k] else [f"({value})", f"({test})"]
        rows.append(
            (str(i + 1), shot.setup, shot.target, shot.sighting.kind, *cells, shot.source or "-")
        )
    return rows


def sentences(result: TachymeterResult) -> list[str]:
    """What was found, in words."""
    survey = result.survey
    known, ties = len(survey.known), len(survey.targets) - len(result.cables)
    rms = result.residuals.rms() * _READING_SCALE
    low, high = result.chi2_band
    lines = [
        f"{len(survey.shots)} shots from {len(survey.setups)} set-ups to {len(result.cables)} exit "
        f"points, {known} known points and {ties - known} tie points",
        f"residuals (RMS): Hz {rms[0]:.1f} arcsec, V {rms[1]:.1f} arcsec, distance {rms[2]:.2f} mm",
        f"chi2 {result.chi2:.1f} with {result.freedom} degrees of freedom; "
        f"{CHI2_PROBABILITY:.0%} of surveys with the stated accuracy lie between {low:.1f} and "
        f"{high:.1f}",
        f"exit points known to {1e3 * result.exit_sigma.min():.2f} to "
        f"{1e3 * result.exit_sigma.max():.2f} mm per axis (one standard deviation)",
    ]
    if "pose_tilt.x" in result.estimate.names:
        tilt = result.estimate.select(["pose_tilt.x", "pose_tilt.y"])
        x, y = 1e3 * tilt.value
        lines.append(
            f"the frame of the known points is tilted against gravity by {x:+.2f} mrad about x and "
            f"{y:+.2f} mrad about y, known to {1e3 * tilt.sigma.max():.2f} mrad"
        )
    return lines


def cautions(result: TachymeterResult) -> list[str]:
    """What must not be overlooked."""
    lines = result.misplaced()
    if result.freedom < 1:
        lines.append("nothing is measured twice, so nothing here is checked: sight more points")
    elif not result.fits:
        size = max(result.spread, np.sqrt(result.chi2 / result.freedom))
        many = f", and {result.left_out:.0%} of the readings were left out"
        lines.append(
            f"the residuals are {size:.1f} times larger than the stated accuracy explains"
            + (many if result.left_out > BLUNDER_SHARE_MAX else "")
            + ": do not use these exit points before it is clear why. Is the instrument's accuracy "
            "right, was it level, did a set-up or a point move, is the frame of the known points "
            "level (--frame-tilt-deg)?"
        )
    elif result.chi2 < result.chi2_band[0]:
        lines.append(
            "the residuals are smaller than the stated accuracy explains: the sigmas are cautious"
        )
    lines += [f"left out: {blunder.sentence()}" for blunder in result.blunders[:BLUNDERS_NAMED_MAX]]
    if len(result.blunders) > BLUNDERS_NAMED_MAX:
        more = len(result.blunders) - BLUNDERS_NAMED_MAX
        lines.append(f"left out: {more} more readings, in report and JSON")
    if result.unchecked:
        lines.append(
            "a blunder would pass unseen in: "
            + "; ".join(result.unchecked)
            + ". Sight them again, best from another set-up"
        )
    if len(result.survey.known) < 3:
        lines.append("fewer than three known points: a wrong coordinate among them may not show")
    if result.unmeasured:
        lines.append(f"not sighted, left as they were: {', '.join(result.unmeasured)}")
    if not result.converged:
        lines.append("the choice of blunders did not come to rest: look at the residuals yourself")
    return lines
