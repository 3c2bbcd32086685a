"""The end of a search, where errors are linear functions over what is left of uncertainty.

Where cables vibrate as a platform sways, derivatives tell of ruggedness; see
`calibration.identification.linearization`. Steps then lead to where mean errors over what is
uncertain fit best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from calibration.identification.error_noise import RUNS_APART_MIN, PoseErrorNoise
from calibration.identification.fit_cost import FitCost
from calibration.identification.linearization import (
    Linearization,
    axes_of_robot,
    bent_coordinate,
    is_stale,
    scattered_moves,
)
from calibration.identification.run_errors import RunErrors
from calibration.identification.search_space import SearchSpace
from calibration.identification.search_state import ProgressCallback, Search
from calibration.identification.vibrations import HiddenVibrations
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError

# Squared sigmas by which a step must promise to lower the cost, for each coordinate of the robot.
# That step is taken, and is the last one.
AVERAGES_DECREASE = 0.05
# By which mean errors of a run over what is uncertain may cost more than those where a search
# stands, for each coordinate that is searched, of all of which a run has its share. Linear ones do
# not at all.
RISE_MAX = 3.0
FOLLOWED_SIGMAS = 1.0  # of a run's errors together, by which time steps may leave it


@dataclass(frozen=True, kw_only=True, eq=False)
class MeanErrors:
    """Errors of all runs over what is uncertain.

    Attributes:
        errors: Mean ones of each run, shape (K, 6).
        jacobians: Slopes by what each depends on, shape (K, 6, p).
        linear: The linear functions.
        rises: By how much mean errors of each run cost more than those where the search stands,
            shape (R,). Of motion that is linear both are the same.
    """

    errors: list[Array]
    jacobians: list[Array]
    linear: list[Linearization]
    rises: Array


class Averages:
    """Leads a search to its end."""

    def __init__(
        self, space: SearchSpace, run_errors: RunErrors, cost: FitCost, steps_max: int
    ) -> None:
        """Take what is searched, what it misses, what that costs, and the most steps together."""
        self._space = space
        self._run_errors = run_errors
        self._cost = cost
        self._steps_max = steps_max

    def leave_out_unfollowed(self, at: Array, errors: Sequence[Array]) -> None:
        """Leave out the runs that no time step follows.

        Strong vibrations move a sway too, and a little more or less of a parameter moves them
        altogether: what such a run seems to tell of the robot is chance. It shows in time steps:
        what two of them tell of vanishing ones differs from what two shorter ones do.

        Args:
            at: All coordinates.
            errors: Of each run there (K, 6).
        """
        off = self._run_errors.off_by_time_steps(at, self._cost.noise(errors).sigma)
        self._space.keep_only(off <= max(FOLLOWED_SIGMAS, float(np.median(off))))

    def search(
        self, at: Array, hessian: Array, count: int, report: ProgressCallback
    ) -> Search | None:
        """Search to the end by errors that are linear over what is left of uncertainty.

        None: most runs are far from linear over what is uncertain, and none is left out. Averages
        of robots fit far worse than the best one then, and lead away from it.

        Points that scatter otherwise let steps jump about the end. Each that turns the robot back
        against the one before makes later ones shorter (Kesten 1958), so that jumps average out:
        of what a whole step promises, about that share is left.

        Args:
            at: All coordinates, near to the end.
            hessian: Of the cost there, about.
            count: Steps until there.
            report: Called before each step.
        """
        space, cost = self._space, self._cost
        found, settled = None, False
        before = space.followed.copy(), space.searched.copy()
        while True:
            count, first = count + 1, found is None
            if found is None or is_stale(at - found, hessian, space.count):
                sigma = np.sqrt(np.diag(np.linalg.inv(hessian))[: space.count])
                self._run_errors.hidden, found = self._likelier_vibrations(at, sigma), at
                last, turns = np.zeros(len(at)), 1  # the end is another one
            averaged = self.mean_errors(at, hessian)
            cost.linear = averaged.linear
            errors, jacobians = averaged.errors, averaged.jacobians
            straight = averaged.rises <= RISE_MAX * space.searched.sum() / len(space.kept)
            if straight[space.followed].sum() < max(RUNS_APART_MIN, len(space.kept) / 2):
                space.followed, space.searched = before
                cost.linear = None
                return None
            if first:
                space.keep_only(straight)
            noise = cost.noise(errors)
            self._run_errors.report(report, errors)
            hessian, gradient = cost.about(at, errors, jacobians, noise)
            step = space.step(at, hessian, gradient)
            turns += space.turns_back(last, step, hessian)
            left = space.promise(step, hessian, gradient) / turns
            last, step = step, step / turns
            settled = left <= AVERAGES_DECREASE * space.count
            if settled or count >= self._steps_max:
                break
            information = hessian - cost.precision
            hessian = self.believed(information, errors, jacobians, noise) + cost.precision
            at = space.moved(at, step)
        if settled:  # a last step, along the same lines
            end = space.moved(at, step)
            for error, jacobian, own in zip(errors, jacobians, space.own, strict=True):
                error += jacobian @ (end - at)[own]
            at = end
        return Search(at=at, errors=errors, jacobians=jacobians, count=count, settled=settled)

    def mean_errors(self, at: Array, hessian: Array) -> MeanErrors:
        """Return errors over what is uncertain.

        Time steps change them as they do at `at`: what they change along a move is more rugged than
        motion itself.

        Args:
            at: All coordinates.
            hessian: Of the cost.

        Raises:
            CarosacError: One of the robots does not move.
        """
        space = self._space
        here = self._run_errors.at(at)
        searched = space.searched.copy()
        alike = space.told_by_alike(searched)
        varied = space.varied(searched)
        moves = self._moves(at, hessian, searched, varied)
        points = [np.tile(at, (len(each), 1)) for each in moves]
        for each, rows, move in zip(points, varied, moves, strict=True):
            each[:, rows] += move
        found, good = self._run_errors.simulated(points)
        if not all(each.all() for each in good):
            raise CarosacError("identification: no finite motion of a robot that fits as well")
        kept, noise = space.kept, self._cost.noise(here)
        bent = bent_coordinate(
            [moves[k] for k in kept], [found[k] for k in kept],
            int((varied[kept[0]] < space.count).sum()), noise.sigma,
        )  # fmt: skip
        errors, jacobians, linears = [], [], []
        for k, (rows, move, more) in enumerate(
            zip(varied, moves, self._run_errors.correction.errors, strict=True)
        ):
            linear = (
                Linearization.of(move, found[k], bent)
                if len(rows)
                else Linearization.nowhere(here[k] - more)
            )
            errors.append(linear.mean + more)
            jacobians.append(self._run_errors.by_coordinates(k, rows, linear.slopes))
            linears.append(linear)
        if alike:
            space.fill_alike(jacobians)
        rises = np.array([
            noise.cost(mean) - noise.cost(error) for mean, error in zip(errors, here, strict=True)
        ])  # fmt: skip
        return MeanErrors(errors=errors, jacobians=jacobians, linear=linears, rises=rises)

    def _moves(
        self,
        at: Array,
        hessian: Array,
        searched: NDArray[np.bool_],
        varied: Sequence[NDArray[np.int64]],
    ) -> list[Array]:
        """Return moves of what each run depends on, over what is uncertain, as `scattered_moves`.

        Args:
            at: All coordinates.
            hessian: Of the cost.
            searched: Coordinates that change.
            varied: Rows of those that change each run.
        """
        count = self._space.count
        axes, lower = axes_of_robot(hessian, searched, count), self._space.lower - at
        covariance = np.asarray(np.linalg.inv(hessian), float)
        return [
            scattered_moves(axes, hessian, covariance, count, rows, lower, seed=k)
            if len(rows)
            else np.zeros((1, 0))
            for k, rows in enumerate(varied)
        ]

    def _likelier_vibrations(self, at: Array, sigma: Array) -> list[HiddenVibrations]:
        """Return hidden vibrations found anew, or those before if runs cost less with them.

        Where vibrations are strong, other cables explain them that fit what is slow far worse.

        Args:
            at: As of `RunErrors.hidden_vibrations`.
            sigma: The same.
        """
        runs = self._run_errors
        anew, before = runs.hidden_vibrations(at, sigma), runs.hidden
        if before is None:
            return anew
        errors = runs.at(at)
        noise = self._cost.noise(errors)
        runs.hidden = anew
        better = self._cost.total(at, runs.at(at), noise) < self._cost.total(at, errors, noise)
        runs.hidden = before
        return anew if better else before

    def believed(
        self,
        information: Array,
        errors: Sequence[Array],
        jacobians: Sequence[Array],
        noise: PoseErrorNoise,
    ) -> Array:
        """Return an information without what slopes seem to tell by chance.

        Where that is more than there is, nothing is told.

        Args:
            information: By slopes over what is uncertain, or derivatives, which have no chance.
            errors: Of each run (K, 6).
            jacobians: By what each depends on (K, 6, p).
            noise: Of the errors.
        """
        space, linears = self._space, self._cost.linear
        if linears is None:
            return information
        left, chances = information.copy(), self._chances(linears, errors, jacobians, noise)
        searched = space.searched.copy()
        alike = space.unknowns.alike if space.told_by_alike(searched) else None
        for k, rows in enumerate(space.varied(searched)):
            linear, own = linears[k], space.own[k]
            if not len(rows):
                continue
            taken = np.zeros((len(rows), len(own)))
            taken[:, np.isin(own, rows)] = np.eye(len(rows))
            if alike is not None:
                of_robot = rows < space.count
                taken[of_robot, space.mass] = -alike[rows[of_robot]] / alike[space.mass]
            told = taken.T @ np.linalg.solve(linear.scatter, taken)
            left[np.ix_(own, own)] -= chances[k] * told
        values, vectors = eigh(left, self._cost.precision)
        back = np.linalg.inv(vectors)
        return np.asarray(back.T @ (np.maximum(values, 0.0)[:, None] * back))

    def _chances(
        self,
        linear: Sequence[Linearization],
        errors: Sequence[Array],
        jacobians: Sequence[Array],
        noise: PoseErrorNoise,
    ) -> Array:
        """Return what slopes of each run tell by chance, along any axis by a sigma of its points.

        What its start makes up for tells nothing of the robot.

        Args:
            linear: Of each run.
            errors: The same (K, 6).
            jacobians: By what each depends on (K, 6, p).
            noise: Of the errors.
        """
        judge = self._cost.judge(noise)
        beside = self._cost.beside_starts(
            [each.chance for each in linear], errors, jacobians, noise
        )
        return np.array([
            np.trace(judge.product(k, errors[k], chance, chance))
            for k, chance in enumerate(beside.columns)
        ])  # fmt: skip
