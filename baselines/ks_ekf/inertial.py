r"""Motion from inertial samples, and from the IMU to the platform's origin.

With left rotation errors :math:`R = \exp([\delta\theta]_\times) \hat R` in W, of a state that sits
at the IMU,

.. math:: \dot{\delta p} = \delta v, \quad
          \dot{\delta v} = -[\hat R (f - b_a)]_\times \delta\theta - \hat R\, \delta b_a, \quad
          \dot{\delta\theta} = -\hat R\, \delta b_g .

References:
    Sola, *Quaternion kinematics for the error-state Kalman filter*, arXiv:1711.02508, 2017.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from baselines.ks_ekf.error_filter import ErrorFilter
from baselines.ks_ekf.filter_settings import FilterSettings
from baselines.ks_ekf.filter_state import (
    FORCE_BIAS_ERRORS,
    LENGTH_ERRORS,
    NO_SAMPLES,
    POSITION_ERRORS,
    RATE_BIAS_ERRORS,
    ROTATION_ERRORS,
    VELOCITY_ERRORS,
    InertialSamples,
    KsEkfState,
)
from baselines.ks_ekf.timed_lengths import TIME_TOLERANCE_S
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import cross_matrix
from carosac_toolkit.loop.values import Measurement

MINUTE_S = 60.0
SLOPE_INTERVALS_MIN = 1.5  # to both sides: three samples


def samples_of(measurement: Measurement, settings: FilterSettings) -> InertialSamples:
    """Return the inertial samples of a measurement, if any, in the axes of the platform."""
    imu = measurement.imu
    if imu is None:
        return NO_SAMPLES
    turn = settings.imu_rotation.T
    order = np.argsort(imu.time[0], kind="stable")
    return InertialSamples(
        time=imu.time[0][order],
        rate=imu.angular_rate[0][order] @ turn,
        force=imu.specific_force[0][order] @ turn,
    )


class InertialMotion:
    """Carries a state along inertial samples."""

    def __init__(
        self, gravity: float, settings: FilterSettings, size: int, kalman: ErrorFilter
    ) -> None:
        """Note the noise.

        Args:
            gravity: Along -z of W [m/s^2].
            settings: Noise of the sensors.
            size: Number of errors.
            kalman: What carries the covariance.
        """
        self._kalman = kalman
        self._gravity = np.array([0.0, 0.0, -gravity])
        walk = settings.bias_walk**2 / MINUTE_S
        steady, growing = np.zeros(size), np.zeros(size)
        steady[ROTATION_ERRORS] = settings.angular_rate_noise**2
        steady[VELOCITY_ERRORS] = settings.specific_force_noise**2
        growing[RATE_BIAS_ERRORS] = walk * settings.angular_rate_bias**2
        growing[FORCE_BIAS_ERRORS] = walk * settings.specific_force_bias**2
        growing[LENGTH_ERRORS] = settings.length_walk**2 / MINUTE_S
        self._noise = np.diag(steady), np.diag(growing)
        drift = np.zeros(size)
        drift[ROTATION_ERRORS] = settings.rate_change**2
        drift[VELOCITY_ERRORS] = settings.force_change**2
        self._held = np.diag(drift)

    def advance(self, state: KsEkfState, until: float) -> KsEkfState:
        """Go to a time [s] with the samples that the state has; after the last one, it is held."""
        samples = state.samples
        self._kalman.begin(state.covariance)
        start = samples.at(state.time)
        for time, rate, force in zip(samples.time, samples.rate, samples.force, strict=True):
            if state.time + TIME_TOLERANCE_S < time <= until + TIME_TOLERANCE_S:
                state = self._step(state, time - state.time, start, (rate, force))
                start = (rate, force)
        if until - state.time > TIME_TOLERANCE_S:
            end, held = samples.at(until), until - float(samples.time[-1])
            state = self._step(state, until - state.time, start, end, max(held, 0.0))
        return replace(state, covariance=self._kalman.covariance, samples=samples.after(state.time))

    def _step(
        self,
        state: KsEkfState,
        h: float,
        start: tuple[Array, Array],
        end: tuple[Array, Array],
        held: float = 0.0,
    ) -> KsEkfState:
        """Integrate h seconds by the trapezoidal rule, to an end `held` after any sample [s]."""
        import pinocchio

        turn = h * (0.5 * (start[0] + end[0]) - state.rate_bias)
        rotation = state.rotation @ pinocchio.exp3(turn)
        first = state.rotation @ (start[1] - state.force_bias)
        last = rotation @ (end[1] - state.force_bias)
        force = 0.5 * (first + last)
        gained = (2.0 * first + last) / 6.0 + 0.5 * self._gravity
        bend, size = pinocchio.Jexp3(turn), len(state.covariance)
        change = self._transition(state.rotation, rotation, bend, force, h, size)
        noise = h * h * self._noise[0] + h * self._noise[1]
        self._kalman.predict(change, noise + (h * held) ** 2 * self._held)
        return replace(
            state,
            time=state.time + h,
            position=state.position + h * state.velocity + h * h * gained,
            rotation=rotation,
            velocity=state.velocity + h * (force + self._gravity),
        )

    def _transition(
        self, before: Array, after: Array, bend: Array, force: Array, h: float, size: int
    ) -> Array:
        """Return the Jacobian of a step, shape (size, size)."""
        matrix = np.eye(size)
        lean = -h * cross_matrix(force)
        middle = -0.5 * h * (before + after)
        matrix[POSITION_ERRORS, VELOCITY_ERRORS] = h * np.eye(3)
        matrix[POSITION_ERRORS, ROTATION_ERRORS] = 0.5 * h * lean
        matrix[POSITION_ERRORS, FORCE_BIAS_ERRORS] = 0.5 * h * middle
        matrix[VELOCITY_ERRORS, ROTATION_ERRORS] = lean
        matrix[VELOCITY_ERRORS, FORCE_BIAS_ERRORS] = middle
        matrix[ROTATION_ERRORS, RATE_BIAS_ERRORS] = -h * after @ bend
        return matrix


def slope(samples: InertialSamples, time: float, reach: float) -> Array:
    """Fit the angular acceleration in P [rad/s^2], shape (3,), to samples within `reach`.

    Args:
        samples: Also those later than the time.
        time: [s].
        reach: To both sides [s]; farther where samples are so rare that they would not be three.
    """
    if len(samples) > 1:
        interval = float(samples.time[-1] - samples.time[0]) / (len(samples) - 1)
        reach = max(reach, SLOPE_INTERVALS_MIN * interval)
    near = np.abs(samples.time - time) <= reach
    offset = samples.time[near] - samples.time[near].mean() if near.any() else np.zeros(0)
    spread = float(offset @ offset)
    return offset @ samples.rate[near] / spread if spread > 0.0 else np.zeros(3)
