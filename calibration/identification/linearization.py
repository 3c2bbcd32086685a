"""Motion as a linear function of coordinates, over all that they may be.

Where cables vibrate as a platform sways, motion is rugged: it changes as much with a little more of
a parameter as with much more. Differences over short steps then tell of the ruggedness, and a
search by them ends in any dip and claims to know it. What counts is how motion changes over what is
left of uncertainty. Errors are simulated at points that scatter as the coordinates may, and
their linear regression has three parts: means, slopes, and what is beyond a linear function, which
counts as noise that the errors of a run have in common. The search ends where means fit best.

Points lie to both sides along axes of the covariance, each as far as all of them scatter together,
turned so that all axes take part in each: along one alone that would be far out. What is beyond
shows in the means of such pairs, and in their differences, of which there are some more than
slopes. By chance slopes take up differences and seem to tell what they do not: how much is known,
and taken from the information. Points of each run are turned otherwise, so that this chance is not
the same in all of them.

Damping of cables may be open by a factor of ten, over which motion bends far more than along all
else. The third power of such a coordinate dominates what is beyond in differences, so it is fitted
beside the slopes: they would take up too much of it by chance.

References:
    Garcia-Fernandez, Svensson, Morelande, Sarkka, Posterior linearization filter: principles and
    implementation using sigma points, *IEEE Transactions on Signal Processing* 63, 2015.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import ortho_group

from calibration.identification.quadratic import Quadratic
from calibration.identification.spread import cut
from carosac_toolkit.base.arrays import Array

AXIS_MAX = 1.0  # of coordinates, that points scatter by along an axis: as far as the prior does
MORE_PAIRS = 8  # of points than slopes, that show what is beyond in differences
BENT_SHARE_MIN = 0.5  # of what is beyond in differences that its third power explains
FREE_SHARE_MIN = 0.2  # of the length of a third power, beyond which slopes do not make up for it
NORMAL_POWER = 6.0  # mean square of such a third power, of normal coordinates
STALE_SIGMAS = 1.0  # for each coordinate, by which a search may leave what was found


@dataclass(frozen=True, kw_only=True, eq=False)
class Linearization:
    """Errors of a run, linear in the q coordinates that are searched of it.

    Attributes:
        mean: Where the search stands, shape (K, 6).
        slopes: By coordinates, shape (q, K, 6).
        beyond: What else changes errors at these points: each column by one sigma, shape (6 K, d).
        chance: The same of slopes, along any axis by a sigma of the points, shape (6 K, c).
        scatter: Covariance of the points, less what third powers take of it, shape (q, q).
    """

    mean: Array
    slopes: Array
    beyond: Array
    chance: Array
    scatter: Array

    @classmethod
    def of(cls, moves: Array, errors: Array, bent: int | None = None) -> Linearization:
        """Fit a linear function to errors at points on both sides.

        Args:
            moves: Of the points, d of them ahead and then those back, shape (2 d, q).
            errors: There, shape (2 d, K, 6).
            bent: Coordinate whose third power is fitted too; None: there is none.
        """
        shape, pairs = errors.shape[1:], len(moves) // 2
        powers = np.zeros((len(moves), 0)) if bent is None else _third_powers(moves[:, [bent]])
        beside = np.hstack([np.ones((len(moves), 1)), powers])
        told = np.hstack([moves, beside])
        flat = errors.reshape(len(errors), -1)
        fitted = np.linalg.lstsq(told, flat, rcond=None)[0]
        slopes, mean, bends = np.split(fitted, [moves.shape[1], moves.shape[1] + 1])
        ahead, behind = np.split(flat - told @ fitted, 2)
        freedoms = pairs - moves.shape[1] - len(bends)
        even = 0.5 * (ahead + behind).T / np.sqrt(pairs - 1)
        odd = 0.5 * (ahead - behind).T / np.sqrt(freedoms)
        alone = moves - beside @ np.linalg.lstsq(beside, moves, rcond=None)[0]
        return cls(
            mean=mean.reshape(shape),
            slopes=np.asarray(slopes.reshape(-1, *shape), float),
            beyond=np.hstack([even, odd, np.sqrt(NORMAL_POWER) * bends.T]),
            chance=odd / np.sqrt(pairs),
            scatter=alone.T @ alone / len(moves),
        )

    @classmethod
    def nowhere(cls, errors: Array) -> Linearization:
        """Return the one of a run of which nothing is searched, with its errors (K, 6)."""
        none = np.zeros((errors.size, 0))
        return cls(
            mean=errors,
            slopes=np.zeros((0, *errors.shape)),
            beyond=none,
            chance=none,
            scatter=np.zeros((0, 0)),
        )


def axes_of_robot(hessian: Array, searched: NDArray[np.bool_], robot: int) -> Array:
    """Return changes along the axes of the covariance of a robot, by one sigma each.

    The starts of the runs follow.

    Args:
        hessian: Of the cost, shape (p, p).
        searched: Coordinates that change, shape (p,).
        robot: How many coordinates are of the robot, the first ones.

    Returns:
        In rows, shape (k', p).
    """
    free, start = np.flatnonzero(searched[:robot]), slice(robot, None)
    follow = -np.linalg.solve(hessian[start, start], hessian[start][:, free])
    left = hessian[np.ix_(free, free)] + hessian[free][:, start] @ follow
    axes = np.zeros((len(free), len(hessian)))
    axes[:, free] = _along_axes(left)
    axes[:, start] = axes[:, free] @ follow.T
    return axes


def scattered_moves(
    axes: Array,
    hessian: Array,
    covariance: Array,
    robot: int,
    rows: NDArray[np.int64],
    lower: Array,
    seed: int,
) -> Array:
    """Return moves of a run's coordinates ahead and then back, shape (2 (q + MORE_PAIRS), q).

    Args:
        axes: Of the robot, as of `axes_of_robot`.
        hessian: Of the cost.
        covariance: Its inverse.
        robot: How many coordinates are of the robot.
        rows: Of the q coordinates that are searched of the run.
        lower: How far all coordinates may move down, shape (p,).
        seed: Of how they are turned.
    """
    begin = rows[rows >= robot]
    starts = np.zeros((len(begin), len(hessian)))
    starts[:, begin] = _along_axes(hessian[np.ix_(begin, begin)])
    along = np.concatenate([axes, starts])[:, rows]
    pairs = len(along) + MORE_PAIRS
    angle = 2.0 * np.pi * np.outer(np.arange(pairs), np.arange(len(along))) / pairs
    turn = ortho_group.rvs(len(along), random_state=seed)
    ahead = (np.cos(angle) + np.sin(angle)) @ turn @ along  # columns are orthogonal (Hartley)
    moves = np.concatenate([ahead, -ahead])
    own = covariance[np.ix_(rows, rows)]
    return cut(moves, own, lower[rows], np.full(len(rows), np.inf))


def bent_coordinate(
    moves: Sequence[Array], errors: Sequence[Array], robot: int, sigma: Array
) -> int | None:
    """Return the coordinate of the robot whose third power dominates what is beyond in differences.

    In the mean of all runs it explains more than half of it. None: there is no such coordinate.

    Args:
        moves: Of the points of each run, as of `Linearization.of`; coordinates of the robot first.
        errors: The same.
        robot: How many coordinates are of the robot.
        sigma: Of errors, shape (6,).
    """
    shares = [
        _explained(move, error / sigma, robot) for move, error in zip(moves, errors, strict=True)
    ]
    share = np.mean(shares, axis=0)
    best = int(np.argmax(share))
    return best if share[best] > BENT_SHARE_MIN else None


def is_stale(moved: Array, hessian: Array, robot: int) -> bool:
    """Say whether a search moved (p,) by more than a sigma of each coordinate of the robot.

    Args:
        moved: Change of all coordinates.
        hessian: Of the cost.
        robot: How many coordinates are of the robot.
    """
    cost = Quadratic(cost=0.0, gradient=np.zeros(len(moved)), information=hessian)
    return cost.least_beside(robot).at(moved[:robot]) > STALE_SIGMAS**2 * robot


def _explained(moves: Array, errors: Array, robot: int) -> Array:
    """Return the share of what is beyond slopes in differences that third powers explain, (robot,).

    It is 0 of those that slopes make up for.
    """
    half, power, error = (
        0.5 * np.subtract(*np.split(each.reshape(len(each), -1), 2))
        for each in (moves, _third_powers(moves[:, :robot]), errors)
    )
    free = np.linalg.svd(half)[0][:, half.shape[1] :]  # what slopes do not take up
    left, beyond = free.T @ power, free.T @ error
    length, whole = np.linalg.norm(left, axis=0), np.linalg.norm(power, axis=0)
    shared = ((beyond.T @ left) ** 2).sum(axis=0)
    share = shared / np.maximum((length * np.linalg.norm(beyond)) ** 2, np.finfo(float).tiny)
    return np.where(length > FREE_SHARE_MIN * whole, share, 0.0)


def _third_powers(moves: Array) -> Array:
    """Return third powers of moves (d, q) by their sigma, less what slopes have of them."""
    share = moves / np.sqrt((moves**2).mean(axis=0))
    return np.asarray(share**3 - 3.0 * share)


def _along_axes(information: Array) -> Array:
    """Return steps of one sigma along the axes of a covariance, in rows."""
    told, axes = np.linalg.eigh(information)  # of an inverse, rounding hides what is known best
    return np.asarray((axes / np.sqrt(np.maximum(told, AXIS_MAX**-2))).T)
