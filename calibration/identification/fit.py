"""The course of a search for the robot that moves as measured, and what its end tells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.identification.averages import Averages
from calibration.identification.cross_validation import Folds
from calibration.identification.doubts import Judge
from calibration.identification.error_noise import PoseErrorNoise
from calibration.identification.fit_cost import FitCost
from calibration.identification.frequencies import FrequencyTable
from calibration.identification.linearization import STALE_SIGMAS
from calibration.identification.run_errors import RunErrors
from calibration.identification.runs import FittedRun
from calibration.identification.search_space import SearchSpace
from calibration.identification.search_state import (
    DAMPING_START,
    SETTLED_DECREASE,
    ProgressCallback,
    Search,
)
from calibration.identification.settings import IdentificationSettings
from calibration.identification.spread import Spread, symmetric_draws
from calibration.identification.start_search import StartSearch
from calibration.identification.step_search import StepSearch
from calibration.identification.unknowns import Coordinates
from carosac_toolkit.base.arrays import Array

# Squared sigmas by which a step must promise to lower the cost of many recordings, which tell their
# sigmas, for each coordinate of the robot: by derivatives, and with a part of the poses.
MANY_DECREASE, PART_DECREASE = 0.02, 1.0
# Of the poses, from the first: later ones would be out of phase at first.
POSE_SHARES = (0.15, 0.4, 1.0)
SHARES_OF_MANY = (0.04, 0.12, 0.35, 1.0)  # of those of many recordings, which may begin with a jolt
STEPS_PER_SHARE = 4  # for each share but the last
ROUGH_STEPS_MAX = 3  # with all poses of a sway, before averages lead to the end
NOISE_UPDATES_MAX = 6  # steps by derivatives, after which noise is no longer estimated anew
SCORE_STRETCH_S = 5.0  # [s]
CORRELATED_AXES = 6.0  # axes that count as one in few recordings: one swing shows in all of them
# Of a typical run's cost: one that costs more starts anew once a search has led near. Chance alone
# leads to 1.5.
LOST_COST_RATIO = 2.0


@dataclass(frozen=True, kw_only=True, eq=False)
class CoordinateFit:
    """Coordinates that fit best.

    Attributes:
        coordinates: shape (k,).
        spread: How far off these may be; the unknown starts are taken into account.
        information: Fisher information of the data alone, shape (k, k), less what the unknown start
            takes from it.
        starts: Coordinates of the sway at the start of each run, shape (2 m,).
        excess: Factor by which the data count for less than independent innovations [1].
        iterations: Steps taken.
        converged: True if the last step promised little, or brought little.
        left_out: Runs that seem to tell of the robot by chance; only their start is fitted to them.
        folds: Parts of the data about the estimate; coordinates of the robot are the first.
    """

    coordinates: Array
    spread: Spread
    information: Array
    starts: tuple[Array, ...]
    excess: float
    iterations: int
    converged: bool
    folds: Folds
    left_out: tuple[int, ...] = ()


class Fitter:
    """The search for the robot that moves as measured; each runs once.

    Attributes:
        space: Coordinates that are searched.
        run_errors: What the recordings miss.
        cost: What that costs.
        steps: Steps by derivatives.
        start_search: Search for the starts alone.
        averages: End of the search where averages lead to it.
    """

    def __init__(
        self,
        unknowns: Coordinates,
        runs: Sequence[FittedRun],
        settings: IdentificationSettings,
        *,
        robot_at: Array | None = None,
        frequencies: FrequencyTable | None = None,
        judge: Judge | None = None,
    ) -> None:
        """Take the data.

        Args:
            unknowns: k coordinates of the robot, beside which the start of each run is unknown.
            runs: Recordings.
            settings: Settings of the computation.
            robot_at: Coordinates (k,) at which the robot is held, so that only the starts of the
                runs are searched; None: they are searched too.
            frequencies: Measured beside the recordings; None: none.
            judge: By which parts that are held out count; None: as in the fit.
        """
        self._unknowns = unknowns
        self._settings = settings
        self._judge = judge
        self.space = SearchSpace(unknowns, runs, robot_at)
        self.run_errors = RunErrors(self.space, runs, settings.time_step)
        self.cost = FitCost(self.space, self.run_errors, frequencies)
        self.steps = StepSearch(self.space, self.run_errors, self.cost)
        self.start_search = StartSearch(self.space, self.run_errors, self.cost, self.steps)
        self.averages = Averages(self.space, self.run_errors, self.cost, settings.iterations)
        self._axes = 1.0 if self.space.many else CORRELATED_AXES  # that count as one
        # whether cables do beside a sway, which is averaged, or as starts say
        self._vibrate = self.run_errors.sways or any(len(run.sway.stretch_sigma) for run in runs)

    def run(self, report: ProgressCallback, nearly: Array | None = None) -> CoordinateFit:
        """Search.

        Args:
            report: Called before each step with the number of poses that it looks at, and their
                RMS errors [m] and [rad].
            nearly: Coordinates (k,) to which `approach` led, from where to begin; None: the prior
                mean.

        Raises:
            CarosacError: The robot's simulation fails where the search stands.
        """
        at = self._begin(nearly)
        if nearly is not None and self.run_errors.sways:
            return self._settled(self.start_search.begin(at, POSE_SHARES[:-1]), report)
        return self._settled(self._approached(at, report), report)

    def approach(self, report: ProgressCallback, nearly: Array | None = None) -> Array:
        """Search as far as a part of the poses leads; return the coordinates (k,) there.

        Args:
            report: As of `run`.
            nearly: The same.
        """
        return self._approached(self._begin(nearly), report)[: self.space.count]

    def starts(self) -> tuple[Array, ...]:
        """Search for the starts of the runs alone, without a report."""
        at = self.start_search.begin(self.space.begin, POSE_SHARES[:-1])
        self.run_errors.look_at(1.0)
        state = self._settle(at, None, lambda poses, position, rotation: None)
        return self.space.starts_at(state.at)

    def _begin(self, robot: Array | None) -> Array:
        """Return where a search begins, of all coordinates, by those of the robot (k,), if any."""
        begin = self.space.begin
        return begin if robot is None else np.concatenate([robot, begin[self.space.count :]])

    def _approached(self, at: Array, report: ProgressCallback) -> Array:
        """Return all coordinates to which ever more of the poses lead."""
        at = self.start_search.begin(at, POSE_SHARES[:1])
        shares = SHARES_OF_MANY if self.space.many and not self.run_errors.sways else POSE_SHARES
        for share in shares[:-1]:
            self.run_errors.look_at(share)
            at = self._settle(at, STEPS_PER_SHARE, report).at
        self.run_errors.look_at_all()
        return at

    def _settled(self, at: Array, report: ProgressCallback) -> CoordinateFit:
        """Search from there with all poses."""
        space, cost = self.space, self.cost
        self.run_errors.look_at(1.0)
        state = self._settle(at, None, report)
        at = state.at
        left_out = [k for k, followed in enumerate(space.followed) if not followed]
        noise = cost.noise(state.errors)
        cost.look(at, state.errors, state.jacobians, noise)
        information, _ = cost.normal(state.errors, state.jacobians, noise)
        believed = self.averages.believed(information, state.errors, state.jacobians, noise)
        inverse = np.asarray(np.linalg.inv(believed + cost.precision), float)
        excess = self._excess(state, noise, information, inverse)
        own = slice(space.count)
        scores = self._axes * excess * information  # as they vary, beside the prior
        root = inverse @ np.linalg.cholesky(scores + cost.precision)
        spread = self._spread(at, self._no_worse_known(root))
        judge = self._judge or cost.judge(noise)
        folds = cost.folds(at, state.errors, state.jacobians, judge)
        believed /= self._axes * excess
        if left_out:
            for k, start in zip(left_out, self._sought(at, left_out), strict=True):
                at[space.start_of(k)] = start
        return CoordinateFit(
            coordinates=at[own],
            spread=spread,
            information=cost.marginal(believed) + (cost.precision - space.prior)[own, own],
            starts=space.starts_at(at),
            excess=excess,
            iterations=state.count,
            converged=state.settled,
            folds=folds,
            left_out=tuple(left_out),
        )

    def _settle(self, at: Array, steps: int | None, report: ProgressCallback) -> Search:
        """Search from somewhere, for some steps or to the end."""
        space, many = self.space, self.space.many
        damping, settled = DAMPING_START, False
        alone = not space.robot_is_searched  # starts: exact ones cost little more
        averages = steps is None and many and not alone and self._vibrate
        coarse = steps is not None or not (self.run_errors.sways and alone)
        if averages:
            self.run_errors.hidden = self.run_errors.hidden_vibrations(
                at, self._unknowns.prior.sigma
            )
        errors = self.run_errors.at(at)
        least = SETTLED_DECREASE * self._axes
        if many:
            least = (PART_DECREASE if steps else MANY_DECREASE) * space.count
        if averages:
            least = STALE_SIGMAS**2 * space.count  # from where averages lead to the end
        for count in range(1, (steps or self._settings.iterations) + 1):
            final = steps is not None or not coarse  # it may end with these derivatives
            jacobians = self.run_errors.jacobians(at, coarse=coarse)
            if count <= NOISE_UPDATES_MAX:
                noise = self.cost.noise(errors)
            self.run_errors.report(report, errors)
            hessian, gradient = self.cost.about(at, errors, jacobians, noise)
            promise = space.promise(space.bounded(at, hessian, gradient), hessian, gradient)
            settled, stuck = promise <= least, False
            # by exact derivatives, a last one too
            if not settled or (self.run_errors.sways and not coarse):
                step = self.steps.search(at, hessian, gradient, errors, noise, damping, least)
                stuck = not settled and step.decrease <= least
                settled = settled or (not coarse and 0.0 < step.decrease <= least)
                at, errors, damping = step.at, step.errors, step.damping
            ended = settled or stuck
            if averages and (ended or count == ROUGH_STEPS_MAX):
                at, errors = self._found_again(at, errors, noise)
                self.averages.leave_out_unfollowed(at, errors)
                hessian, _ = self.cost.about(at, errors, jacobians, noise)
                search = self.averages.search(at, hessian, count, report)
                if search is not None:
                    return search
                averages, ended, least = False, False, MANY_DECREASE * space.count
                errors = self.run_errors.at(at)
            if ended and final:
                break
            coarse &= not ended
        settled &= final
        return Search(at=at, errors=errors, jacobians=jacobians, count=count, settled=settled)

    def _found_again(
        self, at: Array, errors: list[Array], noise: PoseErrorNoise
    ) -> tuple[Array, list[Array]]:
        """Start runs anew, from their first guesses, that beside the others are far off.

        Args:
            at: All coordinates, near to the robot.
            errors: Of each run there (K, 6).
            noise: Of these.
        """
        costs = [noise.cost(each) / each.size for each in errors]
        lost = [k for k, cost in enumerate(costs) if cost > LOST_COST_RATIO * np.median(costs)]
        if not lost:
            return at, errors
        new = at.copy()
        for k, start in zip(lost, self._sought(at, lost), strict=True):
            new[self.space.start_of(k)] = start
        found = self.run_errors.at(new)
        point = at.copy()
        for k in lost:
            rows = self.space.start_of(k)
            if noise.cost(found[k]) < noise.cost(errors[k]):
                point[rows] = new[rows]
        return point, self.run_errors.at(point)

    def _sought(self, at: Array, which: Sequence[int]) -> tuple[Array, ...]:
        """Return starts of some runs beside the robot, by all poses, also those that lead."""
        return self._beside(at, [self.run_errors.whole[k] for k in which]).starts()

    def _beside(self, at: Array, runs: Sequence[FittedRun]) -> Fitter:
        """Return a search for the starts of some runs beside the robot of coordinates."""
        return Fitter(self._unknowns, runs, self._settings, robot_at=at[: self.space.count])

    def _no_worse_known(self, root: Array) -> Array:
        """Return the root of a covariance that nowhere leaves more open than was known before.

        Scores vary by what slopes tell by chance too, which nothing holds against them.
        """
        lower = np.linalg.cholesky(self.cost.precision)
        axes, sigma, _ = np.linalg.svd(lower.T @ root)
        return np.asarray(np.linalg.solve(lower.T, axes * np.minimum(sigma, 1.0)), float)

    def _spread(self, at: Array, root: Array) -> Spread:
        """Return how far off the robot may be, by the root of the covariance of all coordinates."""
        own = slice(self.space.count)
        covariance = root @ root.T  # rounding leaves a product of three too asymmetric
        spread = Spread.straight(np.asarray(covariance[own, own], float))
        if self.cost.linear is None:
            return spread
        room = np.where(self.space.searched, at - self.space.lower, 0.0)
        return replace(spread, draws=symmetric_draws(root, room)[:, own])

    def _excess(
        self, state: Search, noise: PoseErrorNoise, information: Array, inverse: Array
    ) -> float:
        """Return by how much scores vary more than independent ones.

        `inverse` is that of the information with the prior.

        Many recordings tell it by themselves: one is independent of the others. Their errors are
        smaller than noise by what was fitted to them. In a few, scores of long stretches tell what
        lasts for less than these; what lasts longer shows in all axes.
        """
        space, judge, sums = self.space, self.cost.judge(noise), []
        for k in space.kept:
            own, errors = space.own[k], state.errors[k]
            if space.many:
                flat = state.jacobians[k].reshape(-1, len(own))
                parts = judge.product(k, errors, flat, errors.reshape(-1, 1)).T
            else:
                weights = noise.weights(errors)
                scores = np.einsum("nci,nc->ni", state.jacobians[k], weights * errors)
                time = self.run_errors.runs[k].poses.time
                length = max(1, int(np.searchsorted(time, time[0] + SCORE_STRETCH_S)))
                parts = np.add.reduceat(scores, np.arange(0, len(scores), length), axis=0)
            whole = np.zeros((len(parts), len(information)))
            whole[:, own] = parts
            if space.many:  # what is known of a start pulls at it too
                whole[:, space.start_of(k)] += state.at[space.start_of(k)]
            sums.append(whole)
        stretches = np.concatenate(sums)
        fitted = float(np.trace(inverse @ information))  # parameters that the data tell
        if not space.many:
            spread = float(np.einsum("bi,ij,bj->", stretches, inverse, stretches))
            return max(1.0, spread / fitted)
        robot, start = slice(space.count), slice(space.count, None)
        hessian = (information + self.cost.precision)[start]
        own_scores, of_starts = stretches[:, robot], stretches[:, start]
        # what is left of scores once each run has started as suits it best
        shared = own_scores - of_starts @ np.linalg.solve(hessian[:, start], hessian[:, robot])
        left = self.cost.marginal(information)
        known = np.linalg.inv(left + self.cost.precision[robot, robot])
        spread = float(np.einsum("bi,ij,bj->", shared, known, shared))
        count, total = len(stretches), sum(state.errors[k].size for k in space.kept)
        least = total / max(total - fitted, 1.0)
        return max(least, spread * count / (count - 1) / float(np.trace(known @ left)))
