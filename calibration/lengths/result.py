"""The result of a calibration from lengths."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.lengths.unknowns import LengthUnknowns
from calibration.result import CalibrationResult
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import from_rotation_vector
from carosac_toolkit.robot.robot import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class Gravity:
    """Direction of gravity in the frame of the measured poses.

    Attributes:
        tilt: Rotation of that frame about x and y against one with z up [rad], shape (2,).
        sigma: One standard deviation [rad], shape (2,).
        before: The same before the calibration, shape (2,).
    """

    tilt: Array
    sigma: Array
    before: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class LengthCalibration(CalibrationResult):
    """A calibrated robot with its evidence; S samples that were used, n cables.

    Attributes:
        unknowns: All parameters, with their priors.
        gravity: Of the frame of the poses, or None where nothing depends on it.
        anchored: True if exit points are in a frame of their own; if not, W is that of the poses.
        sample: Number of each used sample in the recording, shape (S,).
        time: [s], shape (S,).
        position: Measured, of the platform origin, in W [m], shape (S, 3).
        residual: Reading less prediction [m], shape (S, n).
        residual_before: The same with the robot as it was, medians taken out where the readings
            are relative, shape (S, n).
        outlier: Readings that were left out, shape (S, n).
        deviation: Residuals in standard deviations of their readings, shape (S, n).
        balance_outlier: Samples whose balance was left out, shape (S,).
        length_noise: One standard deviation of a reading [m].
        balance_noise: Of the balance of the platform [rad], or None where it tells nothing.
        inflation: Number of samples that tell as much as one independent sample.
        notes: What else should be known about the data, in words.
        skipped: Samples without a pose or without tensions, by reason.
        rounds: Of reweighting.
        converged: True if the last round changed nothing.
        covariance: Of all unknowns, gravity included, shape (k, k).
        seconds: Duration of the fit [s].
    """

    unknowns: LengthUnknowns
    gravity: Gravity | None
    anchored: bool
    sample: NDArray[np.int64]
    time: Array
    position: Array
    residual: Array
    residual_before: Array
    outlier: NDArray[np.bool_]
    deviation: Array
    balance_outlier: NDArray[np.bool_]
    length_noise: float
    balance_noise: float | None
    inflation: float
    notes: tuple[str, ...]
    skipped: dict[str, int]
    rounds: int
    converged: bool
    covariance: Array
    seconds: float

    @property
    def level(self) -> Robot:
        """The calibrated robot in a W whose z is up: that of the file may be of tilted poses.

        Its covariances, which are of the other W, are dropped.
        """
        if self.anchored or self.gravity is None:
            return self.robot
        turn = from_rotation_vector(np.append(self.gravity.tilt, 0.0))
        before = np.eye(3) if self.robot.pose_rotation is None else self.robot.pose_rotation
        return replace(
            self.robot,
            exit_points=self.robot.exit_points @ turn.T,
            swivel_axis=self.robot.swivel_axis @ turn.T,
            home_position=turn @ self.robot.home_position,
            home_rotation=turn @ self.robot.home_rotation,
            pose_rotation=turn @ before,
            exit_covariance=None,
            calibrated=None,
            calibration_covariance=None,
        )

    @property
    def residual_rms(self) -> float:
        """Root mean square of the residuals of the readings that were kept [m]."""
        return float(np.sqrt(np.mean(self.residual[~self.outlier] ** 2)))

    @property
    def residual_rms_before(self) -> float:
        """The same with the robot as it was [m]."""
        return float(np.sqrt(np.mean(self.residual_before[~self.outlier] ** 2)))

    def outliers(self) -> list[dict[str, Any]]:
        """Return the readings that were left out, ready for JSON, in the order of time."""
        return [
            {
                "sample": int(self.sample[row]),
                "time_s": float(self.time[row]),
                "cable": self.robot.cable_names[cable],
                "residual_m": float(self.residual[row, cable]),
                "sigmas": float(abs(self.deviation[row, cable])),
            }
            for row, cable in np.argwhere(self.outlier)
        ]

    def data(self) -> dict[str, Any]:
        """Return all numbers, ready for JSON."""
        gravity = None
        if self.gravity is not None:
            gravity = {"tilt_rad": self.gravity.tilt, "sigma_rad": self.gravity.sigma}
        return {
            "positions_m": dict(zip(map(str, self.sample), self.position.tolist(), strict=True)),
            "residual_rms_m": self.residual_rms,
            "residual_rms_before_m": self.residual_rms_before,
            "parameters": self.estimate.data(),
            "gravity": gravity,
            "frame": "robot" if self.anchored else "poses",
            "observability": {**self.observability.data(), "sentences": list(self.notes)},
            "outliers": self.outliers(),
            "samples": len(self.sample),
            "skipped": self.skipped,
            "noise": {
                "length_m": self.length_noise,
                "balance_rad": self.balance_noise,
                "inflation": self.inflation,
            },
            "rounds": self.rounds,
            "converged": self.converged,
            "warnings": list(self.warnings),
            "fit_s": self.seconds,
        }

    def sentences(self) -> list[str]:
        """Return what was found, in words."""
        count = int(self.outlier.sum())
        lines = [
            f"readings fit within {1e3 * self.residual_rms:.2f} mm RMS; with the robot as it was "
            f"{1e3 * self.residual_rms_before:.1f} mm",
            f"noise of one reading: {1e3 * self.length_noise:.2f} mm; {count} of "
            f"{self.outlier.size} readings were left out as blunders",
        ]
        if "length_delay" in self.estimate.names:
            row = self.estimate.index("length_delay")
            value, sigma = 1e3 * self.estimate.value[row], 1e3 * self.estimate.sigma[row]
            lines.append(
                f"readings lead the measured poses by {value:.1f} ms (1 sigma {sigma:.1f} ms)"
            )
        if self.inflation > 1.0:
            lines.append(
                f"residuals are correlated in time: {self.inflation:.1f} samples count as one"
            )
        if self.gravity is not None:
            x, y = 1e3 * self.gravity.tilt
            lines.append(
                f"the frame of the poses is tilted against gravity by {x:.1f} and {y:.1f} mrad "
                f"about x and y (1 sigma {1e3 * self.gravity.sigma.max():.1f} mrad)"
            )
        if not self.anchored:
            lines.append(
                "the exit points are in the frame of the measured poses; covariances of the exit "
                "points in the robot file, as from a tachymeter, would make it the robot's own"
            )
        lines += [f"left unused: {n} samples with {why}" for why, n in self.skipped.items() if n]
        return lines
