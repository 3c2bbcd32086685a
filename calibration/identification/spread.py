"""How far off a robot may be, and draws of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.arrays import Array

PAIRS = 40  # of draws
SEED = 0


@dataclass(frozen=True, kw_only=True, eq=False)
class Spread:
    """How far coordinates (k,) may be off.

    Attributes:
        covariance: To first order, shape (k, k).
        draws: Of this covariance, within bounds, shape (d, k); none where little bends.
    """

    covariance: Array
    draws: Array

    @classmethod
    def straight(cls, covariance: Array) -> Spread:
        """Return one of coordinates whose parameters are known along straight lines."""
        return cls(covariance=covariance, draws=np.zeros((0, len(covariance))))


def symmetric_draws(root: Array, room: Array) -> Array:
    """Return changes (d, k) of a covariance, and then their opposites.

    Those that would leave their bounds to either side stop there.

    Args:
        root: Of the covariance, shape (k, k).
        room: How far each coordinate may go down, shape (k,); infinite without a bound.
    """
    steps = np.random.default_rng(SEED).standard_normal((PAIRS, len(root))) @ root.T
    steps = cut(steps, root @ root.T, -room, room)
    return np.concatenate([steps, -steps])


def cut(steps: Array, covariance: Array, lower: Array, upper: Array) -> Array:
    """Return steps (d, k) that stop at bounds (k,) below; what has none below has none above.

    Beside one that is cut the others are as is likely: what nearly makes up for each other still
    does.
    """
    bounded = np.isfinite(lower)
    inside = np.clip(steps[:, bounded], lower[bounded], upper[bounded])
    with_all = covariance[bounded]
    missing = np.linalg.solve(with_all[:, bounded], (inside - steps[:, bounded]).T)
    steps = steps + missing.T @ with_all
    steps[:, bounded] = inside  # to the last bit
    return steps
