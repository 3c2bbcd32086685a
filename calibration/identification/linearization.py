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
and taken from the information.

References:
    Garcia-Fernandez, Svensson, Morelande, Sarkka, Posterior linearization filter: principles and
    implementation using sigma points, *IEEE Transactions on Signal Processing* 63, 2015.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.identification.quadratic import Quadratic
from calibration.identification.spread import cut
from carosac_toolkit.base.arrays import Array

AXIS_MAX = 1.0  # of coordinates, that points scatter by along an axis: as far as the prior does
MORE_PAIRS = 8  # of points than slopes, that show what is beyond in differences
STALE_SIGMAS = 1.0  # for each coordinate, by which a search may leave what was found


@dataclass(frozen=True, kw_only=True, eq=False)
class Linearization:
    """Errors of a run, linear in the q coordinates that are searched of it.

    Attributes:
        mean: Where the search stands, shape (K, 6).
        slopes: By coordinates, shape (q, K, 6).
        beyond: What else changes errors at these points: each column by one sigma, shape (6 K, d).
        chance: The same of slopes, along any axis by a sigma of the points, shape (6 K, c).
        scatter: Covariance of the points, shape (q, q).
    """

    mean: Array
    slopes: Array
    beyond: Array
    chance: Array
    scatter: Array

    @classmethod
    def of(cls, moves: Array, errors: Array) -> Linearization:
        """Fit a linear function to errors (2 d, K, 6) after moves (2 d, q), d of them ahead."""
        shape, pairs = errors.shape[1:], len(moves) // 2
        told = np.hstack([np.ones((len(moves), 1)), moves])
        flat = errors.reshape(len(errors), -1)
        linear = np.linalg.lstsq(told, flat, rcond=None)[0]
        ahead, behind = np.split(flat - told @ linear, 2)
        even = 0.5 * (ahead + behind).T / np.sqrt(pairs - 1)
        odd = 0.5 * (ahead - behind).T / np.sqrt(pairs - moves.shape[1])
        return cls(
            mean=linear[0].reshape(shape),
            slopes=np.asarray(linear[1:].reshape(-1, *shape), float),
            beyond=np.hstack([even, odd]),
            chance=odd / np.sqrt(pairs),
            scatter=moves.T @ moves / len(moves),
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
) -> Array:
    """Return moves of a run's coordinates ahead and then back, shape (2 (q + MORE_PAIRS), q).

    Args:
        axes: Of the robot, as of `axes_of_robot`.
        hessian: Of the cost.
        covariance: Its inverse.
        robot: How many coordinates are of the robot.
        rows: Of the q coordinates that are searched of the run.
        lower: How far all coordinates may move down, shape (p,).
    """
    begin = rows[rows >= robot]
    starts = np.zeros((len(begin), len(hessian)))
    starts[:, begin] = _along_axes(hessian[np.ix_(begin, begin)])
    along = np.concatenate([axes, starts])[:, rows]
    pairs = len(along) + MORE_PAIRS
    angle = 2.0 * np.pi * np.outer(np.arange(pairs), np.arange(len(along))) / pairs
    ahead = (np.cos(angle) + np.sin(angle)) @ along  # columns are orthogonal (Hartley)
    moves = np.concatenate([ahead, -ahead])
    own = covariance[np.ix_(rows, rows)]
    return cut(moves, own, lower[rows], np.full(len(rows), np.inf))


def is_stale(moved: Array, hessian: Array, robot: int) -> bool:
    """Say whether a search moved (p,) by more than a sigma of each coordinate of the robot.

    Args:
        moved: Change of all coordinates.
        hessian: Of the cost.
        robot: How many coordinates are of the robot.
    """
    cost = Quadratic(cost=0.0, gradient=np.zeros(len(moved)), information=hessian)
    return cost.least_beside(robot).at(moved[:robot]) > STALE_SIGMAS**2 * robot


def _along_axes(information: Array) -> Array:
    """Return steps of one sigma along the axes of a covariance, in rows."""
    told, axes = np.linalg.eigh(information)  # of an inverse, rounding hides what is known best
    return np.asarray((axes / np.sqrt(np.maximum(told, AXIS_MAX**-2))).T)
