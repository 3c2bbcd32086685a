"""Judgement, in words, of what data can tell about parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError

BLIND_EIGENVALUE_SHARE = (
    1e-9  # of the largest eigenvalue of the scaled information: smaller ones may be none
)
ROUNDING_EIGENVALUE_SHARE = 1e-14  # of the largest one: smaller ones are none
WEAK_VARIANCE_SHARE = (
    0.5  # share of its prior variance that a combination of parameters keeps: the rest is data
)
NAMED_ENTRY_SHARE = 0.35  # of the largest entry of a combination: smaller entries are not named
NAMED_PARAMETERS_MAX = 4  # parameters of a combination that are named
NAMED_COMBINATIONS_MAX = 6  # combinations of a kind that are named


class Unobservable(CarosacError):
    """The data cannot determine what was asked of them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Observability:
    """Information of the data alone on k parameters, each measured in its own scale.

    Attributes:
        parameters: k.
        rank: Combinations that the data say something about.
        condition: Largest over smallest singular value of the scaled Jacobian, the square root of
            that of the information; infinite where the rank is below k.
        blind: Combinations that the data say nothing about, in words.
        weak: Combinations that are known from before rather than from the data, in words, the
            least known one first.
    """

    parameters: int
    rank: int
    condition: float
    blind: tuple[str, ...]
    weak: tuple[str, ...]

    def sentences(self) -> list[str]:
        """Return what people should know before they trust the numbers."""
        return [
            f"the data say something of {self.rank} of {self.parameters} combinations of the "
            f"parameters, and more than was known before of {self.rank - len(self.weak)}"
            + (f", condition {self.condition:.3g}" if np.isfinite(self.condition) else ""),
            *_some("the data say nothing about", self.blind),
            *_some("known from before rather than from the data:", self.weak),
        ]

    def data(self) -> dict[str, Any]:
        """Return all numbers, ready for JSON."""
        return {
            "parameters": self.parameters,
            "rank": self.rank,
            "condition": self.condition,
            "blind": list(self.blind),
            "weak": list(self.weak),
        }


def judge(names: Sequence[str], information: Array, scale: Array) -> Observability:
    """Judge what data say about parameters.

    Args:
        names: k parameters.
        information: Fisher information of the data alone, without priors, shape (k, k).
        scale: What counts as one of each parameter: its prior sigma, or what it may plausibly
            change by, shape (k,).

    Returns:
        Rank, condition and the combinations that are not, or hardly, determined. A combination is
        weak where it keeps more than half of the variance that `scale` gives it, and blind where,
        beyond that, nothing is left of it beside the best known one.
    """
    scaled = information * np.outer(scale, scale)
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    most = max(float(values[-1]), np.finfo(float).tiny)
    blind = values <= min(BLIND_EIGENVALUE_SHARE * most, max(1.0, ROUNDING_EIGENVALUE_SHARE * most))
    weak = ~blind & (1.0 / (1.0 + np.maximum(values, 0.0)) > WEAK_VARIANCE_SHARE)
    full = not blind.any()
    return Observability(
        parameters=len(names),
        rank=int((~blind).sum()),
        condition=float(np.sqrt(most / values[0])) if full else np.inf,
        blind=tuple(_words(names, vectors[:, i]) for i in np.flatnonzero(blind)),
        weak=tuple(_words(names, vectors[:, i]) for i in np.flatnonzero(weak)),
    )


def _some(start: str, combinations: Sequence[str]) -> list[str]:
    """Name the first combinations in sentences, and count the others."""
    lines = [f"{start} {words}" for words in combinations[:NAMED_COMBINATIONS_MAX]]
    if len(combinations) > NAMED_COMBINATIONS_MAX:
        lines[-1] += f"; and {len(combinations) - NAMED_COMBINATIONS_MAX} more such combinations"
    return lines


def _words(names: Sequence[str], direction: Array) -> str:
    """Name a combination of parameters, largest part first."""
    order = np.argsort(-np.abs(direction))
    chosen = [i for i in order if abs(direction[i]) >= NAMED_ENTRY_SHARE * abs(direction[order[0]])]
    sign = np.sign(direction[order[0]])
    parts = [
        f"{'' if k == 0 else ' + ' if sign * direction[i] > 0 else ' - '}{names[i]}"
        for k, i in enumerate(chosen[:NAMED_PARAMETERS_MAX])
    ]
    more = (
        f" and {len(chosen) - NAMED_PARAMETERS_MAX} more"
        if len(chosen) > NAMED_PARAMETERS_MAX
        else ""
    )
    return "".join(parts) + more
