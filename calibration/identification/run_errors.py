"""Errors of recordings at coordinates of a search, and their derivatives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.identification.hidden_vibrations import hidden_vibrations
from calibration.identification.run_simulator import RunSimulator
from calibration.identification.runs import FittedRun
from calibration.identification.search_space import SearchSpace
from calibration.identification.search_state import Correction, ProgressCallback
from calibration.identification.vibration_scan import as_vibrating, cable_ways
from calibration.identification.vibrations import HiddenVibrations
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError

FINITE_DIFFERENCE_STEP = 0.005  # of the coordinates, for differences
# The same of many recordings, which tell more: over longer ones motion is less linear, and over
# shorter ones its jumps count for more.
STEP_OF_MANY = 5e-4
MANY_STEP_RATIO = 1.0 / 3.0  # of the time steps where many recordings show what the others hide
COARSE_STEP_RATIO = 2.0  # of the simulator's time steps, for coarse derivatives and for errors


class RunErrors:
    """What recordings that count miss of the robots that a search tries.

    Attributes:
        runs: With the poses that count now.
        whole: With all of them.
        exact: True if errors are of vanishing time steps.
        sways: True if only the sway of all runs counts, which averages show, and runs are many or
            starts alone are searched.
        hidden: What vibrations that noise hides change of errors of each run; None: not looked at.
        finer: What time steps make derivatives wrong by; None: not looked at.
        correction: Of simulated errors, as found last.
    """

    def __init__(self, space: SearchSpace, runs: Sequence[FittedRun], time_step: float) -> None:
        """Take recordings.

        Args:
            space: Coordinates that are searched.
            runs: Recordings.
            time_step: Of the simulation, at most [s].
        """
        self._space = space
        self.runs = self.whole = tuple(runs)
        # Few whose starts alone are searched are searched as the many were that told the robot.
        apart = space.many or not space.robot_is_searched
        self.sways = apart and all(run.window for run in self.runs)
        follows = space.many and not self.sways
        self.exact = space.many or self.sways
        self._time_step = time_step * (MANY_STEP_RATIO if follows else 1.0)
        self._simulator = RunSimulator(space.unknowns, space.own, space.names)
        self.hidden: list[HiddenVibrations] | None = None
        self.finer: list[Array] | None = None
        self.correction = Correction(at=space.begin, errors=[])

    def report(self, report: ProgressCallback, errors: Sequence[Array]) -> None:
        """Report errors of all runs (K, 6), before a step."""
        power = (np.concatenate(errors) ** 2).mean(axis=0)
        rms = [float(np.sqrt(each.sum())) for each in (power[:3], power[3:])]
        report(sum(len(run.poses.time) for run in self.runs), *rms)

    def look_at(self, share: float) -> None:
        """Let a share of the poses count, from the first; 1: all that do at the end."""
        self.runs = tuple(run.first(share) for run in self.whole)

    def look_at_all(self) -> None:
        """Let all poses count, also those that only lead a search."""
        self.runs = self.whole

    def at(self, at: Array) -> list[Array]:
        """Return the errors of each run (K, 6), of vanishing time steps where `exact`.

        The drift by vibrations that noise hides corrects them once it was found.

        Many recordings tell frequencies better than time steps that are short enough for a motion.
        What these are wrong by falls with their square (Richardson). Nearby it is nearly the same.

        Raises:
            CarosacError: The robot does not move.
        """
        points = [at[None]] * len(self.runs)
        errors, good = self.simulated(points)
        more = [np.zeros(6)] * len(errors)
        if self.exact:
            fine, sound = self.simulated(points, refined=2)
            good = [one & other for one, other in zip(good, sound, strict=True)]
            more = [
                4.0 / 3.0 * (best[0] - each[0]) for best, each in zip(fine, errors, strict=True)
            ]
        if not all(each.all() for each in good):
            raise CarosacError("identification: no finite motion of the robot")
        if self.hidden is not None:
            more = [each + hidden.drift for each, hidden in zip(more, self.hidden, strict=True)]
        self.correction = Correction(at=at, errors=more)
        return [each[0] + beyond for each, beyond in zip(errors, more, strict=True)]

    def trials(self, points: Array) -> tuple[list[Array], list[NDArray[np.bool_]]]:
        """Return errors as `simulated`, near to where `at` looked last.

        Hidden vibrations correct them as there. What they miss by their time steps changes along a
        step as the derivatives say.

        Args:
            points: Of all runs, shape (B, all coordinates).
        """
        errors, good = self.simulated([points] * len(self.runs))
        there = self.correction
        trials = [each + more for each, more in zip(errors, there.errors, strict=True)]
        if self.finer is not None:
            moves = points - there.at
            for each, own, change in zip(trials, self._space.own, self.finer, strict=True):
                each += np.einsum("nci,bi->bnc", change, moves[:, own])
        return trials, good

    def simulated(
        self, points: Sequence[Array], *, refined: int = 1
    ) -> tuple[list[Array], list[NDArray[np.bool_]]]:
        """Simulate all runs, as `RunSimulator.errors`."""
        return self._simulator.errors(self.runs, points, self._time_step, refined=refined)

    def jacobians(self, at: Array, *, coarse: bool, starts: bool = False) -> list[Array]:
        """Return the derivatives of each run's errors (K, 6) by what it depends on, (K, 6, p).

        With `starts` those by the robot are left at 0.

        Coarse ones come from longer time steps: half the work, and the same within a percent or so.
        That leads to where the search ends within a sigma, and exact ones lead to its end. Where
        steps are as long as a sway allows, longer ones would miss the cables' stiffness altogether.
        Exact ones are there of vanishing time steps, as errors are: parameters that nearly make up
        for each other show by less than a hundredth of what each of them does.
        """
        space = self._space
        robot = space.robot_is_searched and not starts
        searched = space.searched.copy()
        searched[: space.count] &= not starts
        alike = robot and space.told_by_alike(searched)
        ratio = COARSE_STEP_RATIO if coarse and not self.sways else 1.0
        jacobians = self.slopes(at, searched, ratio=ratio)
        if self.sways and not coarse:
            more = self._told_by_finer_steps(at, searched, jacobians)
            jacobians = [each + own for each, own in zip(jacobians, more, strict=True)]
        if alike:
            space.fill_alike(jacobians)
        return jacobians

    def _told_by_finer_steps(
        self, at: Array, searched: NDArray[np.bool_], rough: Sequence[Array]
    ) -> list[Array]:
        """Return what derivatives of vanishing time steps have beyond rough ones.

        It is found once: what the search changes there is of second order.
        """
        if self.finer is None:
            fine = self.slopes(at, searched, refined=2)
            self.finer = [4.0 / 3.0 * (a - b) for a, b in zip(fine, rough, strict=True)]
        return self.finer

    def slopes(
        self, at: Array, searched: NDArray[np.bool_], *, ratio: float = 1.0, refined: int = 1
    ) -> list[Array]:
        """Return differences of errors over short changes of one coordinate each, (K, 6, p) a run.

        Args:
            at: All coordinates.
            searched: By which of them.
            ratio: Of time steps to those of errors.
            refined: Steps that each of these is divided into.
        """
        size = STEP_OF_MANY if self._space.many else FINITE_DIFFERENCE_STEP
        return self._simulator.slopes(
            self.runs, at, self._space.varied(searched), size=size,
            time_step=ratio * self._time_step, refined=refined,
        )  # fmt: skip

    def by_coordinates(self, k: int, rows: NDArray[np.int64], slopes: Array) -> Array:
        """Return derivatives of a run's errors, as `RunSimulator.by_coordinates`."""
        return self._simulator.by_coordinates(k, rows, slopes)

    def off_by_time_steps(self, at: Array, sigma: Array) -> Array:
        """Return how far two time steps are from two shorter ones in vanishing ones, (R,).

        In sigmas of all errors of a run together.

        Args:
            at: All coordinates.
            sigma: Of errors, shape (6,).
        """
        points = [at[None]] * len(self.runs)
        once, twice, more = (self.simulated(points, refined=refined)[0] for refined in (1, 2, 4))
        return np.array([
            np.linalg.norm((5.0 * b - a - 4.0 * c) / (3.0 * sigma))
            for a, b, c in zip(once, twice, more, strict=True)
        ])  # fmt: skip

    def hidden_vibrations(self, at: Array, sigma: Array) -> list[HiddenVibrations]:
        """Return what vibrations that noise hides change of each run, as `hidden_vibrations`.

        The cables that vibrate are as stiff, and damp as much, as the vibrations of all runs show.
        They are searched from those of the robot; from the second time on, from those within three
        sigmas of it that explain most of the vibrations. Nothing is hidden in a run that is left
        out, that is not averaged, or whose start has vibrations as unknowns.

        Args:
            at: All coordinates, shape (p,).
            sigma: How far off those of the robot may be, shape (k,).
        """
        space, unknowns = self._space, self._space.unknowns
        hidden = [
            HiddenVibrations.none(run.seen(np.zeros((len(run.poses.time), 6)))) for run in self.runs
        ]
        which = [
            k
            for k in space.kept
            if self.runs[k].window and not len(self.runs[k].sway.stretch_sigma)
        ]
        runs = [self.whole[k] for k in which]
        robot = at[: space.count]
        if self.hidden is not None:
            cables = as_vibrating(unknowns, runs, robot, sigma)
            robot = robot if cables is None else cables
        found = hidden_vibrations(
            self._simulator,
            runs,
            [self.runs[k] for k in which],
            [np.concatenate([robot, at[space.start_of(k)]]) for k in which],
            unknowns.robot_at(robot),
            cable_ways(unknowns, robot, sigma),
            self._time_step,
            None if self.hidden is None else [self.hidden[k] for k in which],
        )
        for k, each in zip(which, found, strict=True):
            hidden[k] = each
        return hidden
