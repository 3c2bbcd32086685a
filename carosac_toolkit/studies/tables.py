"""The summary of a study as rows for people: mm and ms."""

from __future__ import annotations

import textwrap
from typing import Any

from carosac_toolkit.studies.results import NAMES, StudyResults
from carosac_toolkit.text_tables import Rows, fit

UNITS = (
    "Errors in mm. x, y, z, norm: RMSE of the tracking error, all steps of all cases; std: "
    "standard deviation of the norm from case to case; centre: in the middle half of each side "
    "of the workspace box, boundary: the rest; estimate: RMSE of the estimation error in norm; "
    "sway: RMS in the 3 s after the end; failed: cases without a score; p95: latency of "
    "estimator and controller, 95th percentile."
)
SHORT_UNITS = "Tracking error in mm: RMSE over all cases, standard deviation from case to case"
COLUMNS = (
    *NAMES, "std", "centre", "boundary", "estimate", "sway", "failed", "p95 [ms]",
)  # fmt: skip
GROUPS = (3, 2, 2, 2, 2)  # columns that stay together
REASONS_SHOWN = 3  # of a group


def header(results: StudyResults) -> tuple[str, ...]:
    """Titles of the columns."""
    return (*_names(results), *COLUMNS)


def rows(results: StudyResults) -> Rows:
    """One row per group."""
    return [
        (*(str(line[name]) for name in _names(results)), *_cells(line)) for line in results.summary
    ]


def name_columns(results: StudyResults) -> int:
    """How many columns on the left hold names."""
    return len(_names(results))


def text_table(results: StudyResults, width: int) -> str:
    """The table within a width, in as many blocks as it takes."""
    titles, cells = header(results), rows(results)
    left = name_columns(results)
    widths = [max(len(line[i]) for line in [titles, *cells]) for i in range(len(titles))]
    numbers = max(sum(w + 2 for w in widths[left + 3 * k :][:3]) for k in range(4))
    shown = max(widths[:left])
    while shown > 8 and sum(min(w, shown) + 2 for w in widths[:left]) + numbers - 2 > width:
        shown -= 1
    return fit(titles, cells, (left, *GROUPS), width, shown=shown)


def failures(results: StudyResults) -> list[str]:
    """Which groups lost cases, and why; lines that begin with a blank belong to the last one."""
    lines = []
    for label, line in zip(results.labels, results.summary, strict=True):
        if not line["failures"]:
            continue
        lines.append(f"{label}: {line['failures']} of {line['cases']} cases without a score")
        listed = list(line["reasons"].items())
        lines += [f"  {count} {_short(reason)}" for reason, count in listed[:REASONS_SHOWN]]
        if len(listed) > REASONS_SHOWN:
            rest = sum(count for _, count in listed[REASONS_SHOWN:])
            lines.append(f"  {rest} for other reasons")
    return lines


def _short(reason: str) -> str:
    """First 200 characters on one line."""
    return textwrap.shorten(reason, 200, placeholder=" ...")


def _names(results: StudyResults) -> list[str]:
    """Names that every row shows, and those that vary."""
    always = ["controller", "estimator", "suite"]
    several = [
        name
        for name in ("robot", "perturbation")
        if len({line[name] for line in results.summary}) > 1
    ]
    return several + always


def _cells(line: dict[str, Any]) -> list[str]:
    """Numbers of one group."""
    tracking, estimate = line["tracking_rmse_m"], line["estimation_rmse_m"]["norm"]
    lengths = [
        *(tracking[axis] for axis in NAMES), line["tracking_std_m"], line["tracking_centre_m"],
        line["tracking_boundary_m"], estimate, line["residual_sway_m"],
    ]  # fmt: skip
    failed = f"{line['failures']}/{line['cases']}"
    latency = line["latency_p95_s"]
    return [*map(_millimetres, lengths), failed, "-" if latency is None else f"{latency * 1e3:.2f}"]


def _millimetres(metres: float | None) -> str:
    """A length in mm."""
    return "-" if metres is None else f"{metres * 1e3:.1f}"
