"""Limits that exclude a pose from the workspace, or are nearest inside it."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array


class Limit(IntEnum):
    """Reason that excludes a pose from the workspace, in the order of the checks."""

    INSIDE = 0
    NOT_CONVERGED = 1  # a failure to compute, no statement on the robot
    NO_PULL = 2  # no cable can pull there: beyond the frame, or inside a pulley
    TOO_FLAT = 3  # all cables at their upper limits would not carry the weight, in any rotation
    NO_EQUILIBRIUM = 4  # a cable would have to push, or nothing balances: limits do not matter
    SLACK = 5  # a cable's lower tension limit
    OVERLOAD = 6  # a cable's upper tension limit
    UNSTABLE = 7
    TILT = 8
    TOO_SHORT = 9  # a cable shorter than its winch can wind
    TOO_LONG = 10  # a cable longer than its winch has
    COLLISION = 11  # two cables too near each other


LIMIT_LABELS = {
    Limit.INSIDE: "inside",
    Limit.NOT_CONVERGED: "not converged",
    Limit.NO_PULL: "no cable pulls there",
    Limit.TOO_FLAT: "cables too flat or weak for the weight",
    Limit.NO_EQUILIBRIUM: "no equilibrium",
    Limit.SLACK: "slack",
    Limit.OVERLOAD: "overloaded",
    Limit.UNSTABLE: "unstable",
    Limit.TILT: "tilted too far",
    Limit.TOO_SHORT: "shorter than its winch allows",
    Limit.TOO_LONG: "longer than its winch has",
    Limit.COLLISION: "cables too near each other",
}
CABLE_LIMITS = (Limit.NO_EQUILIBRIUM, Limit.SLACK, Limit.OVERLOAD, Limit.TOO_SHORT, Limit.TOO_LONG)


def tension_limit(
    margin: Array, low: Array, high: Array, lower: Array
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the tension limit that counts most for a margin, and its cable.

    The largest multiplier names it. Where only lower limits count and even limits of zero would
    leave the margin negative, cables would have to push: there is no equilibrium.

    Args:
        margin: [N], shape (B,).
        low: Multipliers of the lower limits, shape (B, n).
        high: Multipliers of the upper limits, shape (B, n).
        lower: Lower limits [N], shape (B, n).

    Returns:
        A `Limit` and the index of a cable, both of shape (B,), whether the margin is negative or
        not; the cable is -1 where nothing balances, of whatever sign.
    """
    n = low.shape[1]
    strongest = np.argmax(np.concatenate([low, high], axis=1), axis=1)
    limit = np.where(strongest < n, Limit.SLACK, Limit.OVERLOAD)
    cable = strongest % n
    pushes = (high.max(axis=1) < 1e-9) & (margin + (low * lower).sum(axis=1) < 0.0)
    limit = np.where(pushes | np.isneginf(margin), Limit.NO_EQUILIBRIUM, limit)
    cable = np.where(np.isneginf(margin), -1, cable)
    return limit.astype(np.int32), cable.astype(np.int32)


def cable_of(limit: int, cable: int, names: Sequence[str]) -> str | None:
    """Return the name of the cable that a limit is about, or None."""
    return names[cable] if limit in CABLE_LIMITS and cable >= 0 else None


def words_of(limit: int, cable: int) -> str:
    """Describe a limit in words, without its cable."""
    pushes = limit == Limit.NO_EQUILIBRIUM and cable >= 0
    return "would have to push" if pushes else LIMIT_LABELS[Limit(limit)]


def describe(limit: int, cable: int, names: Sequence[str]) -> str:
    """Describe a limit in words, with its cable."""
    words, name = words_of(limit, cable), cable_of(limit, cable, names)
    if name is None:
        return words
    return f"{name if name.lower().startswith('cable') else f'cable {name}'} {words}"
