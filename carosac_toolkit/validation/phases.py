"""Rests of the winches, and rates of change, from samples at arbitrary times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.robot.robot import Robot

REST_SPEED_MAX_M_S = 0.01  # [m/s]: fastest cable that still counts as resting
# A platform rests below this speed: above the noise of measured poses, and of readings at rest.
PLATFORM_REST_SPEED_MAX = Scaled(0.05, "m/s", least=0.01)
REST_DURATION_MIN_S = 0.5  # [s]: shortest rest
SLOPE_WINDOW_S = 0.15  # [s] before and after a sample


@dataclass(frozen=True, kw_only=True, eq=False)
class Phases:
    """Rests and moves of a run.

    A sample rests where no measured cable length changes faster than `REST_SPEED_MAX_M_S` for at
    least `REST_DURATION_MIN_S`. The platform may still sway then: rest refers to the
    winches.

    Attributes:
        resting: shape (N,).
        rests: First and one past the last sample of each rest.
    """

    resting: NDArray[np.bool_]
    rests: tuple[tuple[int, int], ...]


def find_phases(time: Array, length: Array) -> Phases:
    """Tell rests from moves.

    Args:
        time: Strictly increasing [s], shape (N,).
        length: Cable lengths [m], shape (N, n).
    """
    slow = np.abs(slope(time, length)).max(axis=1) < REST_SPEED_MAX_M_S
    edges = np.flatnonzero(np.diff(np.concatenate([[False], slow, [False]]).astype(int)))
    runs = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    rests = tuple((a, b) for a, b in runs if time[b - 1] - time[a] >= REST_DURATION_MIN_S)
    resting = np.zeros(len(time), dtype=np.bool_)
    for first, end in rests:
        resting[first:end] = True
    return Phases(resting=resting, rests=rests)


def anchors_at(robot: Robot, position: Array, rotation: Array) -> Array:
    """Return the anchor points of poses (N, 3) and (N, 3, 3) in W [m], shape (N, n, 3)."""
    return np.asarray(position[:, None] + robot.anchor_points @ rotation.swapaxes(1, 2))


def anchor_speed(robot: Robot, time: Array, position: Array, rotation: Array) -> Array:
    """Return the speed of the fastest anchor point at each measured pose [m/s], shape (N,).

    Anchor points, so that a platform that only turns moves too.

    Args:
        robot: Robot description.
        time: Strictly increasing [s], shape (N,).
        position: Platform origin in W [m], shape (N, 3).
        rotation: From P to W, shape (N, 3, 3).
    """
    anchors = anchors_at(robot, position, rotation)
    rate = slope(time, anchors.reshape(len(time), -1)).reshape(anchors.shape)
    return np.asarray(np.linalg.norm(rate, axis=2).max(axis=1))


def summed_turns(rotation: Array) -> Array:
    """Return rotation vectors from pose to pose, summed up from 0 at the first [rad], (K, 3).

    Their rate is the angular velocity in W, for turns of any size.

    Args:
        rotation: From P to W, shape (K, 3, 3).
    """
    from scipy.spatial.transform import Rotation

    steps = Rotation.from_matrix(rotation[1:] @ rotation[:-1].swapaxes(1, 2)).as_rotvec()
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def slope(time: Array, value: Array, window: float = SLOPE_WINDOW_S) -> Array:
    """Return the rate of change at each sample, exact for straight lines and robust to noise.

    The mean of the samples up to `window` later less the mean of those up to `window` earlier,
    at least one each, over the distance of their mean times; one-sided at the ends.

    Args:
        time: Strictly increasing [s], shape (N,).
        value: shape (N, K).
        window: [s].

    Returns:
        Rate [unit of value per s], shape (N, K).
    """
    count = len(time)
    if count < 2:
        return np.zeros(value.shape)
    index = np.arange(count)
    first = np.minimum(np.searchsorted(time, time - window), np.maximum(index - 1, 0))
    last = np.maximum(
        np.searchsorted(time, time + window, side="right"), np.minimum(index + 2, count)
    )
    before_end = np.maximum(index, 1)  # at the first sample, the sample itself
    after_start = np.minimum(index + 1, count - 1)
    both = np.column_stack([time - time[0], value - value[0]])
    total = np.concatenate([np.zeros((1, both.shape[1])), np.cumsum(both, axis=0)])
    after = (total[last] - total[after_start]) / (last - after_start)[:, None]
    before = (total[before_end] - total[first]) / (before_end - first)[:, None]
    change = after - before
    return np.asarray(change[:, 1:] / change[:, :1])
