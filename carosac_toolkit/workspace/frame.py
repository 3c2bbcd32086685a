"""Positions that cables cannot hold in any rotation: proofs, no search."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.robot.robot import Robot


def beyond_frame(robot: Robot, position: Array) -> NDArray[np.bool_]:
    """Return whether all exit points lie on one side, so that nothing balances the weight.

    All of them below every anchor point there can be, or all of them on one side of a vertical
    plane, for any rotation. A hanging cable pulls into the vertical plane of its ends and lower
    than its chord, so this holds with sag as well.

    Args:
        robot: Robot description.
        position: Platform origin in W [m], shape (B, 3).

    Returns:
        Shape (B,).
    """
    from scipy.spatial import ConvexHull, QhullError

    reach = _reach(robot)
    beyond: NDArray[np.bool_] = position[:, 2] > robot.exit_points[:, 2].max() + reach
    try:
        sides = ConvexHull(robot.exit_points[:, :2]).equations
    except (QhullError, ValueError):  # exit points above one line
        return beyond
    distance = position[:, :2] @ sides[:, :2].T + sides[:, 2]
    beyond |= distance.max(axis=1) > reach
    return beyond


def too_flat(robot: Robot, position: Array) -> NDArray[np.bool_]:
    """Return whether cables at their upper tension limits are too flat to carry the weight.

    No anchor point is farther from the platform origin than the longest lever, so that for any
    rotation a cable is no steeper than from the lowest place and the least distance that this
    leaves; a hanging cable is less steep at the platform than its chord.

    Args:
        robot: Robot description.
        position: Platform origin in W [m], shape (B, 3).

    Returns:
        Shape (B,).
    """
    reach = _reach(robot)
    chord = robot.exit_points - position[:, None]  # (B, n, 3)
    rise = chord[..., 2] + reach
    aside = np.maximum(np.linalg.norm(chord[..., :2], axis=-1) - reach, 0.0)
    sine = np.where(rise > 0.0, rise / np.maximum(np.hypot(rise, aside), 1e-12), 0.0)
    carried: Array = sine @ robot.tension_max
    return carried < robot.weight


def _reach(robot: Robot) -> float:
    """Return the largest distance of anchor and tangent points from their nominal place [m]."""
    lever = float(np.linalg.norm(robot.anchor_points, axis=1).max())
    return lever + 2.0 * float(robot.pulley_radius.max())


def without_cable(robot: Robot, position: Array, rotation: Array | None) -> NDArray[np.bool_]:
    """Return whether an anchor point is on its exit point or inside its pulley, shape (B,)."""
    cables = straight_length(robot, position, rotation)
    there = cables.valid.astype(bool) & (cables.length > 1e-6)
    return np.asarray((~there).any(axis=1))
