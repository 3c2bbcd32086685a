"""The result of a calibration from rests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.result import CalibrationResult
from calibration.sensor_errors import SENSOR_WORDS, SensorError, sensor_data
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import from_matrix


@dataclass(frozen=True, kw_only=True)
class SensorBlunder:
    """A reading that was left out.

    Attributes:
        rest: Number of the rest, from 0.
        sensor: ``length``, ``tension``, ``attitude``, ``inclination`` or ``swivel_angle``.
        cable: Its cable, or None for an orientation.
        sigmas: Distance from the solution in standard deviations of the sensor's noise.
    """

    rest: int
    sensor: str
    cable: str | None
    sigmas: float


@dataclass(frozen=True, kw_only=True, eq=False)
class RestCalibration(CalibrationResult):
    """Zeros of the lengths and poses of K rests of n cables.

    Attributes:
        time: Middle of each rest [s], shape (K,).
        position: Platform origin in W [m], shape (K, 3).
        rotation: From P to W, shape (K, 3, 3).
        pose_covariance: Of translation [m] and rotation vector in W [rad], shape (K, 6, 6).
        tension: Estimated, at the platform [N], shape (K, n).
        residual: Measured less predicted readings in standard deviations of the noise, (K, m) by
            sensor; NaN where one was left out.
        noise: Standard deviation of the readings by sensor [m, N, rad].
        sensors: Errors of the other sensors.
        blunders: Readings that were left out.
        misfit: Size of all residuals over that which their noise lets expect; about 1.
        redundancy: Readings beyond those that the unknowns take.
        relative: True if the lengths are known up to a constant each.
        single: True if each sample counted as a rest.
        skipped: Rests without a sample of a sensor, by sensor.
        unused: Measurements that were not used, in words.
        converged: True if the search settled.
        useless: True if the result is of no use, so that no robot file should be written.
        seconds: Duration of the search [s].
    """

    time: Array
    position: Array
    rotation: Array
    pose_covariance: Array
    tension: Array
    residual: Mapping[str, Array]
    noise: Mapping[str, Array | float]
    sensors: tuple[SensorError, ...]
    blunders: tuple[SensorBlunder, ...]
    misfit: float
    redundancy: int
    relative: bool
    single: bool
    skipped: Mapping[str, int]
    unused: tuple[str, ...]
    converged: bool
    useless: bool
    seconds: float

    @property
    def pose_sigma(self) -> Array:
        """One standard deviation of each pose, three of [m], three of [rad], shape (K, 6)."""
        return np.asarray(np.sqrt(np.einsum("kii->ki", self.pose_covariance)))

    @property
    def residual_rms(self) -> float:
        """Root mean square residual of the lengths that were used [m]."""
        return float(self.rms("length"))

    def rms(self, sensor: str) -> float:
        """Return the root mean square residual of the readings of a sensor that were used."""
        return float(np.sqrt(np.nanmean((self.residual[sensor] * self.noise[sensor]) ** 2)))

    def data(self) -> dict[str, Any]:
        """Return all numbers, ready for JSON."""
        sigma = self.pose_sigma
        return {
            "rests": len(self.time),
            "time_s": self.time,
            "positions_m": self.position,
            "positions_sigma_m": sigma[:, :3],
            "quaternions": from_matrix(self.rotation),
            "rotations_sigma_rad": sigma[:, 3:],
            "first_pose_covariance": self.pose_covariance[0],
            "tensions_N": self.tension,
            "residual_rms_m": self.residual_rms,
            "residual_rms": {name: self.rms(name) for name in self.residual},
            "misfit": self.misfit,
            "redundancy": self.redundancy,
            "parameters": self.estimate.data(),
            "sensors": sensor_data(self.sensors),
            "observability": self.observability.data(),
            "blunders": [vars(blunder) for blunder in self.blunders],
            "skipped": dict(self.skipped),
            "converged": self.converged,
            "useless": self.useless,
            "warnings": list(self.warnings),
            "fit_s": self.seconds,
        }  # fmt: skip

    def sentences(self) -> list[str]:
        """Return what was found, in words."""
        fits = []
        for name in self.residual:
            words, unit, factor = SENSOR_WORDS[name]
            fits.append(f"{words} within {factor * self.rms(name):.2g} {unit}")
        place, sigma = self.position[0], self.pose_sigma[0]
        spot = ", ".join(f"{x:.4f}" for x in place)
        known = ", ".join(f"{1e3 * x:.1f}" for x in sigma[:3])
        turned = ", ".join(f"{x:.2f}" for x in np.rad2deg(sigma[3:]))
        lines = [
            f"residuals, RMS: {', '.join(fits)}; {self.misfit:.2f} times what the noise says",
            f"at the first rest the platform is at {spot} m (1 sigma {known} mm), its rotation "
            f"known to {turned} degrees about x, y and z",
        ]
        lines += self._scales()
        if not any(name.startswith("exit_points") for name in self.estimate.names):
            lines.append(
                "exit points are held at the values of the robot file, which has no covariance of "
                "them: the sigmas do not include their errors"
            )
        lines += self.unused
        if self.single:
            lines.append("each sample counts as a rest, as samples are half a second or more apart")
        lines += [
            f"left unused: {count} rests without a sample of {SENSOR_WORDS[name][0]}"
            for name, count in self.skipped.items()
        ]
        return lines

    def _scales(self) -> list[str]:
        """Say what the load cells read."""
        scales = [sensor for sensor in self.sensors if sensor.name.startswith("tension_scale")]
        if not scales:
            return []
        values = [1.0 + scale.value for scale in scales]
        return [
            f"load cells read {min(values):.3f} to {max(values):.3f} of the tension, each known to "
            f"{max(scale.sigma for scale in scales):.1%} or better"
        ]
