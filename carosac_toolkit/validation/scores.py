"""Scores of pose and length errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.consistency import normalised_square
from carosac_toolkit.loop.values import Pose

SCORE_AXES = ("x", "y", "z", "norm")


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseScores:
    """Pose error of a model over some samples; axes in order x, y, z of W, then the norm.

    Attributes:
        samples: Number of scored samples; every other number is NaN where it is 0.
        bias: Mean of model minus measured position [m], shape (3,).
        rmse: Root mean square [m], shape (4,).
        mae: Mean of the absolute value [m], shape (4,).
        max: Largest absolute value [m], shape (4,).
        orientation_rmse: Root mean square of the angle of R_measured^T R_model [rad].
        orientation_max: [rad].
    """

    samples: int
    bias: Array
    rmse: Array
    mae: Array
    max: Array
    orientation_rmse: float
    orientation_max: float

    def data(self) -> dict[str, Any]:
        """Return the numbers under names with units, ready for JSON."""
        return {
            "samples": self.samples,
            "bias_m": by_axis(self.bias),
            "rmse_m": by_axis(self.rmse),
            "mae_m": by_axis(self.mae),
            "max_m": by_axis(self.max),
            "orientation_rmse_rad": self.orientation_rmse,
            "orientation_max_rad": self.orientation_max,
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class LengthScores:
    """Measured minus predicted cable lengths over some samples.

    Attributes:
        rmse: Over all cables and samples [m].
        bias: Mean per cable [m], shape (n,).
        std: Standard deviation per cable [m], shape (n,).
        samples: Per cable, shape (n,).
    """

    rmse: float
    bias: Array
    std: Array
    samples: Array

    def data(self, names: tuple[str, ...]) -> dict[str, Any]:
        """Return the numbers under names with units, ready for JSON."""
        return {
            name: {"bias_m": self.bias[i], "std_m": self.std[i], "samples": int(self.samples[i])}
            for i, name in enumerate(names)
        }


def by_axis(values: Array) -> dict[str, float]:
    """Name the entries x, y, z and, where there are four, norm."""
    return {axis: float(value) for axis, value in zip(SCORE_AXES, values, strict=False)}


def score_poses(error: Array, angle: Array) -> PoseScores:
    """Score position errors [m], shape (S, 3), and orientation errors [rad], shape (S,)."""
    samples = len(error)
    if samples == 0:
        unknown = np.full(4, np.nan)
        return PoseScores(
            samples=0, bias=unknown[:3], rmse=unknown, mae=unknown, max=unknown,
            orientation_rmse=np.nan, orientation_max=np.nan,
        )  # fmt: skip
    size = np.column_stack([np.abs(error), np.linalg.norm(error, axis=1)])
    return PoseScores(
        samples=samples,
        bias=error.mean(axis=0),
        rmse=np.sqrt((size**2).mean(axis=0)),
        mae=size.mean(axis=0),
        max=size.max(axis=0),
        orientation_rmse=float(np.sqrt((angle**2).mean())),
        orientation_max=float(angle.max()),
    )


def score_lengths(error: Array) -> LengthScores:
    """Score length errors [m], shape (S, n); NaN is a cable without a prediction."""
    known = np.isfinite(error)
    count = known.sum(axis=0)
    some = np.where(count > 0, count, 1)
    filled = np.where(known, error, 0.0)
    bias = np.where(count > 0, filled.sum(axis=0) / some, np.nan)
    spread = np.where(known, error - bias, 0.0)
    std = np.where(count > 0, np.sqrt((spread**2).sum(axis=0) / some), np.nan)
    total = int(count.sum())
    rmse = float(np.sqrt((filled**2).sum() / total)) if total else np.nan
    return LengthScores(rmse=rmse, bias=bias, std=std, samples=count.astype(np.float64))


def normalised_pose_squares(
    measured: Pose, model: Pose, covariance: Array, noise: tuple[float, float]
) -> Array:
    """Return the normalised squares of pose errors per degree of freedom, shape (S,).

    Args:
        measured: S poses.
        model: S poses.
        covariance: Of the model's errors as in `Belief`, shape (S, 6, 6).
        noise: Of the measured poses, per axis: positions [m] and rotations [rad].

    Raises:
        InvalidField: A covariance that is not positive definite.
    """
    from scipy.spatial.transform import Rotation

    turned = measured.rotation @ model.rotation.swapaxes(1, 2)
    turn = Rotation.from_matrix(turned).as_rotvec()
    error = np.hstack([measured.position - model.position, turn])
    own = np.diag(np.repeat(np.square(noise), 3))
    return normalised_square(error, covariance + own)


def rotation_angle(measured: Array, model: Array) -> Array:
    """Return the angle of R_measured^T R_model [rad], shape (S,), exact for small angles too."""
    chordal = np.linalg.norm(measured - model, axis=(1, 2))  # 2 sqrt(2) sin(angle / 2)
    return np.asarray(2.0 * np.arcsin(np.clip(chordal / np.sqrt(8.0), 0.0, 1.0)))
