"""State that the filter carries from one measurement to the next."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.rest.statics import Equilibrium

POSITION_ERRORS = slice(0, 3)  # of the error state, all in W unless said otherwise [m]
ROTATION_ERRORS = slice(3, 6)  # log(R R_hat^T) [rad]
POSE_ERRORS = slice(0, 6)
VELOCITY_ERRORS = slice(6, 9)  # [m/s]
RATE_BIAS_ERRORS = slice(9, 12)  # in P [rad/s]
FORCE_BIAS_ERRORS = slice(12, 15)  # in P [m/s^2]
CENTER_ERRORS = slice(15, 18)  # of mass, in P [m]
LENGTH_ERRORS = slice(18, None)  # errors of the n lengths [m]
FIXED_ERROR_COUNT = 18  # entries before those of the lengths


@dataclass(frozen=True, kw_only=True, eq=False)
class InertialSamples:
    """Inertial samples in time order, axes of P.

    Attributes:
        time: [s], shape (K,).
        rate: Angular rate [rad/s], shape (K, 3).
        force: Specific force at the IMU [m/s^2], shape (K, 3).
    """

    time: Array
    rate: Array
    force: Array

    def __len__(self) -> int:
        return len(self.time)

    def keep(self, which: slice) -> InertialSamples:
        """Return a part of the samples."""
        return InertialSamples(
            time=self.time[which], rate=self.rate[which], force=self.force[which]
        )

    def after(self, time: float) -> InertialSamples:
        """Return the samples from the last one at or before a time on."""
        first = int(np.searchsorted(self.time, time + 1e-9, side="right")) - 1
        return self.keep(slice(max(first, 0), None))

    def joined(self, other: InertialSamples) -> InertialSamples:
        """Append later samples; leave out those that are not later than the last one."""
        new = other.time > (self.time[-1] + 1e-9 if len(self) else -np.inf)
        return InertialSamples(
            time=np.concatenate([self.time, other.time[new]]),
            rate=np.concatenate([self.rate, other.rate[new]]),
            force=np.concatenate([self.force, other.force[new]]),
        )

    def at(self, time: float) -> tuple[Array, Array]:
        """Interpolate angular rate and specific force at a time; outside take the nearest."""
        k = int(np.searchsorted(self.time, time))
        if k == 0 or k == len(self):
            k = min(k, len(self) - 1)
            return self.rate[k], self.force[k]
        share = (time - self.time[k - 1]) / (self.time[k] - self.time[k - 1])
        rate = self.rate[k - 1] + share * (self.rate[k] - self.rate[k - 1])
        return rate, self.force[k - 1] + share * (self.force[k] - self.force[k - 1])


NO_SAMPLES = InertialSamples(time=np.zeros(0), rate=np.zeros((0, 3)), force=np.zeros((0, 3)))


@dataclass(frozen=True, kw_only=True, eq=False)
class KsEkfState:
    """State of the filter at one time, for one robot of n cables.

    The filter stands at the time of the lengths used last; inertial samples after that wait in
    `samples` and take the belief from there to now.

    Attributes:
        time: [s].
        position: Of the IMU in W [m], shape (3,).
        rotation: From P to W, shape (3, 3).
        velocity: Of the IMU in W [m/s], shape (3,).
        rate_bias: Of the gyroscope, axes of P [rad/s], shape (3,).
        force_bias: Of the accelerometer, axes of P [m/s^2], shape (3,).
        center: Centre of mass minus that of the robot file, in P [m], shape (3,).
        length_bias: What the lengths say too much [m], shape (n,).
        covariance: Of the errors of all these, truth minus estimate, shape (18 + n, 18 + n).
        inertial: Whether inertial samples carry it; if not, it is at the pose of rest.
        twist: Linear and angular velocity of the platform origin in W, shape (6,), as the lengths
            move it from rest to rest; used where nothing inertial says more.
        twist_covariance: Of that twist, shape (6, 6).
        samples: Inertial samples from `time` on.
        solution: The last pose of rest, where the next solve starts, or None.
    """

    time: float
    position: Array
    rotation: Array
    velocity: Array
    rate_bias: Array
    force_bias: Array
    center: Array
    length_bias: Array
    covariance: Array
    inertial: bool
    twist: Array
    twist_covariance: Array
    samples: InertialSamples
    solution: Equilibrium | None = None

    def injected(self, error: Array, covariance: Array) -> KsEkfState:
        """Put an estimated error (18 + n,) into the state, and take its covariance over."""
        import pinocchio

        rotation = pinocchio.exp3(error[ROTATION_ERRORS]) @ self.rotation
        # The rotation error is now counted from another rotation.
        reset = np.eye(len(error))
        reset[ROTATION_ERRORS, ROTATION_ERRORS] = pinocchio.Jexp3(-error[ROTATION_ERRORS])
        moved = reset @ covariance @ reset.T
        return replace(
            self,
            position=self.position + error[POSITION_ERRORS],
            rotation=1.5 * rotation - 0.5 * rotation @ rotation.T @ rotation,  # without rounding
            velocity=self.velocity + error[VELOCITY_ERRORS],
            rate_bias=self.rate_bias + error[RATE_BIAS_ERRORS],
            force_bias=self.force_bias + error[FORCE_BIAS_ERRORS],
            center=self.center + error[CENTER_ERRORS],
            length_bias=self.length_bias + error[LENGTH_ERRORS],
            covariance=0.5 * (moved + moved.T),
        )

    def slipped(self, which: NDArray[np.bool_], deviation: float) -> KsEkfState:
        """Return the state with the lengths of cables whose encoders slipped less certain.

        Args:
            which: Cables, shape (n,).
            deviation: Of the estimated slip [m].
        """
        covariance = self.covariance.copy()
        covariance[LENGTH_ERRORS, LENGTH_ERRORS] += np.diag(np.where(which, deviation**2, 0.0))
        return replace(self, covariance=covariance)
