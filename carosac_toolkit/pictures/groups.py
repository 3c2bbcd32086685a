"""Groups of a study as series to draw: their rows, labels and looks, and names of robots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.base.tables import counted
from carosac_toolkit.pictures.style import SERIES_COLORS, Series, series
from carosac_toolkit.studies.compare.names import robot_names, short_name
from carosac_toolkit.studies.compare.results import GROUP_COLUMNS, StudyResults, labels_by
from carosac_toolkit.studies.run.robot_copies import robot_of_row
from carosac_toolkit.studies.run.rows import Row

GROUPS_MAX = len(SERIES_COLORS)  # groups that can be told apart
ESTIMATOR_COLUMNS = ("robot", "estimator", "sensors", "perturbation")


@dataclass(frozen=True, kw_only=True)
class Group:
    """Rows of a study that are drawn as one series.

    Attributes:
        label: Short name, distinct from those of the other groups.
        rows: One per case.
        number: Place among the groups, from 0.
    """

    label: str
    rows: Sequence[Row]
    number: int

    @property
    def look(self) -> Series:
        """Look of the series; it does not depend on what other groups did."""
        return series(self.number)

    @property
    def legend(self) -> str:
        """Label, and how many of the cases diverged or failed."""
        lost = {
            word: sum(row["status"] in statuses for row in self.rows)
            for word, statuses in (
                ("diverged", ("diverged",)),
                ("failed", ("failed", "crashed", "timed_out")),
            )
        }
        notes = [f"{k} of {len(self.rows)} {word}" for word, k in lost.items() if k]
        return f"{self.label} ({', '.join(notes)})" if notes else self.label


def groups_of(results: StudyResults) -> list[Group]:
    """Return the first groups of a study, as in its table: as many as can be told apart."""
    return _grouped(results, results.groups, GROUP_COLUMNS, "controller")


def estimator_groups(results: StudyResults) -> list[Group]:
    """Return the first groups of a study by estimator, each over all controllers."""
    by_estimator: dict[tuple[str, ...], list[Row]] = {}
    for row in results.rows:
        key = tuple(str(row[name]) for name in ESTIMATOR_COLUMNS)
        by_estimator.setdefault(key, []).append(row)
    return _grouped(results, list(by_estimator.values()), ESTIMATOR_COLUMNS, "estimator")


def _grouped(
    results: StudyResults, groups: Sequence[Sequence[Row]], columns: Sequence[str], alone: str
) -> list[Group]:
    """Name groups by those columns that they do not share; by the column `alone` without any."""
    names = robot_names(results)
    lines = [
        {name: short_name(str(rows[0][name])) for name in columns}
        | {"robot": names[str(rows[0]["robot"])], "controller": short_name(str(rows[0][alone]))}
        for rows in groups
    ]
    labels = labels_by(columns, lines)
    if len(set(labels)) < len(labels):  # two classes of one name in different modules
        labels = labels_by(columns, [rows[0] for rows in groups])
    shown = list(zip(labels, groups, strict=True))[:GROUPS_MAX]
    return [Group(label=label, rows=rows, number=k) for k, (label, rows) in enumerate(shown)]


def left_out(results: StudyResults) -> str:
    """Note that some groups are not shown; empty if all are."""
    count = len(results.groups)
    return f"the first {GROUPS_MAX} of {count} rows of the table" if count > GROUPS_MAX else ""


def robots_title(results: StudyResults) -> str:
    """Return the names of all robots of a study, for a title."""
    names = list(robot_names(results).values())
    return ", ".join(names) if len(names) <= 3 else counted(len(names), "robot")


def cable_names(results: StudyResults, count: int) -> list[str]:
    """Return the names of the cables, or numbers where robots of a study differ in them."""
    named = set()
    for row in {str(row["robot"]): row for row in results.rows}.values():
        try:
            named.add(robot_of_row(results.folder, row).cable_names)
        except CarosacError:
            continue
    if len(named) == 1 and len(names := list(named.pop())) == count:
        return names
    return [f"cable {k + 1}" for k in range(count)]


def looks_of(groups: Sequence[Group]) -> Mapping[str, Series]:
    """Return the looks of groups for a legend."""
    return {group.legend: group.look for group in groups}
