"""Readings with the measured pose that belongs to each, at any delay between the two."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.rotations import to_matrix
from carosac_toolkit.recordings.columns import POSE_COLUMNS_TEXT
from carosac_toolkit.recordings.recording import Recording

POSE_GAP_MAX_S = 0.5  # [s]: across a longer one nothing is interpolated
LONE_POSE_DISTANCE_MAX_S = 0.05  # [s]: a lone pose belongs to readings this near
SPLINE_STAMPS_MIN = 4  # stamps: fewer in a row are lone poses


@dataclass(frozen=True, kw_only=True, eq=False)
class PosesAt:
    """Measured poses at S times, in their own frame F.

    Attributes:
        position: [m], shape (S, 3).
        rotation: From P to F, shape (S, 3, 3).
        twist: In F, at the platform origin [m/s, rad/s], (S, 6); zero at lone poses.
        valid: True if there is a pose, shape (S,).
    """

    position: Array
    rotation: Array
    twist: Array
    valid: NDArray[np.bool_]


class PosePath:
    """Measured poses as a smooth path where they are dense, and as lone poses where they are not.

    Cubic splines: at 4 Hz a straight line between two poses of a swinging platform is off by
    several millimetres.
    """

    def __init__(self, recording: Recording) -> None:
        """Fit the splines.

        Raises:
            InvalidField: A recording without poses.
        """
        from scipy.interpolate import CubicSpline

        if recording.poses is None:
            raise InvalidField("poses", None, POSE_COLUMNS_TEXT)
        poses = recording.poses
        self._time = poses.time
        quaternion = poses.quaternion / np.linalg.norm(poses.quaternion, axis=1, keepdims=True)
        turns = np.sign((quaternion[1:] * quaternion[:-1]).sum(axis=1))
        signs = np.cumprod(np.concatenate([[1.0], np.where(turns < 0.0, -1.0, 1.0)]))
        self._value = np.hstack([poses.position, quaternion * signs[:, None]])
        edges = np.flatnonzero(np.diff(self._time) > POSE_GAP_MAX_S) + 1
        starts, ends = [0, *edges.tolist()], [*edges.tolist(), len(self._time)]
        self._splines = [
            (self._time[a], self._time[b - 1], CubicSpline(self._time[a:b], self._value[a:b]))
            for a, b in zip(starts, ends, strict=True)
            if b - a >= SPLINE_STAMPS_MIN
        ]
        lone = [
            k
            for a, b in zip(starts, ends, strict=True)
            if b - a < SPLINE_STAMPS_MIN
            for k in range(a, b)
        ]
        self._lone = np.array(lone, dtype=np.int64)

    def at(self, time: Array, delay: float) -> PosesAt:
        """Return the poses that belong to readings.

        Args:
            time: Of the readings [s], shape (S,).
            delay: The pose of a reading at t is the one at t + delay [s].
        """
        value = np.zeros((len(time), 7))
        value[:, 3] = 1.0
        rate, valid = np.zeros((len(time), 7)), np.zeros(len(time), dtype=np.bool_)
        self._fill_lone(time, value, valid)
        when = time + delay
        for first, last, spline in self._splines:
            inside = (when >= first) & (when <= last)
            value[inside], rate[inside] = spline(when[inside]), spline(when[inside], 1)
            valid |= inside
        norm = np.linalg.norm(value[:, 3:], axis=1, keepdims=True)
        quaternion, turning = value[:, 3:] / norm, rate[:, 3:] / norm
        return PosesAt(
            position=value[:, :3],
            rotation=to_matrix(quaternion),
            twist=np.hstack([rate[:, :3], _angular(quaternion, turning)]),
            valid=valid,
        )

    def _fill_lone(self, time: Array, value: Array, valid: NDArray[np.bool_]) -> None:
        """Give lone poses, of a platform at rest, to the readings around them."""
        if not len(self._lone):
            return
        stamps = self._time[self._lone]
        right = np.clip(np.searchsorted(stamps, time), 0, len(stamps) - 1)
        left = np.maximum(right - 1, 0)
        nearest = np.where(np.abs(stamps[left] - time) < np.abs(stamps[right] - time), left, right)
        near = np.abs(stamps[nearest] - time) <= LONE_POSE_DISTANCE_MAX_S
        value[near] = self._value[self._lone[nearest[near]]]
        valid |= near


def _angular(quaternion: Array, rate: Array) -> Array:
    """Return the angular velocity in F [rad/s], (S, 3): the vector part of 2 dq/dt q*."""
    w, v = quaternion[:, :1], quaternion[:, 1:]
    dw, dv = rate[:, :1], rate[:, 1:]
    return np.asarray(2.0 * (w * dv - dw * v - np.cross(dv, v)))
