"""All coordinates of a search: those of the robot, and behind them those of each run's start."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from calibration.identification.error_noise import RUNS_APART_MIN
from calibration.identification.quadratic import Quadratic
from calibration.identification.runs import FittedRun
from calibration.identification.unknowns import Coordinates
from carosac_toolkit.base.arrays import Array

STEP_MAX_SIGMAS = 2.0  # prior sigmas that a coordinate may move in one step


class SearchSpace:
    """Coordinates that a search may change, how far, and which runs tell of them.

    Attributes:
        unknowns: The first k coordinates, those of the robot.
        count: k.
        many: True if runs are many. Each is then one of a sample, and its start follows the robot.
        own: Rows of the coordinates that each run depends on, those of the robot first.
        names: Of all p coordinates.
        begin: Where the search begins, shape (p,).
        prior: Information of what is known of them at first, shape (p, p).
        lower: Least coordinates, shape (p,).
        searched: Those that change, shape (p,).
        followed: Runs that tell of the robot, shape (R,); the others are left out.
        mass: Place of the coordinate of the mass; -1: it is none of them.
    """

    def __init__(
        self, unknowns: Coordinates, runs: Sequence[FittedRun], robot_at: Array | None
    ) -> None:
        """Line coordinates up.

        Args:
            unknowns: Coordinates of the robot.
            runs: Recordings.
            robot_at: Where those of the robot are held, shape (k,); None: they are searched.
        """
        self.unknowns = unknowns
        self.count = len(unknowns.prior.names)
        self.many = len(runs) >= RUNS_APART_MIN
        sizes = [len(run.sway.guess) for run in runs]
        loose, edges = sum(sizes), self.count + np.cumsum([0, *sizes])
        robot = np.arange(self.count)
        self.own = [np.concatenate([robot, np.arange(a, b)]) for a, b in pairwise(edges)]
        self.names = [*unknowns.prior.names, *(name for run in runs for name in run.sway.names)]
        self.mass = self.names.index("mass") if "mass" in self.names else -1
        self.begin = np.concatenate(
            [unknowns.prior.mean if robot_at is None else robot_at]
            + [run.sway.guess for run in runs]
        )
        self.prior = block_diag(unknowns.prior.information, np.eye(loose))
        self.lower = np.concatenate([unknowns.lower, np.full(loose, -np.inf)])
        self._sigma = np.concatenate([unknowns.prior.sigma, np.ones(loose)])
        self.searched = np.ones(len(self.begin), dtype=np.bool_)
        self.searched[: self.count] = robot_at is None
        self.followed = np.ones(len(runs), dtype=np.bool_)

    @property
    def robot_is_searched(self) -> bool:
        """False where starts alone are."""
        return bool(self.searched[: self.count].any())

    @property
    def starts_follow(self) -> bool:
        """True where steps of the robot are judged once the starts of many runs have followed."""
        return self.many and self.robot_is_searched

    @property
    def kept(self) -> list[int]:
        """Which runs are not left out."""
        return [k for k, followed in enumerate(self.followed) if followed]

    def keep_only(self, told: NDArray[np.bool_]) -> None:
        """Leave out all other runs (R,), and what was left out before."""
        self.followed &= told
        for k, followed in enumerate(self.followed):
            if not followed:
                self.searched[self.start_of(k)] = False

    def start_of(self, k: int) -> NDArray[np.int64]:
        """Return the rows of the coordinates of a run's start."""
        return self.own[k][self.count :]

    def starts_at(self, at: Array) -> tuple[Array, ...]:
        """Return the coordinates of each start, of all of them (p,)."""
        return tuple(at[self.start_of(k)] for k in range(len(self.own)))

    def varied(self, searched: NDArray[np.bool_]) -> list[NDArray[np.int64]]:
        """Return which of some coordinates (p,) change each run; none one that is left out."""
        return [
            own[searched[own] & followed]
            for own, followed in zip(self.own, self.followed, strict=True)
        ]

    def told_by_alike(self, searched: NDArray[np.bool_]) -> bool:
        """Say whether derivatives by the mass follow from others; if so, it is not differenced.

        All forces and masses by one factor give the same motion. As a difference derivatives by the
        mass would be wrong by a thousandth of themselves, and many recordings would seem to tell
        that factor.

        Args:
            searched: Coordinates by which errors are differenced, of which the mass is taken.
        """
        if not self.many or self.unknowns.alike is None or not searched[self.mass]:
            return False
        searched[self.mass] = False
        return True

    def fill_alike(self, jacobians: Sequence[Array]) -> None:
        """Fill in derivatives by the mass: all forces and masses by one factor change nothing."""
        alike = self.unknowns.alike
        assert alike is not None
        for each in jacobians:
            each[:, :, self.mass] = -each[:, :, : self.count] @ alike / alike[self.mass]

    def moved(self, at: Array, step: Array) -> Array:
        """Return the end of a step; coordinates that would leave their bound stay on it."""
        moved = at + step
        own = slice(self.count)
        moved[own] = self.unknowns.moved(at[own], step[own])
        return np.asarray(np.maximum(moved, self.lower))

    def step(self, at: Array, hessian: Array, gradient: Array, damping: float = 0.0) -> Array:
        """Return a damped step to the least of a quadratic cost, within bounds.

        No coordinate moves by more than `STEP_MAX_SIGMAS` of its prior.

        Args:
            at: All coordinates.
            hessian: Of half the cost.
            gradient: Of it.
            damping: Of the Hessian's diagonal.
        """
        damped = hessian + damping * np.diag(np.diag(hessian))
        return self.bounded(at, damped, gradient, STEP_MAX_SIGMAS * self._sigma)

    def bounded(
        self, at: Array, hessian: Array, gradient: Array, reach: Array | float = np.inf
    ) -> Array:
        """Return the step to the least of a quadratic cost that keeps coordinates in their bounds.

        None moves by more than its `reach`.
        """
        free = self.searched
        cost = Quadratic(cost=0.0, gradient=gradient[free], information=hessian[np.ix_(free, free)])
        lower = np.maximum(self.lower - at, -reach)
        upper = np.broadcast_to(reach, at.shape)
        step = np.zeros(len(at))
        step[free] = cost.least_within(lower[free], upper[free])
        return step

    def promise(self, step: Array, hessian: Array, gradient: Array) -> float:
        """Return by how much a step would lower a quadratic cost.

        Of many recordings, beyond what their starts alone would, which follow the robot: each has
        some of its own.
        """
        if not self.starts_follow:
            return float(-(2.0 * gradient + hessian @ step) @ step)
        rows = np.flatnonzero(self.searched)
        robot = rows[rows < self.count]
        cost = Quadratic(cost=0.0, gradient=gradient[rows], information=hessian[np.ix_(rows, rows)])
        apart = cost.least_beside(len(robot))
        return apart.cost - apart.at(step[robot])

    def turns_back(self, last: Array, step: Array, hessian: Array) -> bool:
        """Say whether a step turns the robot back, once starts have followed."""
        cost = Quadratic(cost=0.0, gradient=np.zeros(len(step)), information=hessian)
        left, own = cost.least_beside(self.count).information, slice(self.count)
        return bool(last[own] @ left @ step[own] < 0.0)
