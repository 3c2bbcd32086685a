"""Paired comparisons of a study with a baseline, for each robot, condition and error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.studies.compare.names import robot_names
from carosac_toolkit.studies.compare.pairs import IntervalEstimate, Pair, compare, typical_of
from carosac_toolkit.studies.compare.resampling import holm
from carosac_toolkit.studies.compare.results import COMPARED_COLUMNS, StudyResults, labels_by
from carosac_toolkit.studies.run.rows import LATENCY_COLUMNS, Row

BLOCK_COLUMNS = ("robot", "perturbation")  # groups that met the same plants
SIGNIFICANCE_LEVEL = 0.05  # of a difference that counts

ERROR_COLUMNS = {  # column of the rows by name
    "tracking": "tracking_rmse_norm_m",
    "tracking_centre": "tracking_centre_m",
    "tracking_boundary": "tracking_boundary_m",
    "residual_sway": "residual_sway_m",
    "estimation": "estimation_rmse_norm_m",
}


@dataclass(frozen=True, kw_only=True)
class Compared:
    """Group of a study beside the baseline, by its errors.

    Attributes:
        label: Label that distinguishes it from the others.
        names: Controller, estimator and sensors.
        cases: Number of cases run.
        failures: Number of these without a score.
        typical: Typical value of each error over the cases [m].
        pairs: Against the baseline; empty for the baseline itself.
        best: Errors in which it is better than each of the others, beyond doubt.
        latency: Medians over the cases of median, 95th and 99th percentile [s].
    """

    label: str
    names: Mapping[str, str]
    cases: int
    failures: int
    typical: Mapping[str, IntervalEstimate]
    pairs: Mapping[str, Pair]
    best: frozenset[str]
    latency: Mapping[str, float | None]

    def data(self) -> dict[str, Any]:
        """Return all numbers, for JSON."""
        return {
            "label": self.label,
            **self.names,
            "cases": self.cases,
            "failures": self.failures,
            "typical_m": {name: one.data() for name, one in self.typical.items()},
            "against_baseline": {name: pair.data() for name, pair in self.pairs.items()},
            "best_in": sorted(self.best),
            **self.latency,
        }


@dataclass(frozen=True, kw_only=True)
class PairedBlock:
    """Comparisons on one robot and in one condition.

    Attributes:
        robot: Its name or path in the rows.
        robot_name: Its own name.
        perturbation: The condition that its plants are drawn from.
        baseline: Label of what the others are compared with.
        seeds: Independent draws.
        trajectories: Number of trajectories of each seed.
        final_rest: Time after the trajectory over which sway is taken [s]; None: not recorded.
        compared: In the order of the study.
    """

    robot: str
    robot_name: str
    perturbation: str
    baseline: str
    seeds: int
    trajectories: int
    final_rest: float | None
    compared: tuple[Compared, ...]

    def data(self) -> dict[str, Any]:
        """Return all numbers, for JSON."""
        numbers = vars(self) | {"compared": [one.data() for one in self.compared]}
        numbers["final_rest_s"] = numbers.pop("final_rest")
        return numbers


def paired_blocks(results: StudyResults, baseline: str | None = None) -> list[PairedBlock]:
    """Compare every group with the baseline of its robot and condition.

    Args:
        results: Results of the study.
        baseline: Label as `labels_by` gives for `COMPARED_COLUMNS`; by default the first
            group of each block.

    Raises:
        InvalidField: There is no such group.
    """
    labels = results.labels_of(COMPARED_COLUMNS)
    if baseline is not None:
        check_baseline(baseline, labels)
    members: dict[tuple[str, ...], list[int]] = {}
    for k, line in enumerate(results.summary):
        members.setdefault(tuple(line[name] for name in BLOCK_COLUMNS), []).append(k)
    return [_block(results, group, labels, baseline) for group in members.values()]


def check_baseline(baseline: str, labels: Sequence[str]) -> None:
    """Refuse a baseline that is not a group.

    Raises:
        InvalidField: There is no such group.
    """
    if baseline not in labels:
        raise InvalidField("baseline", repr(baseline), f"one of {list(dict.fromkeys(labels))}")


def ways_of(
    controllers: Sequence[str], estimators: Sequence[str], sensors: Sequence[str]
) -> list[str]:
    """Return the labels that the groups of a study will have."""
    lines = [
        dict(zip(COMPARED_COLUMNS, (c, e, s), strict=True))
        for c in controllers for e in estimators for s in sensors
    ]  # fmt: skip
    return labels_by(COMPARED_COLUMNS, lines)


def _block(
    results: StudyResults, members: Sequence[int], labels: Sequence[str], baseline: str | None
) -> PairedBlock:
    """Compare the groups of one robot and condition."""
    base = next((k for k in members if labels[k] == baseline), members[0])
    rows = {k: results.groups[k] for k in members}
    typical = {
        name: {k: one for k in members if (one := typical_of(rows[k], column))}
        for name, column in ERROR_COLUMNS.items()
    }
    errors = [name for name, by_label in typical.items() if by_label]
    pairs = {name: _against(rows, base, ERROR_COLUMNS[name]) for name in errors}
    best = {name: _best(rows, ERROR_COLUMNS[name], typical[name]) for name in errors}
    compared = []
    for k in members:
        line = results.summary[k]
        compared.append(
            Compared(
                label=labels[k],
                names={name: str(line[name]) for name in COMPARED_COLUMNS},
                cases=line["cases"],
                failures=line["failures"],
                typical={name: typical[name][k] for name in errors if k in typical[name]},
                pairs={name: pairs[name][k] for name in errors if k != base},
                best=frozenset(name for name in errors if best[name] == k),
                latency={name: line[name] for name in LATENCY_COLUMNS},
            )
        )
    first = rows[base]
    return PairedBlock(
        robot=str(first[0]["robot"]),
        robot_name=robot_names(results)[str(first[0]["robot"])],
        perturbation=str(first[0]["perturbation"]),
        baseline=labels[base],
        seeds=len({row["seed"] for row in first}),
        trajectories=len({row["trajectory"] for row in first}),
        final_rest=results.summary[base]["final_rest_s"],
        compared=tuple(compared),
    )


def _against(rows: Mapping[int, Sequence[Row]], base: int, column: str) -> dict[int, Pair]:
    """Compare all other groups with one, and adjust for their number."""
    pairs = {k: compare(group, rows[base], column) for k, group in rows.items() if k != base}
    adjusted = holm([pair.p for pair in pairs.values()])
    return {k: pairs[k].adjusted(p) for k, p in zip(pairs, adjusted, strict=True)}


def _best(
    rows: Mapping[int, Sequence[Row]], column: str, typical: Mapping[int, IntervalEstimate]
) -> int | None:
    """Return the group that is significantly better than all others, or None.

    The intervals of its differences to all others exclude zero, and no p of these comparisons,
    adjusted for their number, is above `SIGNIFICANCE_LEVEL`.
    """
    if len(typical) < 2:
        return None
    winner = min(typical, key=lambda k: typical[k].value)
    pairs = _against(rows, winner, column)
    sure = all(
        pair.difference is not None
        and pair.difference.value > 0.0
        and pair.difference.excludes(0.0)
        and pair.p_holm is not None
        and pair.p_holm <= SIGNIFICANCE_LEVEL
        for k, pair in pairs.items()
        if k in typical
    )
    return winner if sure else None
