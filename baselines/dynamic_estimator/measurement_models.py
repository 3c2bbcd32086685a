"""Measurement models of IMU and poses, and the transition of errors: for filter and smoother."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from baselines.dynamic_estimator.filter_state import DynamicFilterState
from baselines.dynamic_estimator.model import DynamicModel, LinearisedStep
from baselines.dynamic_estimator.settings import DynamicEstimatorSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.physics.scales import Scales

# Vibrations of the stretch, which turn the gyroscope.
STRETCH_RATE_NOISE = Scaled(0.06, "m/s")


class ImuMean(NamedTuple):
    """Mean of some IMU samples.

    Attributes:
        values: Angular rate [rad/s] and specific force [m/s^2] in its axes, shape (6,).
        samples: How many.
    """

    values: Array
    samples: int = 1


class LinearisedMeasurement(NamedTuple):
    """Measurement to first order in the errors.

    Attributes:
        residual: Measured minus expected, shape (k,).
        by: Its change per error, shape (k, size).
        noise: Covariance of its own, shape (k, k).
        by_pose: Change of what is expected per change of the pose [m, rad], shape (k, 6); None: not
            told.
    """

    residual: Array
    by: Array
    noise: Array
    by_pose: Array | None = None


class MeasurementModels:
    """Measurements of one robot, with their noise."""

    def __init__(self, model: DynamicModel, settings: DynamicEstimatorSettings) -> None:
        """Take the numbers of the sensors."""
        self._errors, self._settings, s = model.errors, settings, settings
        self._imu = np.repeat([s.angular_rate_noise**2, s.specific_force_noise**2], 3)
        self._vibration = np.repeat([s.angular_vibration**2, s.vibration**2], 3)
        self._poses = np.repeat([s.position_noise**2, s.rotation_noise**2], 3)
        self._tension = s.tension_noise * model.robot.weight
        self._stretch_rate = STRETCH_RATE_NOISE.of(Scales(model.robot).ratios)

    def carried(self, move: LinearisedStep, duration: float) -> tuple[Array, float]:
        """Return the transition matrix of the errors over a step, and the share of wind left.

        Args:
            move: The step.
            duration: Of it [s].
        """
        where = self._errors
        carry = np.eye(where.size)
        carry[where.motion, : where.moving] = move.sway
        keep = float(np.exp(-duration / self._settings.wind_time))
        carry[where.wind, where.wind] *= keep
        return carry, keep

    def felt(self, move: LinearisedStep, felt: ImuMean) -> LinearisedMeasurement:
        """Linearise the IMU at the end of a step in the errors at its start."""
        where = self._errors
        by = np.zeros((6, where.size))
        by[:, : where.moving] = move.felt_by
        by[:, where.imu] = np.eye(6)
        pulled = self._tension * move.pulled
        stretched = self._stretch_rate * move.stretched
        noise = np.diag(self._imu / felt.samples + self._vibration)
        noise += pulled @ pulled.T + stretched @ stretched.T
        return LinearisedMeasurement(felt.values - move.felt - move.state.imu_bias, by, noise)

    def pose(
        self, state: DynamicFilterState, position: Array, rotation: Array
    ) -> LinearisedMeasurement:
        """Linearise a pose that was measured at the time of a state.

        Args:
            state: The estimate.
            position: Platform origin in W [m], shape (3,).
            rotation: From P to W, shape (3, 3).
        """
        import pinocchio

        turn = pinocchio.log3(np.ascontiguousarray(rotation @ state.rotation.T))
        rigid = self._settings.stretch_deviation * state.sway.slaved
        return LinearisedMeasurement(
            residual=np.concatenate([position - state.position, turn]),
            by=state.pose_by(),
            noise=np.diag(self._poses) + rigid @ rigid.T,
            by_pose=np.eye(6),
        )
