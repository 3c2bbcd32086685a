"""The likeliest vibrations of some runs, and the cables that vibrate, by Gauss-Newton.

Vibrations are followed from the first pose that is looked at, over a short time and then a longer
one: over a short time a wrong stiffness does not lose their phases yet. How stiff the cables are,
and how much they damp, is common to all runs; given that, each run starts as suits it best. What
the likeliest vibrations leave of the poses says for how long a run could be followed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.identification.quadratic import Quadratic
from calibration.identification.run_simulator import RunSimulator
from calibration.identification.vibrations import (
    PROBE,
    REFINED,
    ToldVibrations,
    VibratingStarts,
)
from carosac_toolkit.base.arrays import Array

SHARES = (0.3, 1.0)  # of the time in which vibrations are looked for, one after another
STEPS_MAX = 5  # for each of them
DAMPING_RATIOS = (1.0, 30.0, 1e3)  # that are tried
DAMPING_START, DAMPING_MIN = 1e-3, 1e-6  # of what poses tell of each way to vibrate
CABLE_SHARES = (0.0, 0.3, 1.0)  # of a step of the cables that are tried
CABLE_PROBE = 0.01  # of the sigma of what is known of cables, for differences
SETTLED_DECREASE = 0.5  # squared sigmas, for each run


@dataclass
class _Following:
    """A run whose vibrations are followed.

    Attributes:
        about: Coefficients of the ways in which it starts, shape (2 n,).
        damping: Of the next step.
        lost: True if it could not be followed for so long: it says nothing of the cables any more.
    """

    about: Array
    damping: float = DAMPING_START
    lost: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class FollowedVibrations:
    """Vibrations of a run, as far as they are followed.

    Attributes:
        told: What poses tell of them.
        start: With those poses.
    """

    told: ToldVibrations
    start: VibratingStarts


class VibrationSearch:
    """A search for the vibrations of some runs."""

    def __init__(
        self,
        simulator: RunSimulator,
        starts: Sequence[VibratingStarts],
        at: Sequence[Array],
        cables: Array,
        time_step: float,
        begin: Sequence[Array] | None = None,
    ) -> None:
        """Take the runs.

        Args:
            simulator: Of the robot.
            starts: Of each run.
            at: Coordinates of each run without vibrations, those of the robot first.
            cables: Changes of the robot by one sigma of what is known of its cables, shape (q, k).
            time_step: Of a sway, at most [s].
            begin: Nearly the likeliest vibrations, as of a robot that is nearly this one, each
                (2 n,): they are followed at once for as long as they are looked for. None: calm
                platforms.
        """
        self._shares = SHARES if begin is None else SHARES[-1:]
        self._simulator, self._starts, self._time_step = simulator, starts, time_step
        self._at, self._cables = [each.copy() for each in at], cables
        self._moved = np.zeros(len(cables))  # cables, in sigmas
        self._runs = [
            _Following(about) for about in begin or [np.zeros(len(start.ways)) for start in starts]
        ]

    def run(self) -> list[FollowedVibrations]:
        """Search; return the vibrations of each run."""
        found: list[FollowedVibrations] = []
        for share in self._shares:
            starts = [start.first(share) for start in self._starts]
            for each in self._runs:
                each.damping = DAMPING_START
            for _ in range(STEPS_MAX):
                if self._step(starts) <= SETTLED_DECREASE * len(starts):
                    break
            ends = [
                FollowedVibrations(told=told, start=start)
                for told, start in zip(self._told(starts), starts, strict=True)
            ]
            for run, before, end in zip(self._runs, found, ends, strict=bool(found)):
                run.lost |= not end.told.follows(before.told)
            found = [
                found[k] if run.lost else end
                for k, (run, end) in enumerate(zip(self._runs, ends, strict=True))
            ]
        return found

    def errors(
        self,
        starts: Sequence[VibratingStarts],
        along: Sequence[Array],
        beside: Array | None = None,
        *,
        which: Sequence[int] | None = None,
    ) -> tuple[list[Array], list[NDArray[np.bool_]]]:
        """Return errors (W, K, 6) of all poses of each run, and which motions are finite (W,).

        Args:
            starts: Of each run.
            along: How strongly it starts in each of its ways, of each run, shape (W, 2 n).
            beside: Further changes of cables [sigma], shape (W, q); None: none.
            which: Of these runs only; None: all.
        """
        rows = range(len(starts)) if which is None else which
        if not rows:
            return [], []
        points = [starts[k].points(self._at[k], along[k]) for k in rows]
        if beside is not None:
            for each in points:
                each[:, : self._cables.shape[1]] += beside @ self._cables
        return self._simulator.pose_errors(
            [starts[k].run for k in rows], points, self._time_step, refined=REFINED
        )

    def _told(self, starts: Sequence[VibratingStarts]) -> list[ToldVibrations]:
        """Return what poses tell where the search stands.

        A run without a finite motion there tells nothing, and starts from rest again.
        """
        ways, cables = len(self._runs[0].about), len(self._moved)
        probes = np.zeros((1 + ways + cables, ways))
        probes[1 : 1 + ways] = PROBE * np.eye(ways)
        beside = np.zeros((len(probes), cables))
        beside[1 + ways :] = CABLE_PROBE * np.eye(cables)
        errors, sound = self.errors(starts, [run.about + probes for run in self._runs], beside)
        told = []
        for start, run, own, fine in zip(starts, self._runs, errors, sound, strict=True):
            if fine.all():
                told.append(start.told(run.about, own, CABLE_PROBE))
            else:
                told.append(start.untold(cables))
                run.about = np.zeros(ways)
        return told

    def _step(self, starts: Sequence[VibratingStarts]) -> float:
        """Take a step; return by how much the cost falls.

        Cables move only where that is better for all runs together.
        """
        told = self._told(starts)
        move = self._cable_step(told)
        moves = np.outer(CABLE_SHARES, move) if len(move) else np.zeros((1, 0))
        ways = [
            np.array([
                run.about, np.zeros_like(run.about),
                *(
                    run.about + each.step(run.about, ratio * run.damping, other)
                    for other in moves for ratio in DAMPING_RATIOS
                ),
            ])
            for run, each in zip(self._runs, told, strict=True)
        ]  # fmt: skip
        tries = len(DAMPING_RATIOS)
        beside = np.concatenate([moves[:1], moves[:1], np.repeat(moves, tries, axis=0)])
        errors, sound = self.errors(starts, ways, beside)
        costs = np.array([
            [
                start.cost(each, *one) if fine else np.inf
                for *one, fine in zip(way, own, good, strict=True)
            ]
            for start, each, way, own, good in zip(
                starts, told, ways, errors, sound, strict=True
            )
        ])  # fmt: skip
        first = [0, *range(2 + tries, costs.shape[1], tries)]  # of each move of the cables
        best = [
            row + np.argmin(costs[:, row : row + tries + 2 * (row == 0)], axis=1) for row in first
        ]
        rows = np.arange(len(costs))
        known = [float((self._moved + each) @ (self._moved + each)) for each in moves]
        votes = np.array([not run.lost for run in self._runs])
        totals = [
            costs[rows, each][votes].sum() + more for each, more in zip(best, known, strict=True)
        ]
        taken = int(np.argmin(totals))
        for run, way, row in zip(self._runs, ways, best[taken], strict=True):
            ratio = DAMPING_RATIOS[(row - 2) % tries] / 10.0 if row > 1 else DAMPING_RATIOS[-1]
            run.about, run.damping = way[row], max(ratio * run.damping, DAMPING_MIN)
        self._moved = self._moved + moves[taken]
        for each in self._at:
            each[: self._cables.shape[1]] += moves[taken] @ self._cables
        return float(costs[votes, 0].sum() + known[0] - totals[taken])

    def _cable_step(self, told: Sequence[ToldVibrations]) -> Array:
        """Return the likeliest change of cables [sigma], shape (q,), beside which starts follow."""
        count = len(self._moved)
        information, gradient = np.eye(count), self._moved.copy()
        for run, each in zip(self._runs, told, strict=True):
            if run.lost:
                continue
            apart: Quadratic = each.about(run.about).least_beside(count)
            information, gradient = information + apart.information, gradient + apart.gradient
        return np.asarray(-np.linalg.solve(information, gradient), float)
