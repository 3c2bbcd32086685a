"""Poses that a simulation is compared with, and by how much it misses them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.recordings.recording import Recording


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredPoses:
    """K measured poses in W, at times of length samples.

    Attributes:
        index: Of the length samples, shape (K,).
        time: [s], shape (K,).
        position: [m], shape (K, 3).
        rotation: From P to W, shape (K, 3, 3).
    """

    index: NDArray[np.int64]
    time: Array
    position: Array
    rotation: Array

    def rows(self, which: NDArray[np.int64]) -> MeasuredPoses:
        """Return the poses of some rows."""
        return MeasuredPoses(
            index=self.index[which],
            time=self.time[which],
            position=self.position[which],
            rotation=self.rotation[which],
        )

    def within(self, start: int, stop: int) -> MeasuredPoses:
        """Return the poses of length samples start <= i < stop."""
        return self.rows(np.flatnonzero((self.index >= start) & (self.index < stop)))

    def thinned(self, rate: float) -> MeasuredPoses:
        """Return as many poses as come at no more than a rate [Hz]."""
        kept, last = [], -np.inf
        for row, time in enumerate(self.time):
            if time - last >= (1.0 - 1e-6) / rate:
                kept.append(row)
                last = float(time)
        return self.rows(np.array(kept, dtype=np.int64))

    def turned(self, turn: Array) -> MeasuredPoses:
        """Return the poses in another W, to which a rotation (3, 3) turns."""
        return replace(
            self, position=self.position @ turn.T, rotation=np.asarray(turn @ self.rotation)
        )

    def errors(self, position: Array, rotation: Array) -> Array:
        """Return model minus measured: position [m], rotation vector of R_measured^T R [rad].

        Args:
            position: Of the model, shape (K, 3).
            rotation: Of the model, shape (K, 3, 3).

        Returns:
            shape (K, 6).
        """
        turned = rotation_vectors(self.rotation.swapaxes(1, 2) @ rotation)
        return np.concatenate([position - self.position, turned], axis=1)


def poses_of(recording: Recording) -> MeasuredPoses:
    """Return the measured poses at the length samples that have one nearby in time."""
    matched = recording.pose_at(recording.time)
    index = np.flatnonzero(matched.valid)
    return MeasuredPoses(
        index=index,
        time=recording.time[index],
        position=matched.pose.position[index],
        rotation=matched.pose.rotation[index],
    )


def rotation_vectors(rotation: Array) -> Array:
    """Return the rotation vectors [rad], shape (K, 3), of rotations (K, 3, 3) below half a turn."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotation, assume_valid=True).as_rotvec())
