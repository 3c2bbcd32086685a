"""Results of a study: its rows, and one summary line per group.

How rows become one line:

* Squared errors are pooled: an RMSE over cases is the root of the mean of their squared RMSEs,
  weighted with their numbers of steps, so that it is the RMSE of all steps together. Centre and
  boundary are weighted with their own steps; the sway after the end is weighted evenly.
* The standard deviation is that of the cases' RMSEs in norm (trajectories and seeds alike).
* NEES and NIS are means over the cases, each the mean of one run. Samples of a run depend on each
  other, and runs of one seed have plant and sensor biases in common, so the band in which 95 % of
  such means lie is that of as many independent draws as there are seeds: wider than it could be,
  never narrower.
* Latencies are medians over the cases of their median, 95th and 99th percentile.
* Cases that diverged, failed, crashed or timed out have no errors; they are counted, with their
  reasons. Tensions and limited commands are over the cases that diverged as well.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from carosac_toolkit.loop.consistency import POSE_SIZE, STATE_SIZE, band
from carosac_toolkit.studies.compare.feasibility import PathFeasibility
from carosac_toolkit.studies.run.rows import LATENCY_COLUMNS, Row

COMPARED_COLUMNS = ("controller", "estimator", "sensors")  # what is compared
GROUP_COLUMNS = ("robot", "controller", "estimator", "sensors", "perturbation")
PAIR_COLUMNS = (
    "trajectory",
    "seed",
)  # with robot and perturbation: the same plant on the same path
COLUMN_TITLES = {"perturbation": "condition"}  # where a reader knows it by another word
AXIS_NAMES = ("x", "y", "z", "norm")
ROBOT_COLUMNS = ("tension_limit_low_N", "tension_limit_high_N", "winch_reach_m", "final_rest_s")
_NUMBER_PATTERN = re.compile(r"[-+]?\d[\d.]*(?:e[-+]?\d+)?")


@dataclass(frozen=True, kw_only=True, eq=False)
class StudyResults:
    """Rows of a study, and their summary.

    Attributes:
        rows: One per case, in the order of the cases.
        folder: Folder that holds them.
        feasibility: Feasibility of its paths, where that was judged.
    """

    rows: tuple[Row, ...]
    folder: Path
    feasibility: tuple[PathFeasibility, ...] = ()

    @cached_property
    def groups(self) -> list[list[Row]]:
        """Rows of each robot, controller, estimator, sensors and perturbation, in order."""
        by_group: dict[tuple[Any, ...], list[Row]] = {}
        for row in self.rows:
            by_group.setdefault(tuple(row[name] for name in GROUP_COLUMNS), []).append(row)
        return list(by_group.values())

    @cached_property
    def summary(self) -> list[dict[str, Any]]:
        """One line per group; unknown values are None."""
        return [_line(rows) for rows in self.groups]

    @cached_property
    def labels(self) -> list[str]:
        """Short, distinct names of the groups: the fields that they do not share."""
        return self.labels_of(GROUP_COLUMNS)

    def labels_of(self, names: Sequence[str]) -> list[str]:
        """Name the groups by those of some fields that they do not share."""
        return labels_by(names, self.summary)

    @property
    def complete(self) -> bool:
        """True if at least one case of every group succeeded."""
        return all(line["failures"] < line["cases"] for line in self.summary)

    def data(self) -> dict[str, Any]:
        """Return all numbers under names with units, ready for JSON."""
        return {
            "summary": self.summary,
            "cases": len(self.rows),
            "feasibility": [one.data() for one in self.feasibility],
        }


def labels_by(names: Sequence[str], lines: Sequence[Mapping[str, Any]]) -> list[str]:
    """Name lines by those of some fields that they do not share."""
    varies = [name for name in names if len({line[name] for line in lines}) > 1]
    return [" / ".join(str(line[name]) for name in varies or ["controller"]) for line in lines]


def scored(rows: Sequence[Row]) -> list[Row]:
    """Return the rows of cases that succeeded."""
    return [row for row in rows if row["status"] == "ok"]


def tracked(rows: Sequence[Row]) -> list[Row]:
    """Return the rows with a tracking error: a driver that follows commands, and a known truth."""
    return [row for row in scored(rows) if row.get("tracking_rmse_norm_m") is not None]


def estimated(rows: Sequence[Row]) -> list[Row]:
    """Return the rows with an estimation error: cases that succeeded, and a known truth."""
    return [row for row in scored(rows) if row.get("estimation_rmse_norm_m") is not None]


def shared_cases(rows: Sequence[Row], others: Sequence[Row]) -> tuple[list[Row], list[Row]]:
    """Return the rows of the cases that two groups of rows share, in the same order."""
    one, two = (
        {tuple(row[name] for name in PAIR_COLUMNS): row for row in part} for part in (rows, others)
    )
    common = [key for key in one if key in two]
    return [one[key] for key in common], [two[key] for key in common]


def pooled(rows: Sequence[Row], name: str, weights: Sequence[float]) -> float | None:
    """Return the root of the weighted mean of squares of a column, None if no row has it."""
    pairs = [(row.get(name), w) for row, w in zip(rows, weights, strict=True)]
    known = [(float(value), w) for value, w in pairs if value is not None and w > 0]
    if not known:
        return None
    values, counts = np.array(known).T
    return float(np.sqrt((counts * values**2).sum() / counts.sum()))


def steps(rows: Sequence[Row]) -> list[float]:
    """Return the number of steps of each row."""
    return [_number(row, "steps") for row in rows]


def reasons(rows: Sequence[Row]) -> dict[str, int]:
    """Count why cases have no scores, most frequent first, whatever their numbers."""
    counts: dict[str, int] = {}
    shown: dict[str, str] = {}
    for row in rows:
        if row["status"] == "ok":
            continue
        text = f"{str(row['status']).replace('_', ' ')}: {row['reason']}"
        kind = shown.setdefault(_NUMBER_PATTERN.sub("#", text), text)
        counts[kind] = counts.get(kind, 0) + 1
    return dict(sorted(counts.items(), key=lambda pair: -pair[1]))


def _line(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the summary of one group."""
    good, moved = scored(rows), tracked(rows)
    norms = [float(row["tracking_rmse_norm_m"] or 0.0) for row in moved]
    inside = [_number(row, "centre_steps") for row in moved]
    outside = [all_steps - k for all_steps, k in zip(steps(moved), inside, strict=True)]
    return {
        **{name: rows[0][name] for name in GROUP_COLUMNS},
        "cases": len(rows),
        "failures": len(rows) - len(good),
        "diverged": sum(row["status"] == "diverged" for row in rows),
        "statuses": dict(Counter(str(row["status"]) for row in rows)),
        "incomplete": sum(row.get("completed") is False for row in good),
        "tracking_rmse_m": _per_axis(moved, "tracking"),
        "tracking_std_m": float(np.std(norms, ddof=1)) if len(norms) > 1 else None,
        "estimation_rmse_m": _per_axis(good, "estimation"),
        "estimation_p95_m": _mean(good, "estimation_p95_m"),
        "orientation_rmse_rad": pooled(good, "orientation_rmse_rad", steps(good)),
        "nees_pose": _normalised(good, "nees_pose", POSE_SIZE),
        "nees": _normalised(good, "nees", STATE_SIZE),
        "nis": _normalised(good, "nis", _mean(good, "nis_dof")),
        "rejected_share": _mean(good, "rejected_share"),
        "covariance_faults": int(sum(_number(row, "covariance_faults") for row in good)),
        "tracking_centre_m": pooled(moved, "tracking_centre_m", inside),
        "tracking_boundary_m": pooled(moved, "tracking_boundary_m", outside),
        "residual_sway_m": pooled(moved, "residual_sway_m", [1.0] * len(moved)),
        "command_rmse_m": pooled(good, "command_rmse_m", steps(good)),
        **_limits(rows),
        **{name: _middle(good, name) for name in LATENCY_COLUMNS},
        "feedback": next((x for row in rows if (x := row.get("feedback")) is not None), None),
        "reasons": reasons(rows),
    }


