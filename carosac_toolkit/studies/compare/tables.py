"""Summary of a study as readable rows, in mm and ms."""

from __future__ import annotations

import textwrap
from typing import Any

from carosac_toolkit.base.numbers import plain
from carosac_toolkit.base.tables import Rows, counted
from carosac_toolkit.studies.compare.names import named_labels, robot_names
from carosac_toolkit.studies.compare.results import AXIS_NAMES, COLUMN_TITLES, StudyResults
from carosac_toolkit.studies.compare.terminal_table import (
    after_the_end,
    cases,
    limited,
    mean_tracking,
    percent,
    tension_range,
)

ERROR_TABLE_CAPTION = (
    "Errors in mm. x, y, z, norm: RMSE of the tracking error, all steps of all cases; std: "
    "standard deviation of the norm from case to case; centre: in the middle half of each side "
    "of the workspace box, boundary: the rest; estimate: RMSE of the estimation error in norm; "
    "p95: its 95th percentile; turn: RMSE of the estimated orientation in mrad; sway: RMS "
    "{after_the_end}; tension: least to largest of any cable in N; slack, overload, outside: "
    "share of time with a cable below tension_min, above tension_max, with the platform outside "
    "the workspace box; limited: share of commands that a limit changed; cases: those that "
    "diverged or failed have no score; cycle: latency of estimator and controller, 95th percentile."
)
CONSISTENCY_CAPTION = (
    " NEES: normalised estimation error squared, of pose (6) and of pose and twist (12); NIS: "
    "normalised innovation squared; each over its degrees of freedom, mean over all cases: 1 is "
    "right. + is above the band that 95 % of the means of as many independent draws as there are "
    "seeds lie in: the estimator is overconfident; - is below. rejected: cycles in which a "
    "measurement was rejected."
)
ERROR_TABLE_COLUMNS = (
    *AXIS_NAMES, "std", "centre", "boundary", "estimate", "p95", "turn", "sway", "tension [N]",
    "slack", "overload", "outside", "limited", "cases", "cycle [ms]",
)  # fmt: skip
CONSISTENCY_TITLES = {"nees_pose": "NEES 6", "nees": "NEES 12", "nis": "NIS"}
REASONS_SHOWN = 3  # of a group


def header(results: StudyResults) -> tuple[str, ...]:
    """Return the titles of the columns."""
    titles = [COLUMN_TITLES.get(name, name) for name in _names(results)]
    return (*titles, *ERROR_TABLE_COLUMNS, *_consistency_columns(results))


def units(results: StudyResults) -> str:
    """Explain the columns."""
    end = after_the_end(line["final_rest_s"] for line in results.summary)
    consistency = CONSISTENCY_CAPTION if _consistency_columns(results) else ""
    return ERROR_TABLE_CAPTION.format(after_the_end=end) + consistency


def rows(results: StudyResults) -> Rows:
    """Return one row per group."""
    own = robot_names(results)
    lines = [{**line, "robot": own[str(line["robot"])]} for line in results.summary]
    return [
        (*(str(line[name]) for name in _names(results)), *_cells(line), *more)
        for line, more in zip(lines, _consistency_cells(results), strict=True)
    ]


def name_columns(results: StudyResults) -> int:
    """Return how many columns on the left hold names."""
    return len(_names(results))


def failures(results: StudyResults) -> list[str]:
    """List the groups with cases that failed, and why; indented lines belong to the one above.

    Cases that diverged are a matter of `surprises`.
    """
    lines = []
    for label, line in zip(named_labels(results), results.summary, strict=True):
        failed = line["failures"] - line["diverged"]
        if not failed:
            continue
        cases = counted(line["cases"], "case")
        lines.append(f"{label}: {failed} of {cases} without a score")
        listed = [one for one in line["reasons"].items() if not one[0].startswith("diverged: ")]
        lines += [
            f"  {count} {textwrap.shorten(reason, 200, placeholder=' ...')}"
            for reason, count in listed[:REASONS_SHOWN]
        ]
        if len(listed) > REASONS_SHOWN:
            rest = sum(count for _, count in listed[REASONS_SHOWN:])
            lines.append(f"  {rest} for other reasons")
        if any("no tensions within the limits" in reason for reason, _ in listed):
            lines.append(
                "  paths are drawn in the workspace box of the robot file; carosac workspace "
                f"{line['robot']} shows where in it the robot can rest"
            )
    return lines


def _names(results: StudyResults) -> list[str]:
    """Return the names that every row shows, and those that vary."""
    always = ["controller", "estimator", "sensors"]
    several = [
        name
        for name in ("robot", "perturbation")
        if len({line[name] for line in results.summary}) > 1
    ]
    return several + always


def _cells(line: dict[str, Any]) -> list[str]:
    """Return the numbers of one group."""
    tracking, turn = line["tracking_rmse_m"], line["orientation_rmse_rad"]
    lengths = [
        line["tracking_std_m"], line["tracking_centre_m"],
        line["tracking_boundary_m"], line["estimation_rmse_m"]["norm"], line["estimation_p95_m"],
        turn, line["residual_sway_m"],
    ]  # fmt: skip
    shares = [percent(line[f"{name}_share"]) for name in ("slack", "overload", "outside")]
    latency = line["latency_p95_s"]
    return [
        *(_millimetres(tracking[axis]) for axis in AXIS_NAMES[:-1]), mean_tracking(line),
        *map(_millimetres, lengths), tension_range(line), *shares, limited(line), cases(line),
        "-" if latency is None else f"{latency * 1e3:.2f}",
    ]  # fmt: skip


def _consistency_columns(results: StudyResults) -> list[str]:
    """Return the titles of the covariance columns, if any estimator has one."""
    titles = [
        title for name, title in CONSISTENCY_TITLES.items() if any(x[name] for x in results.summary)
    ]
    rejects = any(line["rejected_share"] is not None for line in results.summary)
    return titles + (["rejected"] if rejects else [])


def _consistency_cells(results: StudyResults) -> list[list[str]]:
    """Return the covariance cells by group."""
    titles = _consistency_columns(results)
    cells = []
    for line in results.summary:
        shown = {title: _square(line[name]) for name, title in CONSISTENCY_TITLES.items()}
        share = line["rejected_share"]
        shown["rejected"] = "-" if share is None else f"{100.0 * share:.1f} %"
        cells.append([shown[title] for title in titles])
    return cells


def _square(value: dict[str, Any] | None) -> str:
    """Format a normalised square, marked if it is outside its band."""
    if value is None:
        return "-"
    low, high = value["band"]
    mark = "+" if value["mean"] > high else "-" if value["mean"] < low else " "
    return f"{plain(value['mean'], 3)}{mark}"


def _millimetres(metres: float | None) -> str:
    """Format a length in mm, or an angle in mrad."""
    return "-" if metres is None else f"{metres * 1e3:.1f}"
