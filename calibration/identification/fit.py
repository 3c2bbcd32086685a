"""Gauss-Newton on coordinates of a robot; one batch of worlds a run gives errors and Jacobian."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, eigh

from calibration.identification.cross_validation import Folds
from calibration.identification.doubts import Doubts, Judge
from calibration.identification.error_noise import (
    RUNS_APART_MIN,
    PoseErrorNoise,
    estimate_noise,
)
from calibration.identification.frequencies import FrequencyTable, KnownFrequencies
from calibration.identification.hidden_vibrations import hidden_vibrations
from calibration.identification.linearization import (
    STALE_SIGMAS,
    Linearization,
    axes_of_robot,
    bent_coordinate,
    is_stale,
    scattered_moves,
)
from calibration.identification.quadratic import Quadratic
from calibration.identification.run_simulator import RunSimulator
from calibration.identification.runs import FittedRun
from calibration.identification.search_state import (
    DAMPING_START,
    Correction,
    Search,
    Step,
)
from calibration.identification.settings import IdentificationSettings
from calibration.identification.spread import Spread, symmetric_draws
from calibration.identification.unknowns import Coordinates
from calibration.identification.vibration_scan import as_vibrating, cable_ways
from calibration.identification.vibrations import HiddenVibrations
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError

FINITE_DIFFERENCE_STEP = 0.005  # of the coordinates, for differences
# The same of many recordings, which tell more: over longer ones motion is less linear, and over
# shorter ones its jumps count for more.
STEP_OF_MANY = 5e-4
MANY_STEP_RATIO = 1.0 / 3.0  # of the time steps where many recordings show what the others hide
# Squared sigmas by which a step must promise to lower the cost: for each axis that counts, or each
# coordinate of the starts.
SETTLED_DECREASE = 0.1
# The same of many recordings, which tell their sigmas, for each coordinate of the robot: by
# derivatives, by averages, of which the last step is taken, and with a part of the poses.
MANY_DECREASE, AVERAGES_DECREASE, PART_DECREASE = 0.02, 0.05, 1.0
POSE_SHARES = (
    0.15,
    0.4,
    1.0,
)  # of the poses, from the first: later ones would be out of phase at first
SHARES_OF_MANY = (0.04, 0.12, 0.35, 1.0)  # of those of many recordings, which may begin with a jolt
STEPS_PER_SHARE = 4  # for each share but the last
ROUGH_STEPS_MAX = 3  # with all poses of a sway, before averages lead to the end
NOISE_UPDATES_MAX = 6  # steps by derivatives, after which noise is no longer estimated anew
SCORE_STRETCH_S = 5.0  # [s]
# Of few recordings together, each of which is held out once; and of each, as a start that is held
# out altogether is not known.
HELD_OUT_STRETCHES, HELD_OUT_OF_EACH = 8, 2
CORRELATED_AXES = 6.0  # axes that count as one in few recordings: one swing shows in all of them
COARSE_STEP_RATIO = 2.0  # of the simulator's time steps, for coarse derivatives and for errors
STRETCHES = (1.0, 2.0, 4.0)  # of a step, of which the best is taken: weights that fall with errors
# make steps too short
# The same where only the sway counts: parameters that nearly make up for each other are a long way
# from linear there.
SWAY_STRETCHES = (0.3, 1.0, 2.0)
# Shares of steps of a start alone, and how much they are damped, of the Hessian's diagonal; the
# best is taken. Two modes that sway nearly alike are hard to tell apart at first.
START_TRIES = ((1.0, 0.0), (0.4, 0.0), (1.0, 0.01), (1.0, 0.1))
# The same where starts alone are searched, from first guesses that may be far off.
GUESS_TRIES = (*START_TRIES, (1.0, 1.0), (1.0, 10.0))
# By which mean errors of a run over what is uncertain may cost more than those where a search
# stands, for each coordinate that is searched, of all of which a run has its share. Linear ones do
# not at all.
RISE_MAX = 3.0
FOLLOWED_SIGMAS = 1.0  # of a run's errors together, by which time steps may leave it
# Of a typical run's cost: one that costs more starts anew once a search has led near. Chance alone
# leads to 1.5.
LOST_COST_RATIO = 2.0
# Growths of the first guess of a start from which one is sought, and the best is taken: friction
# takes away what a mode swung by before its first pose. 2.5 leads where 1.5 does.
GUESS_GROWTHS = (1.0, 1.5)
STARTS_STEPS_MAX = 8  # of the starts alone, before the robot is searched
STEP_MAX_SIGMAS = 2.0  # prior sigmas that a coordinate may move in one step
DAMPING_TRIES_MAX = 7  # dampings that are tried before a search gives up
DAMPING_GROWTH = 10.0  # from one to the next
ProgressCallback = Callable[[int, float, float], None]


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
    """The search for the robot that moves as measured."""

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
        self._runs = self._whole = tuple(runs)
        self._settings = settings
        self._many = len(self._runs) >= RUNS_APART_MIN
        self._axes = 1.0 if self._many else CORRELATED_AXES  # that count as one
        alone = robot_at is not None  # few are searched as the many were that told the robot
        self._sways = (self._many or alone) and all(run.window for run in self._runs)
        follows = self._many and not self._sways
        self._exact = self._many or self._sways  # errors are of vanishing time steps
        self._time_step = settings.time_step * (MANY_STEP_RATIO if follows else 1.0)
        # whether cables do beside a sway, which is averaged, or as starts say
        self._vibrate = self._sways or any(len(run.sway.stretch_sigma) for run in self._runs)
        self._count = len(unknowns.prior.names)
        sizes = [len(run.sway.guess) for run in runs]
        edges = self._count + np.cumsum([0, *sizes])
        self._own = [
            np.concatenate([np.arange(self._count), np.arange(a, b)]) for a, b in pairwise(edges)
        ]  # rows of the coordinates that each run depends on
        loose = sum(sizes)
        self._names = [*unknowns.prior.names, *(name for run in runs for name in run.sway.names)]
        self._simulator = RunSimulator(unknowns, self._own, self._names)
        self._mass = self._names.index("mass") if "mass" in self._names else -1
        self._sigma = np.concatenate([unknowns.prior.sigma, np.ones(loose)])
        self._lower = np.concatenate([unknowns.lower, np.full(loose, -np.inf)])
        self._prior = block_diag(unknowns.prior.information, np.eye(loose))
        self._judge = judge
        self._frequencies = (
            None if frequencies is None else KnownFrequencies(table=frequencies, unknowns=unknowns)
        )
        self._first = np.concatenate(
            [unknowns.prior.mean if robot_at is None else robot_at]
            + [run.sway.guess for run in runs]
        )
        self._known = Quadratic(  # beside the recordings; frequencies once a step looks at them
            cost=0.0, gradient=np.zeros(len(self._first)), information=self._prior
        )
        self._finer: list[Array] | None = None  # what time steps make derivatives wrong by
        # What vibrations that noise hides change of errors of each run.
        self._hidden: list[HiddenVibrations] | None = None
        self._linear: list[Linearization] | None = None  # errors of each run, as taken last
        self._rises = np.zeros(len(self._runs))  # of their cost, by means over what is uncertain
        self._doubts: Doubts | None = None  # what errors have in common
        self._correction = Correction(at=self._first, errors=[])  # as found last
        self._followed = np.ones(len(self._runs), dtype=np.bool_)  # others are left out
        self._searched = np.ones(len(self._first), dtype=np.bool_)
        self._searched[: self._count] = robot_at is None

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
        self._begin_at(nearly)
        if nearly is not None and self._sways:
            return self._settled(self._started(self._first, POSE_SHARES[:-1]), report)
        return self._settled(self._approached(report), report)

    def approach(self, report: ProgressCallback, nearly: Array | None = None) -> Array:
        """Search as far as a part of the poses leads; return the coordinates (k,) there.

        Args:
            report: As of `run`.
            nearly: The same.
        """
        self._begin_at(nearly)
        return self._approached(report)[: self._count]

    def _begin_at(self, coordinates: Array | None) -> None:
        """Let a search begin at coordinates of the robot (k,), if there are any."""
        if coordinates is not None:
            self._first = np.concatenate([coordinates, self._first[self._count :]])

    def _approached(self, report: ProgressCallback) -> Array:
        """Return all coordinates to which ever more of the poses lead."""
        whole, at = self._runs, self._started(self._first)
        shares = SHARES_OF_MANY if self._many and not self._sways else POSE_SHARES
        for share in shares[:-1]:
            self._runs = tuple(run.first(share) for run in whole)
            at = self._settle(at, STEPS_PER_SHARE, report).at
        self._runs = whole
        return at

    def _settled(self, at: Array, report: ProgressCallback) -> CoordinateFit:
        """Search from there with all poses."""
        self._runs = tuple(run.first(1.0) for run in self._whole)
        state = self._settle(at, None, report)
        at = state.at
        left_out = [k for k, followed in enumerate(self._followed) if not followed]
        noise = self._noise(state.errors)
        self._known = self._known_about(at)
        self._doubts = self._doubted(state.errors, state.jacobians, noise)
        information, _ = self._normal(state.errors, state.jacobians, noise)
        believed = self._believed(information, state.errors, state.jacobians, noise)
        inverse = np.asarray(np.linalg.inv(believed + self._precision), float)
        excess = self._excess(state, noise, information, inverse)
        own = slice(self._count)
        scores = self._axes * excess * information  # as they vary, beside the prior
        root = inverse @ np.linalg.cholesky(scores + self._precision)
        spread = self._spread(at, self._no_worse_known(root))
        folds = self._folds(state, self._judge or self._by(noise))
        believed /= self._axes * excess
        if left_out:
            for k, start in zip(left_out, self._sought(at, left_out), strict=True):
                at[self._own[k][self._count :]] = start
        return CoordinateFit(
            coordinates=at[own],
            spread=spread,
            information=self._marginal(believed) + (self._precision - self._prior)[own, own],
            starts=self._starts(at),
            excess=excess,
            iterations=state.count,
            converged=state.settled,
            folds=folds,
            left_out=tuple(left_out),
        )

    def starts(self) -> tuple[Array, ...]:
        """Search for the starts of the runs alone, without a report."""
        at = self._started(self._first, POSE_SHARES[:-1])
        self._runs = tuple(run.first(1.0) for run in self._runs)
        state = self._settle(at, None, lambda poses, position, rotation: None)
        return self._starts(state.at)

    def _starts(self, at: Array) -> tuple[Array, ...]:
        """Return the coordinates of each start."""
        return tuple(at[own[self._count :]] for own in self._own)

    def _marginal(self, information: Array) -> Array:
        """Return what is left for the robot of an information (Schur complement), (k, k)."""
        own, start = slice(self._count), slice(self._count, None)
        known = (information + self._precision)[start, start]
        cross = information[own, start]
        return np.asarray(information[own, own] - cross @ np.linalg.solve(known, cross.T))

    def _no_worse_known(self, root: Array) -> Array:
        """Return the root of a covariance that nowhere leaves more open than was known before.

        Scores vary by what slopes tell by chance too, which nothing holds against them.
        """
        lower = np.linalg.cholesky(self._precision)
        axes, sigma, _ = np.linalg.svd(lower.T @ root)
        return np.asarray(np.linalg.solve(lower.T, axes * np.minimum(sigma, 1.0)), float)

    def _spread(self, at: Array, root: Array) -> Spread:
        """Return how far off the robot may be, by the root of the covariance of all coordinates."""
        own = slice(self._count)
        covariance = root @ root.T  # rounding leaves a product of three too asymmetric
        spread = Spread.straight(np.asarray(covariance[own, own], float))
        if self._linear is None:
            return spread
        room = np.where(self._searched, at - self._lower, 0.0)
        return replace(spread, draws=symmetric_draws(root, room)[:, own])

    def _settle(self, at: Array, steps: int | None, report: ProgressCallback) -> Search:
        """Search from somewhere, for some steps or to the end."""
        damping, settled = DAMPING_START, False
        alone = not self._searched[: self._count].any()  # starts: exact ones cost little more
        averages = steps is None and self._many and not alone and self._vibrate
        coarse = steps is not None or not (self._sways and alone)
        if averages:
            self._hidden = self._hidden_vibrations(at, self._unknowns.prior.sigma)
        errors = self._errors_at(at)
        least = SETTLED_DECREASE * self._axes
        if self._many:
            least = (PART_DECREASE if steps else MANY_DECREASE) * self._count
        if averages:
            least = STALE_SIGMAS**2 * self._count  # from where averages lead to the end
        for count in range(1, (steps or self._settings.iterations) + 1):
            final = steps is not None or not coarse  # it may end with these derivatives
            jacobians = self._jacobians(at, coarse=coarse)
            if count <= NOISE_UPDATES_MAX:
                noise = self._noise(errors)
            self._report(report, errors)
            hessian, gradient = self._about(at, errors, jacobians, noise)
            promise = self._promise(self._bounded(at, hessian, gradient), hessian, gradient)
            settled, stuck = promise <= least, False
            if not settled or (self._sways and not coarse):  # by exact derivatives, a last one too
                step = self._search(at, hessian, gradient, errors, noise, damping, least)
                stuck = not settled and step.decrease <= least
                settled = settled or (not coarse and 0.0 < step.decrease <= least)
                at, errors, damping = step.at, step.errors, step.damping
            ended = settled or stuck
            if averages and (ended or count == ROUGH_STEPS_MAX):
                at, errors = self._found_again(at, errors, noise)
                self._leave_out_unfollowed(at, errors)
                hessian, _ = self._about(at, errors, jacobians, noise)
                search = self._settle_averages(at, hessian, count, report)
                if search is not None:
                    return search
                averages, ended, least = False, False, MANY_DECREASE * self._count
                self._linear, errors = None, self._errors_at(at)
            if ended and final:
                break
            coarse &= not ended
        settled &= final
        return Search(at=at, errors=errors, jacobians=jacobians, count=count, settled=settled)

    def _settle_averages(
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
            report: As of `run`.
        """
        found, settled = None, False
        before = self._followed.copy(), self._searched.copy()
        while True:
            count, first = count + 1, found is None
            if found is None or is_stale(at - found, hessian, self._count):
                sigma = np.sqrt(np.diag(np.linalg.inv(hessian))[: self._count])
                self._hidden, found = self._likelier_vibrations(at, sigma), at
                last, turns = np.zeros(len(at)), 1  # the end is another one
            errors, jacobians = self._linearized(at, hessian)
            straight = self._rises <= RISE_MAX * self._searched.sum() / len(self._kept)
            if straight[self._followed].sum() < max(RUNS_APART_MIN, len(self._kept) / 2):
                self._followed, self._searched = before
                return None
            if first:
                self._keep_only(straight)
            noise = self._noise(errors)
            self._report(report, errors)
            hessian, gradient = self._about(at, errors, jacobians, noise)
            step = self._step(at, hessian, gradient, 0.0)
            turns += self._turns_back(last, step, hessian)
            left = self._promise(step, hessian, gradient) / turns
            last, step = step, step / turns
            settled = left <= AVERAGES_DECREASE * self._count
            if settled or count >= self._settings.iterations:
                break
            information = hessian - self._precision
            hessian = self._believed(information, errors, jacobians, noise) + self._precision
            at = self._moved(at, step)
        if settled:  # a last step, along the same lines
            end = self._moved(at, step)
            for error, jacobian, own in zip(errors, jacobians, self._own, strict=True):
                error += jacobian @ (end - at)[own]
            at = end
        return Search(at=at, errors=errors, jacobians=jacobians, count=count, settled=settled)

    def _turns_back(self, last: Array, step: Array, hessian: Array) -> bool:
        """Say whether a step turns the robot back, once starts have followed."""
        cost = Quadratic(cost=0.0, gradient=np.zeros(len(step)), information=hessian)
        left, own = cost.least_beside(self._count).information, slice(self._count)
        return bool(last[own] @ left @ step[own] < 0.0)

    def _report(self, report: ProgressCallback, errors: Sequence[Array]) -> None:
        """Report errors of all runs, before a step."""
        report(sum(len(run.poses.time) for run in self._runs), *_rms(np.concatenate(errors)))

    def _about(
        self, at: Array, errors: Sequence[Array], jacobians: Sequence[Array], noise: PoseErrorNoise
    ) -> tuple[Array, Array]:
        """Return the Hessian of half the cost and its gradient, with all else that is known."""
        self._known = self._known_about(at)
        self._doubts = self._doubted(errors, jacobians, noise)
        information, gradient = self._normal(errors, jacobians, noise)
        return information + self._precision, gradient + self._known.gradient

    def _believed(
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
        if self._linear is None:
            return information
        left, chances = information.copy(), self._chances(errors, jacobians, noise)
        searched = self._searched.copy()
        alike = self._unknowns.alike if self._told_by_alike(searched) else None
        for k, rows in enumerate(self._varied(searched)):
            linear, own = self._linear[k], self._own[k]
            if not len(rows):
                continue
            taken = np.zeros((len(rows), len(own)))
            taken[:, np.isin(own, rows)] = np.eye(len(rows))
            if alike is not None:
                of_robot = rows < self._count
                taken[of_robot, self._mass] = -alike[rows[of_robot]] / alike[self._mass]
            told = taken.T @ np.linalg.solve(linear.scatter, taken)
            left[np.ix_(own, own)] -= chances[k] * told
        values, vectors = eigh(left, self._precision)
        back = np.linalg.inv(vectors)
        return np.asarray(back.T @ (np.maximum(values, 0.0)[:, None] * back))

    def _chances(
        self, errors: Sequence[Array], jacobians: Sequence[Array], noise: PoseErrorNoise
    ) -> Array:
        """Return what slopes of each run tell by chance, along any axis by a sigma of its points.

        What its start makes up for tells nothing of the robot.

        Args:
            errors: Of each run (K, 6).
            jacobians: By what each depends on (K, 6, p).
            noise: Of the errors.
        """
        assert self._linear is not None
        judge = self._by(noise)
        beside = self._beside_starts(
            [each.chance for each in self._linear], errors, jacobians, noise
        )
        return np.array([
            np.trace(judge.product(k, errors[k], chance, chance))
            for k, chance in enumerate(beside.columns)
        ])  # fmt: skip

    @property
    def _starts_follow(self) -> bool:
        """True where steps of the robot are judged once the starts of many runs have followed."""
        return self._many and bool(self._searched[: self._count].any())

    def _excess(
        self, state: Search, noise: PoseErrorNoise, information: Array, inverse: Array
    ) -> float:
        """Return by how much scores vary more than independent ones.

        `inverse` is that of the information with the prior.

        Many recordings tell it by themselves: one is independent of the others. Their errors are
        smaller than noise by what was fitted to them. In a few, scores of long stretches tell what
        lasts for less than these; what lasts longer shows in all axes.
        """
        sums = []
        for k in self._kept:
            own, errors = self._own[k], state.errors[k]
            if self._many:
                flat = state.jacobians[k].reshape(-1, len(own))
                parts = self._by(noise).product(k, errors, flat, errors.reshape(-1, 1)).T
            else:
                weights = noise.weights(errors)
                scores = np.einsum("nci,nc->ni", state.jacobians[k], weights * errors)
                time = self._runs[k].poses.time
                length = max(1, int(np.searchsorted(time, time[0] + SCORE_STRETCH_S)))
                parts = np.add.reduceat(scores, np.arange(0, len(scores), length), axis=0)
            whole = np.zeros((len(parts), len(information)))
            whole[:, own] = parts
            if self._many:  # what is known of a start pulls at it too
                whole[:, own[self._count :]] += state.at[own[self._count :]]
            sums.append(whole)
        stretches = np.concatenate(sums)
        fitted = float(np.trace(inverse @ information))  # parameters that the data tell
        if self._many:
            start = slice(self._count, None)
            hessian = (information + self._precision)[start]
            own, own_start = stretches[:, : self._count], stretches[:, start]
            # what is left of scores once each run has started as suits it best
            shared = own - own_start @ np.linalg.solve(hessian[:, start], hessian[:, : self._count])
            left = self._marginal(information)
            known = np.linalg.inv(left + self._precision[: self._count, : self._count])
            spread = float(np.einsum("bi,ij,bj->", shared, known, shared))
            count, total = len(stretches), sum(state.errors[k].size for k in self._kept)
            least = total / max(total - fitted, 1.0)
            return max(least, spread * count / (count - 1) / float(np.trace(known @ left)))
        spread = float(np.einsum("bi,ij,bj->", stretches, inverse, stretches))
        return max(1.0, spread / fitted)

    def _folds(self, state: Search, judge: Judge) -> Folds:
        """Return the recordings, or stretches of few of them, about where the search ended.

        Each of many recordings has a start of its own, which follows.
        """
        count, parts = self._count, list[Quadratic]()
        size = count if self._many else len(state.at)
        total = sum(len(state.errors[k]) for k in self._kept)
        for k in self._kept:
            own, errors, slopes = self._own[k], state.errors[k], state.jacobians[k]
            if self._many:
                fold = self._with_start(k, state.at, self._fold(k, judge, errors, slopes))
                parts.append(fold.least_beside(count))
                continue
            stretches = max(HELD_OUT_OF_EACH, round(HELD_OUT_STRETCHES * len(errors) / total))
            stretches = min(stretches, len(errors))
            for rows in np.array_split(np.arange(len(errors)), stretches):
                fold = self._fold(k, judge, errors[rows], slopes[rows])
                gradient, information = np.zeros(size), np.zeros((size, size))
                gradient[own], information[np.ix_(own, own)] = fold.gradient, fold.information
                parts.append(replace(fold, gradient=gradient, information=information))
        first = slice(size)
        beside = replace(
            self._known,
            gradient=self._known.gradient[first],
            information=self._precision[first, first],
        )
        places = tuple(self._kept) if self._many else tuple(range(len(parts)))
        return Folds(
            parts=parts, known=beside, at=state.at[first].copy(), lower=self._lower[first],
            judge=judge, places=places,
        )  # fmt: skip

    def _with_start(self, k: int, at: Array, cost: Quadratic) -> Quadratic:
        """Add what is known of the start of a run, which is last of what the run depends on."""
        gradient, information = cost.gradient.copy(), cost.information.copy()
        rows = self._own[k][self._count :]
        loose = slice(len(gradient) - len(rows), None)
        gradient[loose] += at[rows]
        information[loose, loose] += np.eye(len(rows))
        constant = cost.cost + float(at[rows] @ at[rows])
        return Quadratic(cost=constant, gradient=gradient, information=information)

    def _fold(self, k: int, judge: Judge, errors: Array, slopes: Array) -> Quadratic:
        """Return the cost of some errors (K, 6) of a run, by what it depends on."""
        flat = slopes.reshape(errors.size, -1)
        return Quadratic(
            cost=judge.cost(k, errors),
            gradient=judge.product(k, errors, flat, errors.reshape(-1, 1))[:, 0],
            information=judge.product(k, errors, flat, flat),
        )

    def _errors_at(self, at: Array) -> list[Array]:
        """Return the errors of each run (K, 6), of vanishing time steps where `_exact`.

        The drift by vibrations that noise hides corrects them once it was found.

        Many recordings tell frequencies better than time steps that are short enough for a motion.
        What these are wrong by falls with their square (Richardson). Nearby it is nearly the same.
        """
        points = [at[None]] * len(self._runs)
        errors, good = self._simulated(points)
        more = [np.zeros(6)] * len(errors)
        if self._exact:
            fine, sound = self._simulated(points, refined=2)
            good = [one & other for one, other in zip(good, sound, strict=True)]
            more = [
                4.0 / 3.0 * (best[0] - each[0]) for best, each in zip(fine, errors, strict=True)
            ]
        if not all(each.all() for each in good):
            raise CarosacError("identification: no finite motion of the robot")
        if self._hidden is not None:
            more = [each + hidden.drift for each, hidden in zip(more, self._hidden, strict=True)]
        self._correction = Correction(at=at, errors=more)
        return [each[0] + beyond for each, beyond in zip(errors, more, strict=True)]

    def _leave_out_unfollowed(self, at: Array, errors: Sequence[Array]) -> None:
        """Leave out the runs that no time step follows.

        Strong vibrations move a sway too, and a little more or less of a parameter moves them
        altogether: what such a run seems to tell of the robot is chance. It shows in time steps:
        what two of them tell of vanishing ones differs from what two shorter ones do.
        """
        sigma = self._noise(errors).sigma
        points = [at[None]] * len(self._runs)
        once, twice, more = (self._simulated(points, refined=refined)[0] for refined in (1, 2, 4))
        differs = np.array([
            np.linalg.norm((5.0 * b - a - 4.0 * c) / (3.0 * sigma))
            for a, b, c in zip(once, twice, more, strict=True)
        ])  # fmt: skip
        self._keep_only(differs <= max(FOLLOWED_SIGMAS, float(np.median(differs))))

    def _keep_only(self, told: NDArray[np.bool_]) -> None:
        """Leave out all other runs, and what was left out before."""
        self._followed &= told
        for k in np.flatnonzero(~self._followed):
            self._searched[self._own[k][self._count :]] = False

    def _trials(self, points: Array) -> tuple[list[Array], list[NDArray[np.bool_]]]:
        """Return errors as `_simulated`, near to where `_errors_at` looked last.

        Hidden vibrations correct them as there. What they miss by their time steps changes along a
        step as the derivatives say.

        Args:
            points: Of all runs, shape (B, all coordinates).
        """
        errors, good = self._simulated([points] * len(self._runs))
        there = self._correction
        trials = [each + more for each, more in zip(errors, there.errors, strict=True)]
        if self._finer is not None:
            moves = points - there.at
            for each, own, change in zip(trials, self._own, self._finer, strict=True):
                each += np.einsum("nci,bi->bnc", change, moves[:, own])
        return trials, good

    def _jacobians(self, at: Array, *, coarse: bool, starts: bool = False) -> list[Array]:
        """Return the derivatives of each run's errors (K, 6) by what it depends on, (K, 6, p).

        With `starts` those by the robot are left at 0.

        Coarse ones come from longer time steps: half the work, and the same within a percent or so.
        That leads to where the search ends within a sigma, and exact ones lead to its end. Where
        steps are as long as a sway allows, longer ones would miss the cables' stiffness altogether.
        Exact ones are there of vanishing time steps, as errors are: parameters that nearly make up
        for each other show by less than a hundredth of what each of them does.
        """
        robot = self._searched[: self._count].any() and not starts
        searched = self._searched.copy()
        searched[: self._count] &= not starts
        alike = robot and self._told_by_alike(searched)
        ratio = COARSE_STEP_RATIO if coarse and not self._sways else 1.0
        jacobians = self._slopes(at, searched, ratio * self._time_step)
        if self._sways and not coarse:
            more = self._told_by_finer_steps(at, searched, jacobians)
            jacobians = [each + own for each, own in zip(jacobians, more, strict=True)]
        if alike:
            self._fill_alike(jacobians)
        return jacobians

    def _told_by_alike(self, searched: NDArray[np.bool_]) -> bool:
        """Say whether derivatives by the mass follow from others; if so, it is not differenced.

        All forces and masses by one factor give the same motion. As a difference derivatives by the
        mass would be wrong by a thousandth of themselves, and many recordings would seem to tell
        that factor.
        """
        if not self._many or self._unknowns.alike is None or not searched[self._mass]:
            return False
        searched[self._mass] = False
        return True

    def _fill_alike(self, jacobians: Sequence[Array]) -> None:
        """Fill in derivatives by the mass: all forces and masses by one factor change nothing."""
        alike = self._unknowns.alike
        assert alike is not None
        for each in jacobians:
            each[:, :, self._mass] = -each[:, :, : self._count] @ alike / alike[self._mass]

    def _told_by_finer_steps(
        self, at: Array, searched: NDArray[np.bool_], rough: Sequence[Array]
    ) -> list[Array]:
        """Return what derivatives of vanishing time steps have beyond rough ones.

        It is found once: what the search changes there is of second order.
        """
        if self._finer is None:
            fine = self._slopes(at, searched, self._time_step, refined=2)
            self._finer = [4.0 / 3.0 * (a - b) for a, b in zip(fine, rough, strict=True)]
        return self._finer

    def _linearized(self, at: Array, hessian: Array) -> tuple[list[Array], list[Array]]:
        """Return errors (K, 6) and derivatives (K, 6, p) of each run, over what is uncertain.

        Time steps change them as they do at `at`: what they change along a move is more rugged than
        motion itself.

        Args:
            at: All coordinates.
            hessian: Of the cost.

        Raises:
            CarosacError: One of the robots does not move.
        """
        here = self._errors_at(at)
        searched = self._searched.copy()
        alike = self._told_by_alike(searched)
        axes, lower = axes_of_robot(hessian, searched, self._count), self._lower - at
        covariance = np.asarray(np.linalg.inv(hessian), float)
        varied = self._varied(searched)
        moves = [
            scattered_moves(axes, hessian, covariance, self._count, rows, lower, seed=k)
            if len(rows)
            else np.zeros((1, 0))
            for k, rows in enumerate(varied)
        ]
        points = [np.tile(at, (len(each), 1)) for each in moves]
        for each, rows, move in zip(points, varied, moves, strict=True):
            each[:, rows] += move
        found, good = self._simulated(points)
        if not all(each.all() for each in good):
            raise CarosacError("identification: no finite motion of a robot that fits as well")
        kept = self._kept
        bent = bent_coordinate(
            [moves[k] for k in kept], [found[k] for k in kept],
            int((varied[kept[0]] < self._count).sum()), self._noise(here).sigma,
        )  # fmt: skip
        errors, jacobians, self._linear = [], [], []
        for k, (rows, move, more) in enumerate(
            zip(varied, moves, self._correction.errors, strict=True)
        ):
            linear = (
                Linearization.of(move, found[k], bent)
                if len(rows)
                else Linearization.nowhere(here[k] - more)
            )
            errors.append(linear.mean + more)
            jacobians.append(self._simulator.by_coordinates(k, rows, linear.slopes))
            self._linear.append(linear)
        self._rises = self._rises_of(here, errors)
        if alike:
            self._fill_alike(jacobians)
        return errors, jacobians

    def _rises_of(self, here: Sequence[Array], errors: Sequence[Array]) -> Array:
        """Return by how much mean errors over what is uncertain cost more, of each run.

        Of motion that is linear they are those where the search stands.

        Args:
            here: Errors of each run (K, 6), where the search stands.
            errors: Mean ones.
        """
        noise = self._noise(here)
        return np.array([
            noise.cost(mean) - noise.cost(error) for mean, error in zip(errors, here, strict=True)
        ])  # fmt: skip

    def _hidden_vibrations(self, at: Array, sigma: Array) -> list[HiddenVibrations]:
        """Return what vibrations that noise hides change of each run, as `hidden_vibrations`.

        The cables that vibrate are as stiff, and damp as much, as the vibrations of all runs show.
        They are searched from those of the robot; from the second time on, from those within three
        sigmas of it that explain most of the vibrations. Nothing is hidden in a run that is left
        out, that is not averaged, or whose start has vibrations as unknowns.

        Args:
            at: All coordinates, shape (p,).
            sigma: How far off those of the robot may be, shape (k,).
        """
        hidden = [
            HiddenVibrations.none(run.seen(np.zeros((len(run.poses.time), 6))))
            for run in self._runs
        ]
        which = [
            k
            for k in self._kept
            if self._runs[k].window and not len(self._runs[k].sway.stretch_sigma)
        ]
        runs = [self._whole[k] for k in which]
        robot = at[: self._count]
        if self._hidden is not None:
            cables = as_vibrating(self._unknowns, runs, robot, sigma)
            robot = robot if cables is None else cables
        found = hidden_vibrations(
            self._simulator,
            runs,
            [self._runs[k] for k in which],
            [np.concatenate([robot, at[self._own[k][self._count :]]]) for k in which],
            self._unknowns.robot_at(robot),
            cable_ways(self._unknowns, robot, sigma),
            self._time_step,
            None if self._hidden is None else [self._hidden[k] for k in which],
        )
        for k, each in zip(which, found, strict=True):
            hidden[k] = each
        return hidden

    def _likelier_vibrations(self, at: Array, sigma: Array) -> list[HiddenVibrations]:
        """Return hidden vibrations found anew, or those before if runs cost less with them.

        Where vibrations are strong, other cables explain them that fit what is slow far worse.

        Args:
            at: As of `_hidden_vibrations`.
            sigma: The same.
        """
        anew = self._hidden_vibrations(at, sigma)
        before = self._hidden
        if before is None:
            return anew
        errors = self._errors_at(at)
        noise = self._noise(errors)
        self._hidden = anew
        better = self._cost(at, self._errors_at(at), noise) < self._cost(at, errors, noise)
        self._hidden = before
        return anew if better else before

    def _doubted(
        self, errors: Sequence[Array], jacobians: Sequence[Array], noise: PoseErrorNoise
    ) -> Doubts | None:
        """Return what errors have in common beside noise; None: that was not looked at.

        Vibrations that noise hides change them, and what linear functions leave out.
        """
        if self._hidden is None and self._linear is None:
            return None
        columns = [np.zeros((each.size, 0)) for each in errors]
        for more in (
            [each.spread for each in self._hidden or ()],
            [each.beyond for each in self._linear or ()],
        ):
            if more:
                columns = [np.hstack(both) for both in zip(columns, more, strict=True)]
        return self._beside_starts(columns, errors, jacobians, noise)

    def _beside_starts(
        self,
        columns: Sequence[Array],
        errors: Sequence[Array],
        jacobians: Sequence[Array],
        noise: PoseErrorNoise,
    ) -> Doubts:
        """Return what the start of each run does not make up for of columns (6 K, d)."""
        return Doubts.beside_starts(
            columns,
            [
                each.reshape(len(own), -1)[:, self._count :]
                for each, own in zip(jacobians, columns, strict=True)
            ],
            [noise.weights(each).ravel() for each in errors],
        )

    def _varied(self, searched: NDArray[np.bool_]) -> list[NDArray[np.int64]]:
        """Return by which coordinates each run is differenced."""
        return [
            own[searched[own] & followed]
            for own, followed in zip(self._own, self._followed, strict=True)
        ]

    def _simulated(
        self, points: Sequence[Array], *, refined: int = 1
    ) -> tuple[list[Array], list[NDArray[np.bool_]]]:
        """Simulate all runs, as `RunSimulator.errors`."""
        return self._simulator.errors(self._runs, points, self._time_step, refined=refined)

    def _slopes(
        self, at: Array, searched: NDArray[np.bool_], time_step: float, *, refined: int = 1
    ) -> list[Array]:
        """Return differences of errors over short changes of one coordinate each, (K, 6, p) a run.

        Args:
            at: All coordinates.
            searched: By which of them.
            time_step: At most [s].
            refined: Steps that each of these is divided into.
        """
        size = STEP_OF_MANY if self._many else FINITE_DIFFERENCE_STEP
        return self._simulator.slopes(
            self._runs, at, self._varied(searched), size=size, time_step=time_step, refined=refined
        )

    def _normal(
        self, errors: Sequence[Array], jacobians: Sequence[Array], noise: PoseErrorNoise
    ) -> tuple[Array, Array]:
        """Return the information of the recordings, and half the derivative of their cost."""
        information, gradient = np.zeros_like(self._prior), np.zeros(len(self._first))
        judge = self._by(noise)
        for k in self._kept:
            own, error = self._own[k], errors[k]
            flat = jacobians[k].reshape(-1, len(own))
            information[np.ix_(own, own)] += judge.product(k, error, flat, flat)
            gradient[own] += judge.product(k, error, flat, error.reshape(-1, 1))[:, 0]
        return information, gradient

    def _known_about(self, at: Array) -> Quadratic:
        """Return the cost of what is known beside the recordings, about coordinates."""
        pull, information = np.asarray(self._prior @ at), self._prior
        cost = float(at @ pull)
        if self._frequencies is not None:
            told, robot = self._frequencies.about(at[: self._count]), slice(self._count)
            information = information.copy()
            information[robot, robot] += told.information
            pull[robot] += told.gradient
            cost += told.cost
        return Quadratic(cost=cost, gradient=pull, information=information)

    @property
    def _precision(self) -> Array:
        """Information of what is known beside the recordings."""
        return self._known.information

    def _by(self, noise: PoseErrorNoise) -> Judge:
        """Return by which errors count, with noise of each."""
        return Judge(noise=noise, doubts=self._doubts)

    @property
    def _kept(self) -> list[int]:
        """Which runs are not left out."""
        return [k for k, followed in enumerate(self._followed) if followed]

    def _noise(self, errors: Sequence[Array]) -> PoseErrorNoise:
        """Return the noise of errors of each run (K, 6)."""
        return estimate_noise([errors[k] for k in self._kept], apart=self._many)

    def _cost(self, at: Array, errors: Sequence[Array], noise: PoseErrorNoise) -> float:
        """Return the cost of errors of all runs, with all else that is known."""
        data = sum(self._cost_of(k, errors[k], noise) for k in self._kept)
        if self._frequencies is not None:
            data += self._frequencies.cost(at[: self._count])
        return float(data + at @ self._prior @ at)

    def _cost_of(self, k: int, errors: Array, noise: PoseErrorNoise) -> float:
        """Return the cost of errors (K, 6) of a run."""
        return self._by(noise).cost(k, errors)

    def _cost_with_start(self, k: int, at: Array, errors: Array, noise: PoseErrorNoise) -> float:
        """Return the cost of errors (K, 6) of a run, with what is known of its start."""
        start = at[self._own[k][self._count :]]
        return self._cost_of(k, errors, noise) + float(start @ start)

    def _search(
        self,
        at: Array,
        hessian: Array,
        gradient: Array,
        errors: list[Array],
        noise: PoseErrorNoise,
        damping: float,
        least: float,
    ) -> Step:
        """Search a Levenberg-Marquardt step that lowers the cost by more than the `least` decrease.

        It gives up once steps are damped so much that none promises more; the best that was found
        counts then.

        Returns:
            Where it leads, `at` itself where none helps; the damping to begin with next time.
        """
        lowest, here = self._cost(at, errors, noise), self._correction
        best, there = Step(at=at, errors=errors, cost=lowest), here
        for tried in range(DAMPING_TRIES_MAX):
            step = self._step(at, hessian, gradient, damping)
            if self._sways:
                ways = [self._promise(each * step, hessian, gradient) for each in SWAY_STRETCHES]
                if tried and max(ways) <= least:
                    break
                points, trials, good = self._follow(at, step, hessian, gradient, noise)
            else:
                points = np.array([self._moved(at, stretch * step) for stretch in STRETCHES])
                trials, good = self._trials(points)
            costs = [
                self._cost(point, [each[k] for each in trials], noise)
                if all(each[k] for each in good)
                else np.inf
                for k, point in enumerate(points)
            ]
            found = self._best(points, trials, costs, noise)
            if found is not None and found.cost < lowest:
                found = self._exactly(found, noise)
                if found.cost < best.cost:
                    best = replace(
                        found, damping=max(damping / 8.0, 1e-6), decrease=lowest - found.cost
                    )
                    there = self._correction
                self._correction = here
                if best.decrease > least:
                    break
            damping = max(DAMPING_GROWTH * damping, DAMPING_START)
        self._correction = there
        return best

    def _exactly(self, step: Step, noise: PoseErrorNoise) -> Step:
        """Return a step with errors of vanishing time steps, where `_exact`.

        Where a long step leads, time steps change the first motion by another amount than where it
        began: the starts follow that too.
        """
        if not self._exact:
            return step
        try:
            end = self._exact_end(step, step.at, noise)
        except CarosacError:  # shorter time steps have no finite motion
            return replace(step, cost=np.inf)
        there = self._correction
        if self._starts_follow:
            with suppress(CarosacError):  # starts that follow may have none
                at, _ = self._restarted(end.at, end.errors, noise)
                followed = self._exact_end(step, at, noise)
                if followed.cost < end.cost:
                    return followed
        self._correction = there
        return end

    def _exact_end(self, step: Step, at: Array, noise: PoseErrorNoise) -> Step:
        """Return a step that ends there, with errors of vanishing time steps."""
        errors = self._errors_at(at)
        return replace(step, at=at, errors=errors, cost=self._cost(at, errors, noise))

    def _follow(
        self, at: Array, step: Array, hessian: Array, gradient: Array, noise: PoseErrorNoise
    ) -> tuple[Array, list[Array], list[NDArray[np.bool_]]]:
        """Return where stretches of a step lead, with the errors there.

        Each start follows as far as suits it: one of which little is known would go far, and spoil
        the step for all.
        """
        robot = step[: self._count]
        steps = np.tile(step, (len(START_TRIES), 1))
        for k in self._kept:
            rows = self._own[k][self._count :]
            pull = gradient[rows] + hessian[rows, : self._count] @ robot
            for row, each in zip(steps, _tries(hessian[np.ix_(rows, rows)], pull), strict=True):
                row[rows] = each
        ways = np.array([
            [self._moved(at, stretch * each) for each in steps] for stretch in SWAY_STRETCHES
        ])  # fmt: skip
        errors, sound = self._trials(ways.reshape(-1, len(at)))
        points = ways[:, 0].copy()
        trials, good = [], []
        for k, (each, exists) in enumerate(zip(errors, sound, strict=True)):
            rows = self._own[k][self._count :]
            costs = np.array([
                self._cost_with_start(k, way, error, noise) if fine else np.inf
                for error, way, fine in zip(each, ways.reshape(-1, len(at)), exists, strict=True)
            ]).reshape(ways.shape[:2])  # fmt: skip
            best = np.argmin(costs, axis=1)
            stretch = np.arange(len(best))
            points[:, rows] = ways[stretch, best][:, rows]
            trials.append(each.reshape(*costs.shape, *each.shape[1:])[stretch, best])
            good.append(np.isfinite(costs[stretch, best]))
        return points, trials, good

    def _best(
        self, points: Array, trials: list[Array], costs: list[float], noise: PoseErrorNoise
    ) -> Step | None:
        """Return where the best of some stretches of a step leads, or None.

        The first motion follows a change of the robot far from linearly. Where only the sway
        counts, a step is judged once the starts have followed: until then a long one that leads to
        the robot looks worse than a short one.
        """
        ends: list[Step] = []
        for k in np.argsort(costs):
            if not np.isfinite(costs[k]):
                break
            point, found = points[k], [each[k] for each in trials]
            if self._starts_follow:
                point, found = self._restarted(point, found, noise)
            ends.append(Step(at=point, errors=found, cost=self._cost(point, found, noise)))
            if not self._sways:
                break
        return min(ends, key=lambda end: end.cost, default=None)

    def _started(self, at: Array, shares: Sequence[float] = POSE_SHARES[:1]) -> Array:
        """Return where a search begins; each run that starts before its poses does as suits it.

        The first guess of such a start is rough: the first poses mend it, and one that swings
        further, before all is searched. Beside a robot that is nearly found, more of them do.
        """
        if not self._sways:
            return at
        whole = self._runs
        robot, starts = np.split(at, [self._count])
        guesses = [np.concatenate([robot, growth * starts]) for growth in GUESS_GROWTHS]
        for share in shares:
            self._runs = tuple(run.first(share) for run in whole)
            ends = [self._suited(guesses[0])]
            for further in guesses[1:]:
                with suppress(CarosacError):  # one that swings so far may have no finite motion
                    ends.append(self._suited(further))
            at = self._likeliest(ends)
            guesses = [at]
        self._runs = whole
        return at

    def _likeliest(self, ends: Sequence[Array]) -> Array:
        """Return all coordinates, with that start of each run which suits it best of some."""
        best = ends[0].copy()
        if len(ends) == 1:
            return best
        errors = [self._errors_at(end) for end in ends]
        noise = self._noise(errors[0])
        for k, rows in enumerate(self._own):
            own = rows[self._count :]
            costs = [
                self._cost_with_start(k, end, each[k], noise)
                for end, each in zip(ends, errors, strict=True)
            ]
            best[own] = ends[int(np.argmin(costs))][own]
        return best

    def _suited(self, at: Array) -> Array:
        """Let runs start as suits the robot."""
        least = SETTLED_DECREASE * (len(at) - self._count)
        errors = self._errors_at(at)
        for _ in range(STARTS_STEPS_MAX):
            noise = self._noise(errors)
            before = self._cost(at, errors, noise)
            at, errors = self._restarted(at, errors, noise, GUESS_TRIES)
            if before - self._cost(at, errors, noise) <= least:
                break
        return at

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
            new[self._own[k][self._count :]] = start
        found = self._errors_at(new)
        point = at.copy()
        for k in lost:
            rows = self._own[k][self._count :]
            if noise.cost(found[k]) < noise.cost(errors[k]):
                point[rows] = new[rows]
        return point, self._errors_at(point)

    def _sought(self, at: Array, which: Sequence[int]) -> tuple[Array, ...]:
        """Return starts of some runs beside the robot, by all poses, also those that lead."""
        return self._beside(at, [self._whole[k] for k in which]).starts()

    def _beside(self, at: Array, runs: Sequence[FittedRun]) -> Fitter:
        """Return a search for the starts of some runs beside the robot of coordinates."""
        return Fitter(self._unknowns, runs, self._settings, robot_at=at[: self._count])

    def _restarted(
        self,
        at: Array,
        errors: list[Array],
        noise: PoseErrorNoise,
        tries: Sequence[tuple[float, float]] = START_TRIES,
    ) -> tuple[Array, list[Array]]:
        """Let each run start as suits the robot where a step led, if that lowers its cost.

        The first motion follows a change of the robot far from linearly: a step that the starts
        have not followed yet looks worse than where it leads.
        """
        jacobians = self._jacobians(at, coarse=True, starts=True)
        own = [rows[self._count :] for rows in self._own]
        trial = np.tile(at, (len(tries), 1))
        for k in self._kept:
            slopes = jacobians[k][:, :, self._count :]
            fold = self._with_start(k, at, self._fold(k, self._by(noise), errors[k], slopes))
            steps = _tries(fold.information, fold.gradient, tries)
            trial[:, own[k]] += np.array(steps).reshape(len(trial), len(own[k]))
        trials, good = self._trials(trial)
        point, found = at.copy(), list(errors)
        for k in self._kept:
            rows = own[k]
            lowest = self._cost_with_start(k, at, errors[k], noise)
            for each, error, sound in zip(trial, trials[k], good[k], strict=True):
                cost = self._cost_with_start(k, each, error, noise)
                if sound and cost < lowest:
                    lowest, point[rows], found[k] = cost, each[rows], error
        return point, found

    def _promise(self, step: Array, hessian: Array, gradient: Array) -> float:
        """Return by how much a step would lower a quadratic cost.

        Of many recordings, beyond what their starts alone would, which follow the robot: each has
        some of its own.
        """
        if not (self._many and self._searched[: self._count].any()):
            return float(-(2.0 * gradient + hessian @ step) @ step)
        rows = np.flatnonzero(self._searched)
        robot = rows[rows < self._count]
        cost = Quadratic(cost=0.0, gradient=gradient[rows], information=hessian[np.ix_(rows, rows)])
        apart = cost.least_beside(len(robot))
        return apart.cost - apart.at(step[robot])

    def _step(self, at: Array, hessian: Array, gradient: Array, damping: float) -> Array:
        """Return a damped step."""
        damped = hessian + damping * np.diag(np.diag(hessian))
        return self._bounded(at, damped, gradient, STEP_MAX_SIGMAS * self._sigma)

    def _bounded(
        self, at: Array, hessian: Array, gradient: Array, reach: Array | float = np.inf
    ) -> Array:
        """Return the step to the least of a quadratic cost that keeps coordinates in their bounds.

        None moves by more than its `reach`.
        """
        free = self._searched
        cost = Quadratic(cost=0.0, gradient=gradient[free], information=hessian[np.ix_(free, free)])
        lower = np.maximum(self._lower - at, -reach)
        upper = np.broadcast_to(reach, at.shape)
        step = np.zeros(len(at))
        step[free] = cost.least_within(lower[free], upper[free])
        return step

    def _moved(self, at: Array, step: Array) -> Array:
        """Return the end of a step; coordinates that would leave their bound stay on it."""
        moved = at + step
        own = slice(self._count)
        moved[own] = self._unknowns.moved(at[own], step[own])
        return np.asarray(np.maximum(moved, self._lower))


def _tries(
    hessian: Array, gradient: Array, tries: Sequence[tuple[float, float]] = START_TRIES
) -> list[Array]:
    """Return steps (p,) of a start to try."""
    diagonal = np.diag(np.diag(hessian))
    return [
        np.asarray(-share * np.linalg.solve(hessian + damping * diagonal, gradient), float)
        for share, damping in tries
    ]


def _rms(errors: Array) -> tuple[float, float]:
    """Return the RMS distance [m] and angle [rad] of errors (K, 6)."""
    power = (errors**2).mean(axis=0)
    return float(np.sqrt(power[:3].sum())), float(np.sqrt(power[3:].sum()))
