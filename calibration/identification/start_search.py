"""Search for the starts of recordings alone, beside a robot."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from calibration.identification.fit_cost import FitCost
from calibration.identification.run_errors import RunErrors
from calibration.identification.search_space import SearchSpace
from calibration.identification.search_state import SETTLED_DECREASE
from calibration.identification.step_search import START_TRIES, StepSearch
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError

# Tries as of `StepSearch.restarted`, from first guesses that may be far off.
GUESS_TRIES = (*START_TRIES, (1.0, 1.0), (1.0, 10.0))
# Growths of the first guess of a start from which one is sought, and the best is taken: friction
# takes away what a mode swung by before its first pose. 2.5 leads where 1.5 does.
GUESS_GROWTHS = (1.0, 1.5)
STARTS_STEPS_MAX = 8  # of the starts alone, before the robot is searched


class StartSearch:
    """Lets recordings start as suits a robot."""

    def __init__(
        self, space: SearchSpace, run_errors: RunErrors, cost: FitCost, steps: StepSearch
    ) -> None:
        """Take what is searched, what it misses, what that costs, and how steps are searched."""
        self._space = space
        self._run_errors = run_errors
        self._cost = cost
        self._steps = steps

    def begin(self, at: Array, shares: Sequence[float]) -> Array:
        """Return where a search begins; each run that starts before its poses does as suits it.

        The first guess of such a start is rough: the first poses mend it, and one that swings
        further, before all is searched. Beside a robot that is nearly found, more of them do.

        Args:
            at: All coordinates.
            shares: Of the poses, one after the other.
        """
        if not self._run_errors.sways:
            return at
        robot, starts = np.split(at, [self._space.count])
        guesses = [np.concatenate([robot, growth * starts]) for growth in GUESS_GROWTHS]
        for share in shares:
            self._run_errors.look_at(share)
            ends = [self._suited(guesses[0])]
            for further in guesses[1:]:
                with suppress(CarosacError):  # one that swings so far may have no finite motion
                    ends.append(self._suited(further))
            at = self._likeliest(ends)
            guesses = [at]
        self._run_errors.look_at_all()
        return at

    def _likeliest(self, ends: Sequence[Array]) -> Array:
        """Return all coordinates, with that start of each run which suits it best of some."""
        best = ends[0].copy()
        if len(ends) == 1:
            return best
        errors = [self._run_errors.at(end) for end in ends]
        noise = self._cost.noise(errors[0])
        for k in range(len(self._space.own)):
            costs = [
                self._cost.with_start(k, end, each[k], noise)
                for end, each in zip(ends, errors, strict=True)
            ]
            own = self._space.start_of(k)
            best[own] = ends[int(np.argmin(costs))][own]
        return best

    def _suited(self, at: Array) -> Array:
        """Let runs start as suits the robot."""
        least = SETTLED_DECREASE * (len(at) - self._space.count)
        errors = self._run_errors.at(at)
        for _ in range(STARTS_STEPS_MAX):
            noise = self._cost.noise(errors)
            before = self._cost.total(at, errors, noise)
            at, errors = self._steps.restarted(at, errors, noise, GUESS_TRIES)
            if before - self._cost.total(at, errors, noise) <= least:
                break
        return at
