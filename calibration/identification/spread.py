"""How far off a robot found from many recordings may be, and the moves that show it.

Some combinations of its parameters are known a thousand times better than others. Derivatives are
differences over some sigmas along the axes of the covariance: over less, vibrations that averages
leave would count as knowledge. What fits best bends as the parameters that are hardly known change,
by more than its own sigma: a covariance to first order would claim too much.

References:
    Beale, Confidence regions in non-linear estimation, *Journal of the Royal Statistical Society*
    B 22, 1960.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array

MOVE_SIGMAS = 3.0  # along axes of the covariance, for differences
MOVE_MAX = 0.5  # the same, of the coordinates
BOTH_SHARE_MIN = 0.1  # of a move, that there must be room for on its other side
PAIRS = 40  # of draws: squared errors of a robot by their spread are 4 % from those by 100
STALE_SIGMAS = 1.0  # for each coordinate, by which a search may leave where it took derivatives
SEED = 0
TINY = 1e-12  # instead of no step


@dataclass(frozen=True, kw_only=True, eq=False)
class Spread:
    """How far coordinates (k,) may be off.

    Attributes:
        covariance: To first order, shape (k, k).
        draws: Of this covariance, within bounds, shape (d, k); none where little bends.
        bends: What is added to each of them as motion is not linear, shape (d, k).
    """

    covariance: Array
    draws: Array
    bends: Array

    @classmethod
    def straight(cls, covariance: Array) -> Spread:
        """Return one of coordinates that are known along straight lines."""
        none = np.zeros((0, len(covariance)))
        return cls(covariance=covariance, draws=none, bends=none)


@dataclass(frozen=True, kw_only=True, eq=False)
class Moves:
    """Changes of the p coordinates that the errors of a run depend on.

    Attributes:
        steps: In rows, shape (p, p).
        both: Which of them are taken to both sides, shape (p,).
    """

    steps: Array
    both: NDArray[np.bool_]

    def ends(self, at: Array, lower: Array, rows: NDArray[np.int64]) -> Array:
        """Return points (1 + 2 p, all coordinates): here, ahead, and behind or here again.

        Those that rounding would leave below their bounds are on them.
        """
        ends = np.tile(at, (1 + 2 * len(rows), 1))
        ends[1 : 1 + len(rows), rows] += self.steps
        ends[1 + len(rows) :, rows] -= self.both[:, None] * self.steps
        return np.maximum(ends, lower)

    def change(self, errors: Array) -> Array:
        """Return by how much errors (1 + 2 p, K, 6) at these ends change to one side, (p, K, 6)."""
        _, ahead, behind = np.split(errors, [1, 1 + len(self.steps)])
        sides = np.where(self.both, 2.0, 1.0)  # the other end of one side is here
        return np.asarray((ahead - behind) / sides[:, None, None])


def moves_along(
    hessian: Array, at: Array, lower: Array, searched: NDArray[np.bool_], *, robot: int, size: float
) -> tuple[Array, NDArray[np.bool_]]:
    """Return changes of a robot's coordinates along the axes of their covariance.

    The starts of the runs follow.

    Args:
        hessian: Of the cost, about.
        at: All coordinates, those of the robot first.
        lower: Their bounds.
        searched: Those that change.
        robot: How many are of the robot.
        size: Least change; those at a bound change by that alone.

    Returns:
        Changes in rows, shape (k, all coordinates), and which may be taken to both sides (k,).
    """
    bound = at[:robot] <= lower[:robot] + size
    free = np.flatnonzero(searched[:robot] & ~bound)
    start = np.arange(robot, len(at))
    follow = -np.linalg.solve(hessian[np.ix_(start, start)], hessian[np.ix_(start, free)])
    left = hessian[np.ix_(free, free)] + hessian[np.ix_(free, start)] @ follow
    whole = np.zeros((robot, len(at)))
    whole[:, :robot] = size * np.eye(robot)
    whole[np.ix_(free, free)] = _along_axes(left, size)
    whole[np.ix_(free, start)] = whole[np.ix_(free, free)] @ follow.T
    both = np.zeros(robot, dtype=np.bool_)
    room = at[free] - lower[free]
    for row in free:
        step = whole[row, free]
        ahead, behind = (np.min(room / np.maximum(-side * step, TINY)) for side in (1.0, -1.0))
        both[row] = min(ahead, behind) >= BOTH_SHARE_MIN
        if both[row]:
            whole[row] *= min(1.0, ahead, behind)
        else:  # the way on which there is more room
            whole[row] *= min(1.0, ahead) if ahead >= behind else -min(1.0, behind)
    return whole, both


def moves_of_run(
    whole: Array,
    both: NDArray[np.bool_],
    hessian: Array,
    own: NDArray[np.int64],
    rows: NDArray[np.int64],
    *,
    size: float,
) -> Moves:
    """Return the changes of a run: those of the robot, and of its start alone.

    Args:
        whole: Of the robot, as of `moves_along`.
        both: The same.
        hessian: Of the cost, about.
        own: Rows of the coordinates that the run depends on, those of the robot first.
        rows: Those of them that change.
        size: Least change.
    """
    count = len(whole)
    begin = own[count:]
    starts = np.zeros((len(begin), len(own)))
    starts[:, count:] = _along_axes(hessian[np.ix_(begin, begin)], size)
    which = np.isin(own, rows)
    steps = np.concatenate([whole[:, own], starts])[np.ix_(which, which)]
    sides = np.concatenate([both, np.ones(len(begin), dtype=np.bool_)])
    return Moves(steps=steps, both=sides[which])


def symmetric_draws(root: Array, room: Array) -> Array:
    """Return changes (d, k) of a covariance, and then their opposites.

    Those that would leave their bounds to either side stop there, and the others are as is likely
    beside that: what nearly makes up for each other still does.

    Args:
        root: Of the covariance, shape (k, k).
        room: How far each coordinate may go down, shape (k,); infinite without a bound.
    """
    steps = np.random.default_rng(SEED).standard_normal((PAIRS, len(root))) @ root.T
    bounded = np.isfinite(room)
    cut = np.clip(steps[:, bounded], -room[bounded], room[bounded])
    with_all = root[bounded] @ root.T
    missing = np.linalg.solve(with_all[:, bounded], (cut - steps[:, bounded]).T)
    steps = steps + missing.T @ with_all
    steps[:, bounded] = cut  # to the last bit
    return np.concatenate([steps, -steps])


def _along_axes(information: Array, size: float) -> Array:
    """Return steps along the axes of a covariance, in rows."""
    variance, axes = np.linalg.eigh(np.linalg.inv(information))
    return np.asarray((axes * np.clip(MOVE_SIGMAS * np.sqrt(variance), size, MOVE_MAX)).T)