def _limits(rows: Sequence[Row]) -> dict[str, Any]:
    """Return how far the cases of a group, those that diverged included, kept the limits."""
    ran = [row for row in rows if row.get("steps") is not None]
    commands = steps(ran)
    least, largest = _known(ran, "tension_min_N"), _known(ran, "tension_max_N")
    fallen = [row for row in ran if row.get("fallbacks") is not None]
    limited = int(sum(_number(row, "limited") for row in ran))
    return {
        "tension_min_N": min(least, default=None),
        "tension_max_N": max(largest, default=None),
        **{name: max(_known(ran, name), default=None) for name in ROBOT_COLUMNS},
        **{name: _share(ran, name) for name in ("slack_share", "overload_share", "outside_share")},
        "slack_until_share": max(_known(ran, "slack_until_share"), default=None),
        "limited": limited,
        "limited_share": limited / sum(commands) if sum(commands) else None,
        "limited_by": _sorted_counts(ran, "limited_by"),
        "limited_first": _sorted_counts(ran, "limited_first"),
        "remarks": list(dict.fromkeys(str(row["remark"]) for row in ran if row.get("remark"))),
        "fallback_share": sum(_known(fallen, "fallbacks")) / sum(steps(fallen)) if fallen else None,
        "fallbacks_by": _sorted_counts(ran, "fallbacks_by"),
    }


