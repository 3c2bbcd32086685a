"""Agreement of two runs of a reference suite, on two machines or at two times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from carosac_toolkit.studies.compare.paired import ERROR_COLUMNS
from carosac_toolkit.studies.compare.pairs import typical_value
from carosac_toolkit.studies.run.rows import Row

MACHINE_DIFFERENCE_RATIO = 0.05  # of a typical error, by which two machines may differ
MISSING_STATUS = "not there"  # instead of a status
DIFFERENCE_MIN_M = 1e-3  # [m]: smaller differences are none

Way = tuple[str, str, str, str]  # part, robot, controller, estimator


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Typical error in two runs.

    Attributes:
        way: Part, robot, controller and estimator.
        error: Name of the error.
        here: In the new run [m]; None where there is none.
        there: In the other one [m].
    """

    way: Way
    error: str
    here: float | None
    there: float | None

    @property
    def agrees(self) -> bool:
        """True if they differ by at most `MACHINE_DIFFERENCE_RATIO`, or `DIFFERENCE_MIN_M`."""
        if self.here is None or self.there is None:
            return self.here is self.there
        return abs(self.here - self.there) <= max(
            DIFFERENCE_MIN_M, MACHINE_DIFFERENCE_RATIO * abs(self.there)
        )

    def sentence(self) -> str:
        """Difference as a sentence."""
        part, robot, controller, estimator = self.way
        here, there = (
            "none" if x is None else f"{1e3 * x:.1f} mm" for x in (self.here, self.there)
        )
        return (
            f"{part}, {robot}, {controller} with {estimator}: {self.error.replace('_', ' ')} "
            f"{here}, published {there}"
        )


@dataclass(frozen=True, kw_only=True)
class SuiteAgreement:
    """Agreement of two runs.

    Attributes:
        differences: All typical errors of ways that both have, also equal ones.
        failures: Cases that failed, or are there, in one of the two only, as sentences.
        missing: Ways that are in the other run only.
    """

    differences: tuple[Difference, ...]
    failures: tuple[str, ...]
    missing: tuple[Way, ...]

    @property
    def faults(self) -> list[str]:
        """Disagreements as sentences; empty if there are none."""
        return [one.sentence() for one in self.differences if not one.agrees] + list(self.failures)

    @property
    def largest(self) -> float:
        """Largest relative difference of two errors that both have."""
        shares = [
            abs(one.here - one.there) / abs(one.there)
            for one in self.differences
            if one.here is not None and one.there
        ]
        return max(shares, default=0.0)


def agreement(rows: Sequence[Row], others: Sequence[Row]) -> SuiteAgreement:
    """Compare rows, each with its ``part``, of a new run with those of another one."""
    here, there = _by_way(rows), _by_way(others)
    shared = [way for way in there if way in here]
    return SuiteAgreement(
        differences=tuple(
            Difference(way=way, error=name, here=typical_value(here[way], column),
                       there=typical_value(there[way], column))
            for way in shared for name, column in ERROR_COLUMNS.items()
        ),
        failures=tuple(
            f"{way[0]}, {way[1]}, {way[2]} with {way[3]}: {path}, seed {seed}: {one}, published "
            f"{other}"
            for way in shared
            for (path, seed), one, other in _statuses(here[way], there[way])
            if (one == "ok", one == MISSING_STATUS) != (other == "ok", other == MISSING_STATUS)
        ),
        missing=tuple(way for way in there if way not in here),
    )  # fmt: skip


def _by_way(rows: Sequence[Row]) -> dict[Way, list[Row]]:
    """Return the rows of each part, robot, controller and estimator."""
    by_way: dict[Way, list[Row]] = {}
    for row in rows:
        part, robot, controller, estimator = (
            str(row[name]) for name in ("part", "robot", "controller", "estimator")
        )
        by_way.setdefault((part, robot, controller, estimator), []).append(row)
    return by_way


def _statuses(rows: Sequence[Row], others: Sequence[Row]) -> list[tuple[tuple[str, int], str, str]]:
    """Return sentences on cases that ended differently in the two runs."""
    one, other = (
        {(str(r["trajectory"]), int(r["seed"] or 0)): str(r["status"]) for r in group}
        for group in (rows, others)
    )
    return [
        (key, one.get(key, MISSING_STATUS), other.get(key, MISSING_STATUS))
        for key in {**other, **one}
    ]
