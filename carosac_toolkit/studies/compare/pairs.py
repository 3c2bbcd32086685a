"""Two groups on the same draws: paired differences, and the cases that each won."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.studies.compare.resampling import interval, sign_flip_p, typical
from carosac_toolkit.studies.compare.results import PAIR_COLUMNS
from carosac_toolkit.studies.run.rows import Row


@dataclass(frozen=True, kw_only=True)
class IntervalEstimate:
    """Number and its 95 % interval.

    Attributes:
        value: The number.
        low: Lower end; None where there are too few seeds for an interval.
        high: Upper end, likewise.
    """

    value: float
    low: float | None = None
    high: float | None = None

    def excludes(self, value: float) -> bool:
        """Return whether a value lies outside the interval, which must exist."""
        return self.low is not None and self.high is not None and not self.low <= value <= self.high

    def data(self) -> dict[str, float | None]:
        """Return all numbers, for JSON; None where a number is not finite."""
        return {
            name: x if x is not None and np.isfinite(x) else None for name, x in vars(self).items()
        }


@dataclass(frozen=True, kw_only=True)
class Pair:
    """Error of A against that of B, over the cases that both were asked to run.

    Differences and typical errors are over the cases in which both have the error. Won, lost and
    the p of them count failures: who fails where the other does not has lost the case, and where
    both fail, nobody has won.

    Attributes:
        cases: Cases of both, without those in which this error means nothing.
        scored: Number of these in which both have the error.
        seeds: Different seeds of these cases.
        failed: Cases without a score of A and of B.
        won: Cases in which the error of A is smaller, or B alone failed.
        lost: The other way round; all else is neither.
        typical: Typical error of A, of B, over the scored cases; see `typical`.
        difference: Typical paired difference, A minus B: negative is in favour of A.
        ratio: Typical error of A over that of B; None where that of B is zero.
        p: Two-sided, of won and lost, permutation test over seeds; None without a case.
        p_holm: The same for as many comparisons as stand together; None before that is known.
    """

    cases: int
    scored: int
    seeds: int
    failed: tuple[int, int]
    won: int
    lost: int
    typical: tuple[float, float] | None
    difference: IntervalEstimate | None
    ratio: IntervalEstimate | None
    p: float | None
    p_holm: float | None = None

    @property
    def share_won(self) -> float:
        """Share of all cases that A won."""
        return self.won / self.cases if self.cases else float("nan")

    def adjusted(self, p: float | None) -> Pair:
        """Return the same with its p among others."""
        return replace(self, p_holm=p)

    def data(self) -> dict[str, Any]:
        """Return all numbers, for JSON; None where a number is not finite."""
        return {
            "cases": self.cases,
            "scored": self.scored,
            "seeds": self.seeds,
            "failures": self.failed[0],
            "baseline_failures": self.failed[1],
            "won": self.won,
            "lost": self.lost,
            "share_won": self.share_won if self.cases else None,
            "typical": self.typical[0] if self.typical else None,
            "baseline_typical": self.typical[1] if self.typical else None,
            "difference": self.difference.data() if self.difference else None,
            "ratio": self.ratio.data() if self.ratio else None,
            "p": self.p,
            "p_holm": self.p_holm,
        }


def compare(rows: Sequence[Row], others: Sequence[Row], column: str) -> Pair:
    """Compare one error over the cases of two groups.

    A case of a group belongs to the case of the other one with the same trajectory and seed. Cases
    that succeeded without this error are left out, such as paths that never come near the boundary.

    Args:
        rows: Rows of A, on one robot and condition.
        others: Rows of B, on the same.
        column: Name of the error, which is smaller for the better one.
    """
    mine, theirs = errors_by_case(rows, column), errors_by_case(others, column)
    shared = [key for key in mine if key in theirs]
    a, b = (_table(shared, [errors[key] for key in shared]) for errors in (mine, theirs))
    failed = (int(np.isinf(a).sum()), int(np.isinf(b).sum()))
    outcomes = np.where(a == b, 0.0, np.sign(np.where(a == b, 0.0, b) - np.where(a == b, 0.0, a)))
    both = np.isfinite(a) & np.isfinite(b)
    a, b = np.where(both, a, np.nan), np.where(both, b, np.nan)
    middle = (_typical(a), _typical(b)) if both.any() else None
    return Pair(
        cases=len(shared),
        scored=int(both.sum()),
        seeds=len({seed for _, seed in shared}),
        failed=failed,
        won=int((outcomes > 0).sum()),
        lost=int((outcomes < 0).sum()),
        typical=middle,
        difference=estimate(a - b) if middle else None,
        ratio=_ratio(a, b) if middle and middle[1] != 0.0 else None,
        p=sign_flip_p(outcomes) if shared else None,
    )


def typical_of(rows: Sequence[Row], column: str) -> IntervalEstimate | None:
    """Return the typical error over the cases of a group that have it, with its interval."""
    errors = {key: x for key, x in errors_by_case(rows, column).items() if np.isfinite(x)}
    return estimate(_table(list(errors), list(errors.values()))) if errors else None


def typical_value(rows: Sequence[Row], column: str) -> float | None:
    """Return the typical error over the cases of a group that have it, without an interval."""
    errors = {key: x for key, x in errors_by_case(rows, column).items() if np.isfinite(x)}
    return _typical(_table(list(errors), list(errors.values()))) if errors else None


def estimate(table: Array) -> IntervalEstimate:
    """Return the typical value of a table (S, T), one row per seed, NaN where there is no case."""
    ends = interval(typical, table)
    return IntervalEstimate(
        value=_typical(table), low=ends[0] if ends else None, high=ends[1] if ends else None
    )


def _typical(table: Array) -> float:
    return float(typical(table[None])[0])


def errors_by_case(rows: Sequence[Row], column: str) -> dict[tuple[str, int], float]:
    """Return an error by trajectory and seed: infinite for a failed case, absent without one."""
    errors: dict[tuple[str, int], float] = {}
    for row in rows:
        trajectory, seed = (row[name] for name in PAIR_COLUMNS)
        value = row.get(column) if row["status"] == "ok" else np.inf
        if value is not None:
            errors[str(trajectory), int(seed or 0)] = float(value)
    return errors


def _ratio(a: Array, b: Array) -> IntervalEstimate:
    """Return the ratio of the typical values of two tables with the same gaps."""

    def ratio(one: Array, other: Array) -> Array:
        with np.errstate(divide="ignore"):
            ratios: Array = typical(one) / typical(other)
        return ratios

    ends = interval(ratio, a, b)
    value = _typical(a) / _typical(b)
    return IntervalEstimate(
        value=value, low=ends[0] if ends else None, high=ends[1] if ends else None
    )


def _table(keys: Sequence[tuple[str, int]], values: Sequence[float]) -> Array:
    """Return values by seed and trajectory, shape (S, T), NaN where there is none."""
    seeds = {seed: k for k, seed in enumerate(dict.fromkeys(seed for _, seed in keys))}
    paths = {name: k for k, name in enumerate(dict.fromkeys(name for name, _ in keys))}
    table = np.full((len(seeds), len(paths)), np.nan)
    for (name, seed), value in zip(keys, values, strict=True):
        table[seeds[seed], paths[name]] = value
    return table