def _sorted_counts(rows: Sequence[Row], name: str) -> dict[str, int]:
    """Return the sums of counts that a column holds as JSON, largest first."""
    counts: dict[str, int] = {}
    for row in rows:
        for key, number in json.loads(str(row.get(name) or "{}")).items():
            counts[key] = counts.get(key, 0) + int(number)
    return dict(sorted(counts.items(), key=lambda pair: -pair[1]))


def _share(rows: Sequence[Row], name: str) -> float | None:
    """Return a share of the time of all cases, None if no row has it."""
    pairs = [(float(value), w) for row, w in zip(rows, steps(rows), strict=True)
             if (value := row.get(name)) is not None]  # fmt: skip
    total = sum(w for _, w in pairs)
    return sum(value * w for value, w in pairs) / total if total else None


def _known(rows: Sequence[Row], name: str) -> list[float]:
    """Return the values of a column that rows have."""
    return [float(value) for row in rows if (value := row.get(name)) is not None]


def _per_axis(rows: Sequence[Row], what: str) -> dict[str, float | None]:
    """Return the pooled error per axis and in norm [m]."""
    return {axis: pooled(rows, f"{what}_rmse_{axis}_m", steps(rows)) for axis in AXIS_NAMES}


def _mean(rows: Sequence[Row], name: str) -> float | None:
    """Return the mean of a column, None if no row has it."""
    known = _known(rows, name)
    return float(np.mean(known)) if known else None


def _middle(rows: Sequence[Row], name: str) -> float | None:
    """Return the median of a column, None if no row has it."""
    known = _known(rows, name)
    return float(np.median(known)) if known else None


def _normalised(rows: Sequence[Row], name: str, dof: float | None) -> dict[str, Any] | None:
    """Return the mean of normalised squares over cases, with the 95 % band of such means."""
    mean, seeds = _mean(rows, name), len({x["seed"] for x in rows if x.get(name) is not None})
    if mean is None or dof is None:
        return None
    return {"mean": mean, "band": list(band(dof, seeds)), "seeds": seeds}


def _number(row: Row, name: str) -> float:
    """Return a number of a row; 0 if it has none."""
    value = row.get(name)
    return float(value) if isinstance(value, int | float) else 0.0
