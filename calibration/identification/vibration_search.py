"""The likeliest vibrations of some runs, and the cables that vibrate, by Gauss-Newton.

Vibrations are followed from the first pose on, for ever longer times: at first their phases are not
lost yet. How stiff the cables are, and how much they damp, is common to all runs. Beside it each
run starts as suits it best. What is left of poses says for how long a run is followed: where
vibrations are strong, a search may lose them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.identification.quadratic import Quadratic
from calibration.identification.run_simulator import RunSimulator
from calibration.identification.vibrations import (
    PROBE,
    REFINED,
    ToldVibrations,
    VibratingStarts,
)
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError

SHARES = (0.25, 0.5, 1.0)  # of the time in which vibrations are looked for, one after another
STEPS_MAX = 3  # for each of them
DAMPING_RATIOS = (1.0, 30.0, 1e3)  # that are tried
DAMPING_START, DAMPING_MIN = 1e-3, 1e-6  # of what poses tell of each way to vibrate
CABLE_SHARES = (0.0, 0.3, 1.0)  # of a step of the cables that are tried
CABLE_PROBE = 0.01  # of the sigma of what is known of cables, for differences
SETTLED_DECREASE = 0.1  # of the cost of a typical run
HALVINGS_MAX = 3  # of vibrations with which a platform has no finite motion


@dataclass
class _Following:
    """A run whose vibrations are followed.

    Attributes:
        about: Coefficients of the ways in which it starts, shape (2 n,).
        damping: Of the next step.
    """

    about: Array
    damping: float = DAMPING_START


class VibrationSearch:
    """A search for the vibrations of some runs."""

    def __init__(
        self,
        simulator: RunSimulator,
        starts: Sequence[VibratingStarts],
        at: Sequence[Array],
        cables: Array,
        time_step: float,
    ) -> None:
        """Take the runs.

        Args:
            simulator: Of the robot.
            starts: Of each run.
            at: Coordinates of each run without vibrations, those of the robot first.
            cables: Changes of the robot by one sigma of what is known of its cables, shape (q, k).
            time_step: Of a sway, at most [s].
        """
        self._simulator, self._starts, self._time_step = simulator, starts, time_step
        self._at, self._cables = [each.copy() for each in at], cables
        self._moved = np.zeros(len(cables))  # cables, in sigmas
        self._runs = [_Following(np.zeros(len(start.ways))) for start in starts]

    def run(self) -> list[ToldVibrations]:
        """Search; return what poses tell of the vibrations of each run.

        Raises:
            CarosacError: A platform has no finite motion, as little as it vibrates.
        """
        found: list[ToldVibrations | None] = [None] * len(self._starts)
        for share in SHARES:
            starts = [start.first(share) for start in self._starts]
            for each in self._runs:
                each.damping = DAMPING_START
            for _ in range(STEPS_MAX):
                if self._step(starts) <= SETTLED_DECREASE * len(starts):
                    break
            for k, told in enumerate(self._told(starts)):
                before = found[k]
                if before is None or not before.information.any() or told.follows(before):
                    found[k] = told
        return [
            told if start.stays_taut(told.sigma_points()[0]) else told.forgotten
            for start, told in zip(self._starts, found, strict=True)
            if told is not None
        ]

    def errors(
        self, starts: Sequence[VibratingStarts], along: Sequence[Array], beside: Array | None = None
    ) -> tuple[list[Array], list[bool]]:
        """Return errors (W, K, 6) of all poses of each run, and whether all motions are finite.

        Args:
            starts: Of each run.
            along: How strongly it starts in each of its ways, of each run, shape (W, 2 n).
            beside: Further changes of cables [sigma], shape (W, q); None: none.
        """
        points = [start.points(*each) for start, *each in zip(starts, self._at, along, strict=True)]
        if beside is not None:
            for each in points:
                each[:, : self._cables.shape[1]] += beside @ self._cables
        errors, sound = self._simulator.pose_errors(
            [start.run for start in starts], points, self._time_step, refined=REFINED
        )
        return errors, [bool(each.all()) for each in sound]

    def _told(self, starts: Sequence[VibratingStarts]) -> list[ToldVibrations]:
        """Return what poses tell where the search stands."""
        cables = len(self._moved)
        for _ in range(1 + HALVINGS_MAX):
            around = [
                run.about + np.vstack([
                    np.zeros_like(run.about), PROBE * np.eye(len(run.about)),
                    np.zeros((cables, len(run.about))),
                ])
                for run in self._runs
            ]  # fmt: skip
            beside = np.zeros((len(around[0]), cables))
            beside[len(beside) - cables :] = CABLE_PROBE * np.eye(cables)
            errors, sound = self.errors(starts, around, beside)
            if all(sound):
                break
            for run, fine in zip(self._runs, sound, strict=True):
                run.about = run.about if fine else 0.5 * run.about
        else:
            raise CarosacError("identification: no finite motion of a robot whose cables vibrate")
        return [
            start.told(run.about, own, CABLE_PROBE)
            for start, run, own in zip(starts, self._runs, errors, strict=True)
        ]

    def _step(self, starts: Sequence[VibratingStarts]) -> float:
        """Take a step; return by how much the cost falls.

        Cables move only where that is better for all runs together.
        """
        told = self._told(starts)
        move = self._cable_step(told)
        moves = np.outer(CABLE_SHARES, move) if len(move) else np.zeros((1, 0))
        ways = [
            np.array(
                [run.about]
                + [
                    run.about + each.step(run.about, ratio * run.damping, other)
                    for other in moves
                    for ratio in DAMPING_RATIOS
                ]
            )
            for run, each in zip(self._runs, told, strict=True)
        ]
        tries = len(DAMPING_RATIOS)
        beside = np.concatenate([moves[:1], np.repeat(moves, tries, axis=0)])
        errors, _ = self.errors(starts, ways, beside)
        costs = np.array([
            [start.cost(each, *one) for one in zip(way, own, strict=True)]
            for start, each, way, own in zip(starts, told, ways, errors, strict=True)
        ])  # fmt: skip
        first = [0, *range(1 + tries, costs.shape[1], tries)]  # of each move of the cables
        best = [row + np.argmin(costs[:, row : row + tries + (row == 0)], axis=1) for row in first]
        rows = np.arange(len(costs))
        known = [float((self._moved + each) @ (self._moved + each)) for each in moves]
        totals = [costs[rows, each].sum() + more for each, more in zip(best, known, strict=True)]
        taken = int(np.argmin(totals))
        for run, way, row in zip(self._runs, ways, best[taken], strict=True):
            ratio = DAMPING_RATIOS[(row - 1) % tries] / 10.0 if row else DAMPING_RATIOS[-1]
            run.about, run.damping = way[row], max(ratio * run.damping, DAMPING_MIN)
        self._moved = self._moved + moves[taken]
        for each in self._at:
            each[: self._cables.shape[1]] += moves[taken] @ self._cables
        return float(costs[:, 0].sum() + known[0] - totals[taken])

    def _cable_step(self, told: Sequence[ToldVibrations]) -> Array:
        """Return the likeliest change of cables [sigma], shape (q,), beside which starts follow."""
        count = len(self._moved)
        information, gradient = np.eye(count), self._moved.copy()
        for run, each in zip(self._runs, told, strict=True):
            apart: Quadratic = each.about(run.about).least_beside(count)
            information, gradient = information + apart.information, gradient + apart.gradient
        return np.asarray(-np.linalg.solve(information, gradient), float)
