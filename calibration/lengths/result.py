"""What a calibration from lengths found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.estimate import ParameterEstimate
from calibration.lengths.unknowns import LengthUnknowns
from calibration.observability import Observability
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.parameters import point_names
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
class LengthCalibration:
    """A calibrated robot with its evidence; S samples that were used, n cables.

    Attributes:
        robot: As calibrated.
        start: Before.
        unknowns: All parameters, with their priors.
        estimate: The parameters that go into the robot.
        gravity: Of the frame of the poses, or None where nothing depends on it.
        anchored: Whether exit points are in a frame of their own; if not, W is that of the poses.
        sample: Number of each used sample in the recording, shape (S,).
        time: [s], shape (S,).
        position: Measured, of the platform origin, in W [m], shape (S, 3).
        residual: Reading less prediction [m], shape (S, n).
        residual_before: The same with the robot as it was, medians taken out where the readings
            are relative, shape (S, n).
        outlier: Readings that were left out, shape (S, n).
        deviation: Residuals in standard deviations of their readings, shape (S, n).
        plumb_outlier: Samples whose balance was left out, shape (S,).
        length_noise: One standard deviation of a reading [m].
        plumb_noise: Of the balance of the platform [rad], or None where it tells nothing.
        inflation: How many samples tell as much as one independent one.
        observability: What the data can tell.
        sentences: The same, and what else should be known, in words.
        warnings: What must not be overlooked.
        skipped: Samples without a pose or without tensions, by reason.
        rounds: Of reweighting.
        converged: Whether the last round changed nothing.
        covariance: Of all unknowns, gravity included, shape (k, k).
        seconds: Duration of the fit [s].
    """

    robot: Robot
    start: Robot
    unknowns: LengthUnknowns
    estimate: ParameterEstimate
    gravity: Gravity | None
    anchored: bool
    sample: NDArray[np.int64]
    time: Array
    position: Array
    residual: Array
    residual_before: Array
    outlier: NDArray[np.bool_]
    deviation: Array
    plumb_outlier: NDArray[np.bool_]
    length_noise: float
    plumb_noise: float | None
    inflation: float
    observability: Observability
    sentences: tuple[str, ...]
    warnings: tuple[str, ...]
    skipped: dict[str, int]
    rounds: int
    converged: bool
    covariance: Array
    seconds: float

    @property
    def prior_exit_covariance(self) -> Array:
        """What was known of each exit point before [m^2], shape (n, 3, 3)."""
        if self.start.exit_covariance is not None:
            return self.start.exit_covariance
        names = point_names("exit_points", self.start.cable_names)
        prior = self.estimate.select(names).prior_sigma.reshape(-1, 3)
        return np.array([np.diag(row**2) for row in prior])

    @property
    def residual_rms(self) -> float:
        """Root mean square of the residuals of the readings that were kept [m]."""
        return float(np.sqrt(np.mean(self.residual[~self.outlier] ** 2)))

    @property
    def residual_rms_before(self) -> float:
        """The same with the robot as it was [m]."""
        return float(np.sqrt(np.mean(self.residual_before[~self.outlier] ** 2)))

    def outliers(self) -> list[dict[str, Any]]:
        """The readings that were left out, ready for JSON, in the order of time."""
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
        """Ready for JSON."""
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
            "observability": {**self.observability.data(), "sentences": list(self.sentences)},
            "outliers": self.outliers(),
            "samples": len(self.sample),
            "skipped": self.skipped,
            "noise": {
                "length_m": self.length_noise,
                "balance_rad": self.plumb_noise,
                "inflation": self.inflation,
            },
            "rounds": self.rounds,
            "converged": self.converged,
            "warnings": list(self.warnings),
            "fit_s": self.seconds,
        }
