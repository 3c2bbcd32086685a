"""Parameters that are kept only where they predict what was not fitted.

A fit with more parameters is always nearer to what was fitted. What tells whether they are of the
robot is data that were held out: recordings, or stretches of one of them. Near the estimate the
cost of each is a parabola, so that the fit without it, and without some of the parameters, follows
from one fit with all of them; held-out recordings are judged with a start of their own, as always.

Parameters are kept one after another, the best first, as long as squared errors of
what is held out fall by more than their standard error (the rule of one standard error). If a fit
without the others predicts worse than that of all, by as much, all are kept.

References:
    Hastie, Tibshirani and Friedman, *The Elements of Statistical Learning*, 2nd ed., 2009, 7.10.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.identification.doubts import Judge
from calibration.identification.quadratic import Quadratic
from carosac_toolkit.base.arrays import Array

UNDECIDED_GAIN_MIN = 0.1  # of squared errors: a parameter that brings it may be of the robot


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """What parameters bring that are kept only where they predict.

    Attributes:
        name: Of the setting that frees them.
        kept: True if they are.
        gain: Share by which squared errors of what is held out fall with them.
        error: Standard error of it.
        together: True if that is of all candidates together, none of which could be left.
    """

    name: str
    kept: bool
    gain: float
    error: float
    together: bool = False

    @property
    def words(self) -> str:
        """What it says, for people."""
        verdict = "kept" if self.kept else "left as in the robot file"
        if not self.kept and self.gain >= UNDECIDED_GAIN_MIN:
            verdict = "undecided, as few parts tell most, and left as in the robot file"
        if self.together:
            verdict = "kept, as a fit without those to be left predicts worse than with all"
        way = "smaller" if self.gain >= 0.0 else "larger"
        share, error = 100.0 * abs(self.gain), 100.0 * self.error
        return f"{self.name} {verdict}: {share:.2g} % {way}, give or take {error:.2g} %"

    def data(self) -> dict[str, Any]:
        """Return all numbers, ready for JSON."""
        return {
            "kept": self.kept, "gain": self.gain, "gain_sigma": self.error,
            "together": self.together,
        }  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class Folds:
    """Parts of the data about an estimate of p coordinates, all of them free.

    Attributes:
        parts: Costs of at least two, of a change from the estimate.
        known: Of what is known beside the data.
        at: The estimate, shape (p,).
        lower: Bounds of the coordinates, shape (p,).
        judge: By which errors of all parts count.
        places: Which part each is, of all that there are.
    """

    parts: Sequence[Quadratic]
    known: Quadratic
    at: Array
    lower: Array
    judge: Judge
    places: tuple[int, ...]

    def held_out(self, held: NDArray[np.bool_]) -> Array:
        """Return the cost of each part after a fit to all others.

        Args:
            held: Coordinates that are held at 0, shape (p,).
        """
        information = self.known.information + sum(part.information for part in self.parts)
        gradient = self.known.gradient + sum(part.gradient for part in self.parts)
        free, change = ~held, np.where(held, -self.at, 0.0)
        room = np.minimum(self.lower - self.at, 0.0)[free]
        costs = []
        for part in self.parts:
            others = (information - part.information)[free]
            pull = (gradient - part.gradient)[free] + others @ np.where(free, 0.0, change)
            rest = Quadratic(cost=0.0, gradient=pull, information=others[:, free])
            change[free] = rest.least_within(room)
            costs.append(part.at(change))
        return np.array(costs)

    def only(self, places: Set[int]) -> Folds:
        """Return some of the parts; the others are neither fitted nor held out."""
        some = [k for k, place in enumerate(self.places) if place in places]
        return replace(
            self,
            parts=[self.parts[k] for k in some],
            places=tuple(self.places[k] for k in some),
        )

    def verified(self, without: Folds, judged: Sequence[Candidate]) -> tuple[Candidate, ...]:
        """Keep all candidates if a fit without those that were to be held predicts worse.

        A fit without them may be a long way off, and the cost no parabola there.

        Args:
            without: Of the fit without them, by the judge of these.
            judged: What was chosen.
        """
        both = set(self.places) & set(without.places)
        with_them, without_them = (
            each.only(both).held_out(np.zeros(len(each.at), np.bool_)) for each in (self, without)
        )
        gains = without_them - with_them
        error = float(np.sqrt(len(gains)) * gains.std(ddof=1))
        if gains.sum() <= error:
            return tuple(judged)
        total = float(without_them.sum())
        gain = float(gains.sum())  # of all of them together
        return tuple(
            one
            if one.kept
            else replace(one, kept=True, gain=gain / total, error=error / total, together=True)
            for one in judged
        )

    def choose(self, groups: Mapping[str, NDArray[np.bool_]]) -> tuple[Candidate, ...]:
        """Choose among parameters.

        Args:
            groups: Coordinates of each by its name, shape (p,).
        """
        left = dict(groups)
        nothing = np.zeros(len(self.at), dtype=np.bool_)
        judged: list[Candidate] = []

        def costs(names: Mapping[str, NDArray[np.bool_]]) -> Array:
            return self.held_out(np.logical_or.reduce([nothing, *names.values()]))

        while left:
            without = costs(left)
            trials = []
            for name in left:
                gains = without - costs({k: v for k, v in left.items() if k != name})
                error = float(np.sqrt(len(gains)) * gains.std(ddof=1))
                trials.append((float(gains.sum()), error, name))
            kept = [trial for trial in trials if trial[0] > trial[1]]
            total = float(without.sum())
            for gain, error, name in [max(kept)] if kept else sorted(trials, reverse=True):
                one = Candidate(
                    name=name, kept=bool(kept), gain=gain / total, error=error / total
                )  # fmt: skip
                judged.append(one)
                del left[name]
        return tuple(judged)
