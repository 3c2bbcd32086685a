"""Groups of a study as series to draw: their rows, labels and looks, and names of robots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.base.tables import counted
from carosac_toolkit.pictures.style import (
    CONTROLLER_NUMBERS,
    MODEL_NUMBERS,
    SERIES_COLORS,
    Series,
    looks_by_name,
)
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
        look: Look of the series, by its controller or estimator.
    """

    label: str
    rows: Sequence[Row]
    number: int
    look: Series

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
    looks = looks_of_ways([rows[0] for _, rows in shown], alone)
    return [
        Group(label=label, rows=rows, number=k, look=look)
        for k, ((label, rows), look) in enumerate(zip(shown, looks, strict=True))
    ]


def looks_of_ways(ways: Sequence[Mapping[str, object]], usual: str = "controller") -> list[Series]:
    """Return the looks of groups by the names of their controllers or of their estimators.

    Args:
        ways: Controller and estimator of each group.
        usual: What tells them apart, unless all have one controller but several estimators.
    """
    several = {name for name in ("controller", "estimator") if len({x[name] for x in ways}) > 1}
    name = "estimator" if several == {"estimator"} else usual
    numbers = CONTROLLER_NUMBERS if name == "controller" else MODEL_NUMBERS
    return looks_by_name([str(x[name]) for x in ways], numbers)


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


def colors_of(groups: Sequence[Group]) -> Mapping[float, str]:
    """Return the colours of groups by their places."""
    return {group.number: group.look.color for group in groups}


def looks_of(groups: Sequence[Group]) -> Mapping[str, Series]:
    """Return the looks of groups for a legend."""
    return {group.legend: group.look for group in groups}
