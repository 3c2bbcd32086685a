"""Measured poses of the platform with their time stamps, and interpolation between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carosac_toolkit.base import rotations
from carosac_toolkit.base.arrays import Array, batch, frozen_array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.values import Pose

UNIT_NORM_TOLERANCE = 1e-3  # rounded quaternions are accepted, and normalised where they are used


def check_unit_norm(name: str, quaternion: Array) -> None:
    """Refuse quaternions (M, 4) that are no rotation.

    Raises:
        InvalidField: Names the first one.
    """
    norm = np.linalg.norm(quaternion, axis=1)
    bad = ~(np.abs(norm - 1.0) <= UNIT_NORM_TOLERANCE)
    if bad.any():
        index = int(np.argmax(bad))
        allowed = f"a norm within {UNIT_NORM_TOLERANCE:g} of 1"
        raise InvalidField(f"{name}[{index}]", f"norm {norm[index]:.6g}", allowed)


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseInterpolation:
    """Poses between measured ones, and whether they may be trusted.

    Attributes:
        pose: Interpolated; where `valid` is False, the pose of the nearer stamp.
        valid: False outside the measured range and inside gaps that are too long, shape (B,).
    """

    pose: Pose
    valid: NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseSamples:
    """Measured poses; the quaternions are kept as they were written, so that files round trip.

    Attributes:
        time: Strictly increasing [s], shape (M,).
        position: Platform origin in world frame W [m], shape (M, 3).
        quaternion: From platform frame P to W, order w x y z, of unit norm, shape (M, 4).
    """

    time: Array
    position: Array
    quaternion: Array

    def __post_init__(self) -> None:
        """Freeze the arrays and refuse quaternions that are no rotation."""
        m = len(self.time)
        for name, shape in (("time", (m,)), ("position", (m, 3)), ("quaternion", (m, 4))):
            array = frozen_array(f"poses.{name}", getattr(self, name), shape)
            object.__setattr__(self, name, array)
        check_unit_norm("poses.quaternion", self.quaternion)

    @classmethod
    def from_rotation(
        cls, time: ArrayLike, position: ArrayLike, rotation: ArrayLike
    ) -> PoseSamples:
        """Make samples from rotation matrices P to W, shape (M, 3, 3)."""
        matrix = batch("poses.rotation", rotation, (3, 3))
        product = matrix @ matrix.swapaxes(1, 2)
        bad = np.abs(product - np.eye(3)).max(axis=(1, 2)) > UNIT_NORM_TOLERANCE
        bad |= np.linalg.det(matrix) < 0
        if bad.any():
            where = f"poses.rotation[{int(np.argmax(bad))}]"
            raise InvalidField(where, "not a rotation matrix", "R R^T = 1, det +1")
        return cls(
            time=np.asarray(time, dtype=np.float64),
            position=np.asarray(position, dtype=np.float64),
            quaternion=rotations.from_matrix(matrix),
        )

    @cached_property
    def rotation(self) -> Array:
        """Rotation from P to W, shape (M, 3, 3)."""
        matrix = rotations.to_matrix(self.quaternion)
        return frozen_array("poses.rotation", matrix, matrix.shape)

    def at(self, time: ArrayLike, *, gap_max: float) -> PoseInterpolation:
        """Interpolate: positions linearly, rotations along the great arc.

        Args:
            time: When [s], shape (B,).
            gap_max: Longest distance of neighbouring stamps to interpolate across [s].

        Returns:
            Poses, shape (B, ...), and where they are valid.
        """
        if not gap_max > 0.0:
            raise InvalidField("gap_max", f"{gap_max} s", "gap_max > 0")
        when = batch("time", time, ())
        left = np.clip(np.searchsorted(self.time, when, side="right") - 1, 0, len(self.time) - 1)
        right = np.minimum(left + 1, len(self.time) - 1)
        gap = self.time[right] - self.time[left]
        inside = (when >= self.time[0]) & (when <= self.time[-1])
        exact = when == self.time[left]
        valid = inside & (exact | (gap <= gap_max))
        fraction = np.clip((when - self.time[left]) / np.where(gap > 0, gap, 1.0), 0.0, 1.0)
        fraction = np.where(valid, fraction, np.round(fraction))
        weight = fraction[:, None]
        position = (1 - weight) * self.position[left] + weight * self.position[right]
        between = rotations.slerp(self.quaternion[left], self.quaternion[right], fraction)
        pose = Pose(time=when, position=position, rotation=rotations.to_matrix(between))
        return PoseInterpolation(pose=pose, valid=valid)
