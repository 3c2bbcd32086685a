"""Levenberg-Marquardt steps, of which each is judged once the starts of many runs have followed."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.identification.error_noise import PoseErrorNoise
from calibration.identification.fit_cost import FitCost
from calibration.identification.run_errors import RunErrors
from calibration.identification.search_space import SearchSpace
from calibration.identification.search_state import DAMPING_START, Step
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError

STRETCHES = (1.0, 2.0, 4.0)  # of a step, of which the best is taken: weights that fall with errors
# make steps too short
# The same where only the sway counts: parameters that nearly make up for each other are a long way
# from linear there.
SWAY_STRETCHES = (0.3, 1.0, 2.0)
# Shares of steps of a start alone, and how much they are damped, of the Hessian's diagonal; the
# best is taken. Two modes that sway nearly alike are hard to tell apart at first.
START_TRIES = ((1.0, 0.0), (0.4, 0.0), (1.0, 0.01), (1.0, 0.1))
DAMPING_TRIES_MAX = 7  # dampings that are tried before a search gives up
DAMPING_GROWTH = 10.0  # from one to the next


class StepSearch:
    """Searches the end of a step."""

    def __init__(self, space: SearchSpace, run_errors: RunErrors, cost: FitCost) -> None:
        """Take what is searched, what it misses, and what that costs."""
        self._space = space
        self._run_errors = run_errors
        self._cost = cost

    def search(
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

        Args:
            at: All coordinates, where `RunErrors.at` looked last.
            hessian: Of half the cost.
            gradient: Of it.
            errors: Of each run there (K, 6).
            noise: Of these.
            damping: To begin with, of the Hessian's diagonal.
            least: Decrease that is enough.

        Returns:
            Where it leads, `at` itself where none helps; the damping to begin with next time.
        """
        space = self._space
        lowest, here = self._cost.total(at, errors, noise), self._run_errors.correction
        best, there = Step(at=at, errors=errors, cost=lowest), here
        for tried in range(DAMPING_TRIES_MAX):
            step = space.step(at, hessian, gradient, damping)
            if self._run_errors.sways:
                ways = [space.promise(each * step, hessian, gradient) for each in SWAY_STRETCHES]
                if tried and max(ways) <= least:
                    break
                points, trials, good = self._follow(at, step, hessian, gradient, noise)
            else:
                points = np.array([space.moved(at, stretch * step) for stretch in STRETCHES])
                trials, good = self._run_errors.trials(points)
            costs = [
                self._cost.total(point, [each[k] for each in trials], noise)
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
                    there = self._run_errors.correction
                self._run_errors.correction = here
                if best.decrease > least:
                    break
            damping = max(DAMPING_GROWTH * damping, DAMPING_START)
        self._run_errors.correction = there
        return best

    def _exactly(self, step: Step, noise: PoseErrorNoise) -> Step:
        """Return a step with errors of vanishing time steps, where errors are.

        Where a long step leads, time steps change the first motion by another amount than where it
        began: the starts follow that too.
        """
        if not self._run_errors.exact:
            return step
        try:
            end = self._exact_end(step, step.at, noise)
        except CarosacError:  # shorter time steps have no finite motion
            return replace(step, cost=np.inf)
        there = self._run_errors.correction
        if self._space.starts_follow:
            with suppress(CarosacError):  # starts that follow may have none
                at, _ = self.restarted(end.at, end.errors, noise)
                followed = self._exact_end(step, at, noise)
                if followed.cost < end.cost:
                    return followed
        self._run_errors.correction = there
        return end

    def _exact_end(self, step: Step, at: Array, noise: PoseErrorNoise) -> Step:
        """Return a step that ends there, with errors of vanishing time steps."""
        errors = self._run_errors.at(at)
        return replace(step, at=at, errors=errors, cost=self._cost.total(at, errors, noise))

    def _follow(
        self, at: Array, step: Array, hessian: Array, gradient: Array, noise: PoseErrorNoise
    ) -> tuple[Array, list[Array], list[NDArray[np.bool_]]]:
        """Return where stretches of a step lead, with the errors there.

        Each start follows as far as suits it: one of which little is known would go far, and spoil
        the step for all.
        """
        space = self._space
        robot = step[: space.count]
        steps = np.tile(step, (len(START_TRIES), 1))
        for k in space.kept:
            rows = space.start_of(k)
            pull = gradient[rows] + hessian[rows, : space.count] @ robot
            for row, each in zip(steps, _tries(hessian[np.ix_(rows, rows)], pull), strict=True):
                row[rows] = each
        ways = np.array([
            [space.moved(at, stretch * each) for each in steps] for stretch in SWAY_STRETCHES
        ])  # fmt: skip
        errors, sound = self._run_errors.trials(ways.reshape(-1, len(at)))
        points = ways[:, 0].copy()
        trials, good = [], []
        for k, (each, exists) in enumerate(zip(errors, sound, strict=True)):
            rows = space.start_of(k)
            costs = np.array([
                self._cost.with_start(k, way, error, noise) if fine else np.inf
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
            if self._space.starts_follow:
                point, found = self.restarted(point, found, noise)
            ends.append(Step(at=point, errors=found, cost=self._cost.total(point, found, noise)))
            if not self._run_errors.sways:
                break
        return min(ends, key=lambda end: end.cost, default=None)

    def restarted(
        self,
        at: Array,
        errors: list[Array],
        noise: PoseErrorNoise,
        tries: Sequence[tuple[float, float]] = START_TRIES,
    ) -> tuple[Array, list[Array]]:
        """Let each run start as suits the robot where a step led, if that lowers its cost.

        The first motion follows a change of the robot far from linearly: a step that the starts
        have not followed yet looks worse than where it leads.

        Args:
            at: All coordinates.
            errors: Of each run there (K, 6).
            noise: Of these.
            tries: Shares of steps, and their dampings, of which the best is taken.

        Returns:
            All coordinates, and errors there.
        """
        space, judge = self._space, self._cost.judge(noise)
        jacobians = self._run_errors.jacobians(at, coarse=True, starts=True)
        trial = np.tile(at, (len(tries), 1))
        for k in space.kept:
            slopes = jacobians[k][:, :, space.count :]
            fold = self._cost.run_about(k, at, judge, errors[k], slopes)
            trial[:, space.start_of(k)] += _tries(fold.information, fold.gradient, tries)
        trials, good = self._run_errors.trials(trial)
        point, found = at.copy(), list(errors)
        for k in space.kept:
            rows = space.start_of(k)
            lowest = self._cost.with_start(k, at, errors[k], noise)
            for each, error, sound in zip(trial, trials[k], good[k], strict=True):
                cost = self._cost.with_start(k, each, error, noise)
                if sound and cost < lowest:
                    lowest, point[rows], found[k] = cost, each[rows], error
        return point, found


def _tries(
    hessian: Array, gradient: Array, tries: Sequence[tuple[float, float]] = START_TRIES
) -> list[Array]:
    """Return steps (p,) of a start to try."""
    diagonal = np.diag(np.diag(hessian))
    return [
        np.asarray(-share * np.linalg.solve(hessian + damping * diagonal, gradient), float)
        for share, damping in tries
    ]
