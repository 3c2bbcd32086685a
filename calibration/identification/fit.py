"""Gauss-Newton on coordinates of a robot; one batch of worlds a run gives errors and Jacobian."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from calibration.identification.error_noise import (
    RUNS_APART_MIN,
    PoseErrorNoise,
    estimate_noise,
)
from calibration.identification.open_loop import OpenLoopRun, OpenLoopStart, simulate_runs
from calibration.identification.runs import FittedRun
from calibration.identification.settings import IdentificationSettings
from calibration.identification.unknowns import Coordinates
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.robot.robot import Robot

FINITE_DIFFERENCE_STEP = 0.005  # of the coordinates, for differences
# The same of many recordings, which tell more: over longer ones motion is less linear, and over
# shorter ones its jumps count for more.
STEP_OF_MANY = 5e-4
MANY_STEP_RATIO = 1.0 / 3.0  # of the time steps where many recordings show what the others hide
# Squared sigmas by which a step must promise to lower the cost: for each coordinate of the robot
# where many recordings tell their sigmas, otherwise for each axis that counts.
SETTLED_DECREASE = 0.1
PART_DECREASE = 1.0  # the same of many recordings, with only a part of the poses
POSE_SHARES = (
    0.15,
    0.4,
    1.0,
)  # of the poses, from the first: later ones would be out of phase at first
SHARES_OF_MANY = (0.04, 0.12, 0.35, 1.0)  # of those of many recordings, which may begin with a jolt
STEPS_PER_SHARE = 4  # for each share but the last
NOISE_UPDATES_MAX = 6  # steps after which the noise is no longer estimated anew
SCORE_STRETCH_S = 5.0  # [s]
CORRELATED_AXES = 6.0  # axes that count as one in few recordings: one swing shows in all of them
COARSE_STEP_RATIO = 2.0  # of the simulator's time steps, for coarse derivatives and for errors
STRETCHES = (1.0, 2.0, 4.0)  # of a step, of which the best is taken: weights that fall with errors
# make steps too short
# The same where only the sway counts: parameters that nearly make up for each other are a long way
# from linear there.
SWAY_STRETCHES = (0.3, 1.0, 2.0)
START_STRETCHES = (1.0, 0.4, 0.1)  # of a step of the starts alone, of which the best is taken
STARTS_STEPS_MAX = 8  # of the starts alone, before the robot is searched
STEP_MAX_SIGMAS = 2.0  # prior sigmas that a coordinate may move in one step
DAMPING_START = 1e-3  # of the Hessian's diagonal, to begin with
DAMPING_TRIES_MAX = 9  # dampings that are tried before a search gives up
ProgressCallback = Callable[[int, float, float], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class CoordinateFit:
    """Coordinates that fit best.

    Attributes:
        coordinates: shape (k,).
        covariance: shape (k, k); the unknown start is taken into account.
        information: Fisher information of the data alone, shape (k, k), less what the unknown start
            takes from it.
        starts: Coordinates of the sway at the start of each run, shape (2 m,).
        excess: Factor by which the data count for less than independent innovations [1].
        iterations: Steps taken.
        converged: True if the last step promised little, or brought little.
    """

    coordinates: Array
    covariance: Array
    information: Array
    starts: tuple[Array, ...]
    excess: float
    iterations: int
    converged: bool


class Fitter:
    """The search for the robot that moves as measured."""

    def __init__(
        self,
        unknowns: Coordinates,
        runs: Sequence[FittedRun],
        settings: IdentificationSettings,
        *,
        robot_at: Array | None = None,
    ) -> None:
        """Take the data.

        Args:
            unknowns: k coordinates of the robot, beside which the start of each run is unknown.
            runs: Recordings.
            settings: Settings of the computation.
            robot_at: Coordinates (k,) at which the robot is held, so that only the starts of the
                runs are searched; None: they are searched too.
        """
        self._unknowns = unknowns
        self._runs = tuple(runs)
        self._settings = settings
        self._many = len(self._runs) >= RUNS_APART_MIN
        self._axes = 1.0 if self._many else CORRELATED_AXES  # that count as one
        alone = robot_at is not None  # few are searched as the many were that told the robot
        self._sways = (self._many or alone) and all(run.window for run in self._runs)
        vibrates = self._many and not self._sways
        self._time_step = settings.time_step * (MANY_STEP_RATIO if vibrates else 1.0)
        self._count = len(unknowns.prior.names)
        sizes = [len(run.sway.guess) for run in runs]
        edges = self._count + np.cumsum([0, *sizes])
        self._own = [
            np.concatenate([np.arange(self._count), np.arange(a, b)]) for a, b in pairwise(edges)
        ]  # rows of the coordinates that each run depends on
        loose = sum(sizes)
        self._names = [*unknowns.prior.names, *(name for run in runs for name in run.sway.names)]
        self._mass = self._names.index("mass") if "mass" in self._names else -1
        self._sigma = np.concatenate([unknowns.prior.sigma, np.ones(loose)])
        self._lower = np.concatenate([unknowns.lower, np.full(loose, -np.inf)])
        self._precision = block_diag(unknowns.prior.information, np.eye(loose))
        self._first = np.concatenate(
            [unknowns.prior.mean if robot_at is None else robot_at]
            + [run.sway.guess for run in runs]
        )
        self._finer: list[Array] | None = None  # what time steps make derivatives wrong by
        self._searched = np.ones(len(self._first), dtype=np.bool_)
        self._searched[: self._count] = robot_at is None

    def run(self, report: ProgressCallback) -> CoordinateFit:
        """Search.

        Args:
            report: Called before each step with the number of poses that it looks at, and their
                RMS errors [m] and [rad].

        Raises:
            CarosacError: The robot's simulation fails where the search stands.
        """
        return self._settled(self._approached(report), report)

    def approach(self, report: ProgressCallback) -> Array:
        """Search as far as a part of the poses leads; return the coordinates (k,) there.

        Args:
            report: As of `run`.
        """
        return self._approached(report)[: self._count]

    def finish(self, coordinates: Array, report: ProgressCallback) -> CoordinateFit:
        """Search with all poses from coordinates (k,) to which `approach` led; see `run`."""
        first = np.concatenate([coordinates, self._first[self._count :]])
        return self._settled(self._started(first, POSE_SHARES[:-1]), report)

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
        self._runs = tuple(run.first(1.0) for run in self._runs)
        state = self._settle(at, None, report)
        at = state.at
        noise = estimate_noise(state.errors)
        information, _ = self._normal(at, state.errors, state.jacobians, noise)
        inverse = np.linalg.inv(information + self._precision)
        excess = self._excess(state, noise, information, inverse)
        own = slice(self._count)
        scores = self._axes * excess * information  # as they vary, beside the prior
        root = inverse @ np.linalg.cholesky(scores + self._precision)
        covariance = root @ root.T  # rounding leaves the product of three too asymmetric
        information /= self._axes * excess
        return CoordinateFit(
            coordinates=at[own],
            covariance=np.asarray(covariance[own, own], float),
            information=self._marginal(information),
            starts=self._starts(at),
            excess=excess,
            iterations=state.count,
            converged=state.settled,
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

    def _settle(self, at: Array, steps: int | None, report: ProgressCallback) -> _Search:
        """Search from somewhere, for some steps or to the end."""
        damping, settled = DAMPING_START, False
        alone = not self._searched[: self._count].any()  # starts: exact ones cost little more
        coarse = steps is not None or not (self._sways and alone)
        errors = self._errors_at(at)
        share = PART_DECREASE if steps and self._many else SETTLED_DECREASE
        least = share * (self._count if self._many else self._axes)
        for count in range(1, (steps or self._settings.iterations) + 1):
            final = steps is not None or not coarse  # it may end with these derivatives
            jacobians = self._jacobians(at, coarse=coarse)
            if count <= NOISE_UPDATES_MAX:
                noise = estimate_noise(errors)
            poses = sum(len(run.poses.time) for run in self._runs)
            report(poses, *_rms(np.concatenate(errors)))
            information, gradient = self._normal(at, errors, jacobians, noise)
            hessian = information + self._precision
            settled = self._promise(at, hessian, gradient) <= least
            stuck = False
            if not settled or (self._sways and not coarse):  # by exact derivatives, a last one too
                step = self._search(at, hessian, gradient, errors, noise, damping)
                stuck = not settled and step.decrease <= least
                settled = settled or (not coarse and 0.0 < step.decrease <= least)
                at, errors, damping = step.at, step.errors, step.damping
            ended = settled or stuck
            if ended and final:
                break
            if ended or (self._sways and steps is None):  # a step of sways by coarse ones will do
                coarse = False
        settled &= final
        return _Search(at=at, errors=errors, jacobians=jacobians, count=count, settled=settled)

    def _excess(
        self, state: _Search, noise: PoseErrorNoise, information: Array, inverse: Array
    ) -> float:
        """Return by how much scores vary more than independent ones.

        `inverse` is that of the information with the prior.

        Many recordings tell it by themselves: one is independent of the others. Their errors are
        smaller than noise by what was fitted to them. In a few, scores of long stretches tell what
        lasts for less than these; what lasts longer shows in all axes.
        """
        sums = []
        for run, own, errors, jacobian in zip(
            self._runs, self._own, state.errors, state.jacobians, strict=True
        ):
            scores = np.einsum("nci,nc->ni", jacobian, noise.weights(errors) * errors)
            time = run.poses.time
            length = max(1, int(np.searchsorted(time, time[0] + SCORE_STRETCH_S)))
            edges = np.arange(0, len(scores), len(scores) if self._many else length)
            parts = np.add.reduceat(scores, edges, axis=0)
            whole = np.zeros((len(parts), len(information)))
            whole[:, own] = parts
            sums.append(whole)
        stretches = np.concatenate(sums)
        fitted = float(np.trace(inverse @ information))  # parameters that the data tell
        if self._many:  # the score of each start has vanished with its run
            left, shared = self._marginal(information), stretches[:, : self._count]
            known = np.linalg.inv(left + self._precision[: self._count, : self._count])
            spread = float(np.einsum("bi,ij,bj->", shared, known, shared))
            count, total = len(stretches), sum(each.size for each in state.errors)
            least = total / max(total - fitted, 1.0)
            return max(least, spread * count / (count - 1) / float(np.trace(known @ left)))
        spread = float(np.einsum("bi,ij,bj->", stretches, inverse, stretches))
        return max(1.0, spread / fitted)

    def _errors_at(self, at: Array) -> list[Array]:
        """Return the errors of each run (K, 6)."""
        errors, good = self._errors([at[None]] * len(self._runs))
        if not all(each.all() for each in good):
            raise CarosacError("identification: no finite motion of the robot")
        return [each[0] for each in errors]

    def _errors(self, points: Sequence[Array]) -> tuple[list[Array], list[NDArray[np.bool_]]]:
        """Return errors as `_simulated`, of vanishing time steps where only the sway counts.

        Many recordings tell frequencies better than time steps do that are short enough for a sway.
        What these are wrong by falls with their square (Richardson).
        """
        errors, good = self._simulated(points, self._time_step)
        if not self._sways:
            return errors, good
        fine, sound = self._simulated(points, self._time_step, refined=2)
        errors = [best + (best - each) / 3.0 for best, each in zip(fine, errors, strict=True)]
        return errors, [one & other for one, other in zip(good, sound, strict=True)]

    def _simulated(
        self, points: Sequence[Array], time_step: float, *, refined: int = 1
    ) -> tuple[list[Array], list[NDArray[np.bool_]]]:
        """Simulate robots at coordinates, for each run of its own.

        Args:
            points: Of each run, shape (B, all coordinates).
            time_step: At most [s].
            refined: Steps that each of these is divided into.

        Returns:
            Of each run: errors (B, K, 6), and which robots exist and have a finite motion (B,).
        """
        known: dict[bytes, Robot | None] = {}
        jobs, exists = [], []
        for run, own, each in zip(self._runs, self._own, points, strict=True):
            robots = [self._robot(point[: self._count], known) for point in each]
            exists.append(np.array([robot is not None for robot in robots]))
            start = OpenLoopStart(sway=run.sway, coordinates=each[:, own[self._count :]])
            jobs.append(
                OpenLoopRun(
                    robots=[robot or self._unknowns.robot for robot in robots],
                    path=run.path,
                    time=run.poses.time,
                    start=start,
                )
            )
        errors = []
        for k, motion in enumerate(simulate_runs(jobs, time_step=time_step, refined=refined)):
            seen = motion.seen_by(self._unknowns.robot, jobs[k].robots)
            exists[k] &= ~motion.failed
            run = self._runs[k]
            errors.append(
                np.array([
                    run.seen(run.poses.errors(seen.position[:, b], seen.rotation[:, b]))
                    for b in range(len(points[k]))
                ])
            )  # fmt: skip
        return errors, exists

    def _robot(self, coordinates: Array, known: dict[bytes, Robot | None]) -> Robot | None:
        """Return the robot of some coordinates (k,), made once; None where there is none."""
        key = coordinates.tobytes()
        if key not in known:
            try:
                known[key] = self._unknowns.robot_at(coordinates)
            except InvalidField:
                known[key] = None
        return known[key]

    def _jacobians(self, at: Array, *, coarse: bool, starts: bool = False) -> list[Array]:
        """Return the derivatives of each run's errors (K, 6) by what it depends on, (K, 6, p).

        With `starts` those by the robot are left at 0.

        Coarse ones come from longer time steps: half the work, and the same within a percent or so.
        That leads to where the search ends within a sigma, and exact ones lead to its end. Where
        steps are as long as a sway allows, longer ones would miss the cables' stiffness altogether.
        Exact ones are there of vanishing time steps, as errors are: parameters that nearly make up
        for each other show by less than a hundredth of what each of them does.

        All forces and masses by one factor give the same motion, so that those by the mass follow
        from the others. As a difference they would be wrong by a thousandth of themselves, and many
        recordings would seem to tell that factor.
        """
        searched = self._searched.copy()
        searched[: self._count] &= not starts
        alike = self._unknowns.alike if self._many and not starts else None
        if alike is not None and searched[self._mass]:
            searched[self._mass] = False
        else:
            alike = None
        ratio = COARSE_STEP_RATIO if coarse and not self._sways else 1.0
        jacobians = self._slopes(at, searched, ratio * self._time_step)
        if self._sways and not coarse:
            assert not starts, "what is kept is by all that is searched"
            if self._finer is None:  # once: what steps of the search change is of second order
                halved = self._slopes(at, searched, self._time_step, refined=2)
                self._finer = [
                    4.0 / 3.0 * (fine - rough)
                    for fine, rough in zip(halved, jacobians, strict=True)
                ]
            jacobians = [each + more for each, more in zip(jacobians, self._finer, strict=True)]
        if alike is not None:
            for each in jacobians:
                each[:, :, self._mass] = -each[:, :, : self._count] @ alike / alike[self._mass]
        return jacobians

    def _slopes(
        self, at: Array, searched: NDArray[np.bool_], time_step: float, *, refined: int = 1
    ) -> list[Array]:
        """Return differences of errors over their width.

        Args:
            at: All coordinates.
            searched: By which of them.
            time_step: At most [s].
            refined: Steps that each of these is divided into.

        Returns:
            Of each run, shape (K, 6, p).
        """
        step = STEP_OF_MANY if self._many else FINITE_DIFFERENCE_STEP
        varied = [own[searched[own]] for own in self._own]
        more = at + step * np.eye(len(at))  # bounds lie below
        points = [np.vstack([at[None], more[rows]]) for rows in varied]
        errors, good = self._simulated(points, time_step, refined=refined)
        jacobians = []
        for own, rows, each, sound in zip(self._own, varied, errors, good, strict=True):
            if not sound.all():
                row = int(np.argmin(sound)) - 1
                beside = "" if row < 0 else f" with another {self._names[rows[row]]}"
                raise CarosacError(f"identification: no finite motion of the robot{beside}")
            jacobian = np.zeros((*each.shape[1:], len(own)))
            jacobian[:, :, searched[own]] = np.moveaxis((each[1:] - each[0]) / step, 0, 2)
            jacobians.append(jacobian)
        return jacobians

    def _normal(
        self,
        at: Array,
        errors: Sequence[Array],
        jacobians: Sequence[Array],
        noise: PoseErrorNoise,
    ) -> tuple[Array, Array]:
        """Return the information of the data, and the gradient with the prior."""
        information = np.zeros_like(self._precision)
        gradient = self._precision @ at
        for own, error, jacobian in zip(self._own, errors, jacobians, strict=True):
            weights = noise.weights(error).reshape(-1, 1)
            flat = jacobian.reshape(-1, len(own))
            information[np.ix_(own, own)] += flat.T @ (weights * flat)
            gradient[own] += flat.T @ (weights[:, 0] * error.ravel())
        return information, gradient

    def _cost(self, at: Array, errors: Sequence[Array], noise: PoseErrorNoise) -> float:
        """Return the cost of errors of all runs, with the prior."""
        data = sum(noise.cost(each) for each in errors)
        return float(data + at @ self._precision @ at)

    def _search(
        self,
        at: Array,
        hessian: Array,
        gradient: Array,
        errors: list[Array],
        noise: PoseErrorNoise,
        damping: float,
    ) -> _Step:
        """Search a Levenberg-Marquardt step that lowers the cost.

        Returns:
            Where it leads, `at` itself where none helps; the damping to begin with next time.
        """
        lowest = self._cost(at, errors, noise)
        for _ in range(DAMPING_TRIES_MAX):
            step = self._step(at, hessian, gradient, damping)
            stretches = SWAY_STRETCHES if self._sways else STRETCHES
            points = np.array([self._moved(at, stretch * step) for stretch in stretches])
            trials, good = self._errors([points] * len(self._runs))
            costs = [
                self._cost(point, [each[k] for each in trials], noise)
                if all(each[k] for each in good)
                else np.inf
                for k, point in enumerate(points)
            ]
            best = int(np.argmin(costs))
            if np.isfinite(costs[best]):
                point, found = points[best], [each[best] for each in trials]
                if self._many and self._searched[: self._count].any():
                    point, found = self._restarted(point, found, noise)
                cost = self._cost(point, found, noise)
                if cost < lowest:
                    return _Step(
                        at=point,
                        errors=found,
                        damping=max(damping / 8.0, 1e-6),
                        decrease=lowest - cost,
                    )
            damping *= 5.0
        return _Step(at=at, errors=errors, damping=DAMPING_START, decrease=0.0)

    def _started(self, at: Array, shares: Sequence[float] = POSE_SHARES[:1]) -> Array:
        """Return where a search begins; each run that starts before its poses does as suits it.

        The first guess of such a start is rough: the first poses mend it, before all is searched.
        Beside a robot that is nearly found, more of them do.
        """
        if not self._sways:
            return at
        whole = self._runs
        least = SETTLED_DECREASE * (len(at) - self._count)
        for share in shares:
            self._runs = tuple(run.first(share) for run in whole)
            errors = self._errors_at(at)
            for _ in range(STARTS_STEPS_MAX):
                noise = estimate_noise(errors)
                before = self._cost(at, errors, noise)
                at, errors = self._restarted(at, errors, noise)
                if before - self._cost(at, errors, noise) <= least:
                    break
        self._runs = whole
        return at

    def _restarted(
        self, at: Array, errors: list[Array], noise: PoseErrorNoise
    ) -> tuple[Array, list[Array]]:
        """Let each run start as suits the robot where a step led, if that lowers its cost.

        The first motion follows a change of the robot far from linearly: a step that the starts
        have not followed yet looks worse than where it leads.
        """
        jacobians = self._jacobians(at, coarse=True, starts=True)
        information, gradient = self._normal(at, errors, jacobians, noise)
        hessian = information + self._precision
        own = [rows[self._count :] for rows in self._own]
        trial = np.tile(at, (len(START_STRETCHES), 1))
        for rows in own:
            step = np.linalg.solve(hessian[np.ix_(rows, rows)], gradient[rows])
            trial[:, rows] -= np.outer(START_STRETCHES, step)
        trials, good = self._errors([trial] * len(self._runs))
        point, found = at.copy(), list(errors)
        for k, rows in enumerate(own):
            lowest = noise.cost(errors[k]) + float(at[rows] @ at[rows])
            for each, error, sound in zip(trial[:, rows], trials[k], good[k], strict=True):
                cost = noise.cost(error) + float(each @ each)
                if sound and cost < lowest:
                    lowest, point[rows], found[k] = cost, each, error
        return point, found

    def _promise(self, at: Array, hessian: Array, gradient: Array) -> float:
        """Return by how much a whole Gauss-Newton step would lower the cost."""
        step = self._bounded(at, hessian, gradient)
        return float(-(2.0 * gradient + hessian @ step) @ step)

    def _step(self, at: Array, hessian: Array, gradient: Array, damping: float) -> Array:
        """Return a damped step."""
        damped = hessian + damping * np.diag(np.diag(hessian))
        return self._bounded(at, damped, gradient, STEP_MAX_SIGMAS * self._sigma)

    def _bounded(
        self, at: Array, hessian: Array, gradient: Array, reach: Array | float = np.inf
    ) -> Array:
        """Return the step to the least of a quadratic cost that keeps coordinates in their bounds.

        None moves by more than its `reach`.

        Coordinates that would leave their bounds stop there, one set after another, and the others
        step as is best beside that.
        """
        lower, upper = np.maximum(self._lower - at, -reach), np.full(len(at), reach)
        step, free = np.zeros(len(at)), self._searched.copy()
        while free.any():
            pull = gradient[free] + hessian[np.ix_(free, ~free)] @ step[~free]
            step[free] = -np.linalg.solve(hessian[np.ix_(free, free)], pull)
            leaves = free & ((step < lower) | (step > upper))
            if not leaves.any():
                break
            step[leaves] = np.clip(step, lower, upper)[leaves]
            free &= ~leaves
        return step

    def _moved(self, at: Array, step: Array) -> Array:
        """Return the end of a step; coordinates that would leave their bound stay on it."""
        moved = at + step
        own = slice(self._count)
        moved[own] = self._unknowns.moved(at[own], step[own])
        return np.asarray(np.maximum(moved, self._lower))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Step:
    """End of a step.

    Attributes:
        at: All coordinates there.
        errors: Of each run, shape (K, 6).
        damping: To begin the next one with.
        decrease: Of the cost.
    """

    at: Array
    errors: list[Array]
    damping: float
    decrease: float


@dataclass(frozen=True, kw_only=True, eq=False)
class _Search:
    """End of a search.

    Attributes:
        at: All coordinates there.
        errors: Of each run, shape (K, 6).
        jacobians: Of each run, where the last step began, shape (K, 6, p).
        count: Steps.
        settled: True if the last one promised little, or brought little by exact derivatives.
    """

    at: Array
    errors: list[Array]
    jacobians: list[Array]
    count: int
    settled: bool


def _rms(errors: Array) -> tuple[float, float]:
    """Return the RMS distance [m] and angle [rad] of errors (K, 6)."""
    power = (errors**2).mean(axis=0)
    return float(np.sqrt(power[:3].sum())), float(np.sqrt(power[3:].sum()))
