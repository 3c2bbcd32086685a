"""Errors of a smoothed estimate against measured poses that it did not see."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from baselines.dynamic_estimator.settings import DynamicEstimatorSettings
from baselines.smoother.arranged_recording import nearest
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.validation.phases import find_phases
from carosac_toolkit.validation.scores import (
    PoseScores,
    normalised_pose_squares,
    rotation_angle,
    score_poses,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class SmoothingScores:
    """Errors in all, and apart with winches in motion and at rest.

    Attributes:
        parts: Errors by name: ``all``, ``moving``, ``resting``; without those that have no sample.
        nees: Mean normalised square of the pose error by the same names, 1 where the covariance
            tells the truth; the noise of the measured poses is in it.
    """

    parts: dict[str, PoseScores]
    nees: dict[str, float]

    def data(self) -> dict[str, Any]:
        """Return all numbers, ready for JSON."""
        return {name: {**part.data(), "nees": self.nees[name]} for name, part in self.parts.items()}


def score(
    recording: Recording,
    measured: Pose,
    estimate: Pose,
    covariance: Array,
    settings: DynamicEstimatorSettings,
) -> SmoothingScores:
    """Score an estimate.

    Args:
        recording: Its length samples say when the winches rest.
        measured: S poses with their times.
        estimate: Poses at the same times.
        covariance: Of pose and twist there, shape (S, 12, 12).
        settings: With the noise of measured poses.
    """
    if measured.time is None:
        raise InvalidField("measured.time", None, "the times of the poses")
    resting = find_phases(recording.time, recording.unstrained_length).resting
    resting = resting[nearest(recording.time, measured.time)]
    error = estimate.position - measured.position
    noise = settings.position_noise, settings.rotation_noise
    square = normalised_pose_squares(measured, estimate, covariance[:, :6, :6], noise)
    angle = rotation_angle(measured.rotation, estimate.rotation)
    parts = {"all": np.ones(len(error), dtype=np.bool_), "moving": ~resting, "resting": resting}
    some = {name: mask for name, mask in parts.items() if mask.any()}
    return SmoothingScores(
        parts={name: score_poses(error[mask], angle[mask]) for name, mask in some.items()},
        nees={name: float(square[mask].mean()) for name, mask in some.items()},
    )
