"""Result of a smoother."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from baselines.smoother.scores import SmoothingScores
from baselines.smoother.settings import SmootherSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.robot import Robot

AXIS_NAMES = ("x", "y", "z")
TOLD_DEVIATION_RATIO = 0.7  # to the assumed deviation: below it, the data determined a value


@dataclass(frozen=True, kw_only=True, eq=False)
class Smoothed:
    """A smoothed recording, at its N length samples; sigma is one standard deviation.

    Attributes:
        recording: The run as calibrated: lengths are material, poses in W.
        robot: As it was taken for, before anything was found.
        settings: Those it was smoothed with.
        time: [s], shape (N,).
        position: Platform origin in W [m], shape (N, 3).
        rotation: From P to W, shape (N, 3, 3).
        twist: Of the platform origin in W, linear first, shape (N, 6).
        covariance: Of [dp; log(R R_hat^T); dv; dw] in W, truth minus estimate, shape (N, 12, 12).
        tension: At the platform [N], shape (N, n).
        wind: Force of the wind along x and y of W [N], shape (N, 2).
        length_bias: What readings say too much, after calibration [m], shape (N, n).
        length_bias_sigma: Shape (N, n).
        wind_sigma: Per axis, in root mean square [N], shape (2,).
        mass: Of the platform [kg].
        mass_sigma: [kg].
        center_of_mass: In P [m], shape (3,).
        center_sigma: Shape (3,).
        imu_bias: Of gyroscope [rad/s] and accelerometer [m/s^2], shape (6,).
        delay: By how much lengths lead what else was measured [s].
        delay_sigma: [s]; 0: it was known.
        passes: Forward passes that were made.
        change: What the last of them would still have changed in a position [m].
        converged: Whether that is within the tolerance.
        inertial: Inertial measurements that were used.
        poses: Measured poses that were used.
        doubted: Those of them that are so far off that they count less than half.
        readings: Number of swivel angles, and orientations by an AHRS or inclinometer, that were
            used, by channel.
        doubted_readings: Those of them that are so far off that they count less than half.
        swivel_offset: What swivel angles say too much [rad], shape (n,); (0,) where none are used.
        swivel_offset_sigma: Of that [rad], shape (n,).
        mounting: Rotation from the frame of an AHRS or inclinometer to P, shape (3, 3); None where
            none is used.
        mounting_sigma: Of that, per axis of the sensor [rad], shape (3,).
        outliers: Length samples that were not believed.
        misfits: What shows that the robot does not belong to the recording.
        measured: Poses that were not used, at their times; None where there are none.
        compared: The estimate at the same times, or None.
        scores: How far the estimate is from them, or None.
    """

    recording: Recording
    robot: Robot
    settings: SmootherSettings
    time: Array
    position: Array
    rotation: Array
    twist: Array
    covariance: Array
    tension: Array
    wind: Array
    length_bias: Array
    length_bias_sigma: Array
    wind_sigma: Array
    mass: float
    mass_sigma: float
    center_of_mass: Array
    center_sigma: Array
    imu_bias: Array
    delay: float
    delay_sigma: float
    passes: int
    change: float
    converged: bool
    inertial: int
    poses: int
    doubted: int
    readings: Mapping[str, int]
    doubted_readings: Mapping[str, int]
    swivel_offset: Array
    swivel_offset_sigma: Array
    mounting: Array | None
    mounting_sigma: Array
    outliers: int
    misfits: tuple[str, ...]
    measured: Pose | None
    compared: Pose | None
    scores: SmoothingScores | None

    @property
    def sigma(self) -> Array:
        """Of pose and twist, shape (N, 12)."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2)))

    @property
    def told(self) -> dict[str, bool]:
        """True for what the data determined: its deviation is clearly below the assumed one."""
        known = self.settings.dynamics
        pairs = {
            "mass": (self.mass_sigma, known.mass * self.robot.mass),
            "center_of_mass": (self.center_sigma.max(), known.center_of_mass),
            "length_bias": (np.sqrt((self.length_bias_sigma**2).mean()), known.bias_deviation),
            "wind": (self.wind_sigma.max(), known.wind_force),
            "delay": (self.delay_sigma, self.settings.delay),
        }
        return {
            name: bool(0.0 < sigma < TOLD_DEVIATION_RATIO * prior)
            for name, (sigma, prior) in pairs.items()
        }

    def data(self) -> dict[str, Any]:
        """Return the main numbers, under names with units, ready for JSON."""
        mean = np.sqrt((self.sigma**2).mean(axis=0))
        return {
            "samples": len(self.time),
            "converged": self.converged,
            "passes": self.passes,
            "change_m": self.change,
            "inertial_measurements": self.inertial,
            "angles": {"used": dict(self.readings), "doubted": dict(self.doubted_readings)},
            "swivel_offset_rad": self.swivel_offset,
            "swivel_offset_sigma_rad": self.swivel_offset_sigma,
            "mounting": self.mounting,
            "mounting_sigma_rad": self.mounting_sigma,
            "poses": {"treatment": self.settings.poses, "used": self.poses,
                      "doubted": self.doubted},
            "length_outliers": self.outliers,
            "misfits": self.misfits,
            "found": self.told,
            "lag_s": self.settings.lag,
            "dynamics": asdict(self.settings.dynamics),
            "position_sigma_m": dict(zip(AXIS_NAMES, mean[:3], strict=True)),
            "orientation_sigma_rad": dict(zip(AXIS_NAMES, mean[3:6], strict=True)),
            "wind_N": {"rms": float(np.sqrt((self.wind**2).sum(axis=1).mean())),
                       "max": float(np.linalg.norm(self.wind, axis=1).max())},
            "length_bias_m": self.length_bias.mean(axis=0),
            "length_bias_sigma_m": np.sqrt((self.length_bias_sigma**2).mean(axis=0)),
            "mass_kg": self.mass,
            "mass_sigma_kg": self.mass_sigma,
            "center_of_mass_m": self.center_of_mass,
            "center_of_mass_sigma_m": self.center_sigma,
            "delay_s": self.delay,
            "delay_sigma_s": self.delay_sigma,
            "imu_bias": self.imu_bias if self.inertial else None,
            "scores": None if self.scores is None else self.scores.data(),
        }  # fmt: skip
