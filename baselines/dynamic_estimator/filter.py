"""The extended Kalman filter: prediction by the dynamics, correction by IMU and poses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from baselines.dynamic_estimator.filter_state import DynamicFilterState
from baselines.dynamic_estimator.measurement_models import ImuMean, MeasurementModels
from baselines.dynamic_estimator.model import DynamicModel, NoMotion
from baselines.dynamic_estimator.reading_models import READING_MODELS, prepared
from baselines.dynamic_estimator.settings import DynamicEstimatorSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.physics.scales import Scales

# By which twists change while a pose is late.
LATE_POSE_ACCELERATION = Scaled(2.0, "m/s^2")
LATE_POSE_ANGULAR_ACCELERATION = Scaled(5.0, "rad/s^2")


@dataclass(frozen=True, kw_only=True, eq=False)
class InnovationTally:
    """Sums of the innovations of several measurements.

    Attributes:
        squares: Sum of normalised innovations squared, of measurements within the gate.
        dof: Their degrees of freedom.
        disturbed: Measurements beyond the gate, or too late.
    """

    squares: float = 0.0
    dof: int = 0
    disturbed: int = 0

    def __add__(self, other: InnovationTally) -> InnovationTally:
        """Add two tallies."""
        return InnovationTally(
            squares=self.squares + other.squares,
            dof=self.dof + other.dof,
            disturbed=self.disturbed + other.disturbed,
        )


class DynamicFilter:
    """Steps of the filter for one robot."""

    def __init__(self, model: DynamicModel, settings: DynamicEstimatorSettings) -> None:
        """Take the dynamics and how wrong everything may be."""
        self._model = model
        self._settings = settings
        self._sensors = MeasurementModels(model, settings)
        ratios = Scales(model.robot).ratios
        late = LATE_POSE_ACCELERATION.of(ratios), LATE_POSE_ANGULAR_ACCELERATION.of(ratios)
        self._late_acceleration = np.repeat(late, 3)

    def step(
        self, state: DynamicFilterState, reading: Array, end: Array, duration: float,
        felt: ImuMean | None = None, *, inertial: bool = False,
    ) -> tuple[DynamicFilterState, InnovationTally]:  # fmt: skip
        """Predict, and correct by what the IMU felt at the end.

        Args:
            state: At the start.
            reading: Length readings at the start [m], shape (n,).
            end: Length readings at the end [m], shape (n,).
            duration: [s].
            felt: By the IMU, or None.
            inertial: Whether this leads to the time of what an IMU felt.

        Raises:
            NoMotion: The dynamics have no finite motion.
        """
        move = self._model.step(state, reading, end, duration)
        carry, keep = self._sensors.carried(move, duration)
        matrix = carry @ state.covariance @ carry.T + self.noise(duration, keep, inertial=inertial)
        arrived = replace(
            move.state,
            wind=keep * state.wind,
            covariance=0.5 * (matrix + matrix.T),
        )
        if felt is None:
            return arrived, InnovationTally()
        measurement = self._sensors.felt(move, felt)
        return self._corrected(
            arrived,
            carry @ state.covariance @ measurement.by.T,
            measurement.by @ state.covariance @ measurement.by.T + measurement.noise,
            measurement.residual,
        )

    def pose(
        self, state: DynamicFilterState, position: Array, rotation: Array, late: float = 0.0
    ) -> tuple[DynamicFilterState, InnovationTally]:
        """Correct by a measured pose.

        Args:
            state: The estimate.
            position: Platform origin in W [m], shape (3,).
            rotation: From P to W, shape (3, 3).
            late: How long before the time of the state it was measured [s]: it is moved on with
                the believed twist, and counts for less.
        """
        import pinocchio

        position = position + late * state.twist[:3]
        rotation = pinocchio.exp3(late * state.twist[3:]) @ rotation
        swept = 0.5 * late**2 * self._late_acceleration
        measurement = self._sensors.pose(state, position, rotation)
        cross = state.covariance @ measurement.by.T
        own = measurement.by @ cross + measurement.noise + np.diag(swept**2)
        return self._corrected(state, cross, own, measurement.residual)

    def reading(
        self, state: DynamicFilterState, channel: str, value: Array, late: float = 0.0
    ) -> tuple[DynamicFilterState, InnovationTally]:
        """Correct by a reading of another sensor.

        Args:
            state: The estimate.
            channel: One of `carosac_toolkit.loop.values.Measurement`, of `READING_MODELS`.
            value: As there, without its batch.
            late: How long before the time of the state it was measured [s]: it is moved on with the
                believed twist, and counts for less. Late tensions are not used.
        """
        robot = self._model.robot
        state = prepared(robot, state, channel, value)
        measurement = READING_MODELS[channel](robot, state, value, self._settings)
        residual, noise = measurement.residual, measurement.noise
        if late > 0.0:
            if measurement.by_pose is None:
                return state, InnovationTally(disturbed=1)
            swept = 0.5 * late**2 * self._late_acceleration
            residual = residual + late * measurement.by_pose @ state.twist
            noise = noise + measurement.by_pose @ np.diag(swept**2) @ measurement.by_pose.T
        cross = state.covariance @ measurement.by.T
        return self._corrected(state, cross, measurement.by @ cross + noise, residual)

    def noise(self, duration: float, keep: float, *, inertial: bool = False) -> Array:
        """Return the covariance that a step adds; a share `keep` of the wind remains.

        A step is `inertial` that leads to what an IMU felt.
        """
        where, s = self._model.errors, self._settings
        spread = np.zeros(where.size)
        spread[where.wind] = s.wind_force**2 * (1.0 - keep**2)
        spread[where.bias] = s.length_bias_walk**2 * duration
        spread[where.heading] = s.attitude_heading_walk**2 * duration
        noise = np.diag(spread)
        noise[where.motion, where.motion] = self._model.unknown_motion(s, duration, felt=inertial)
        return noise

    def _corrected(
        self, state: DynamicFilterState, cross: Array, total: Array, innovation: Array
    ) -> tuple[DynamicFilterState, InnovationTally]:
        """Correct a state by a measurement.

        Args:
            state: Before it.
            cross: Covariance of the errors with the innovation.
            total: Covariance of the innovation.
            innovation: Measured minus expected.

        Raises:
            NoMotion: It has no finite answer.
        """
        square = float(innovation @ np.linalg.solve(total, innovation))
        allowed = self._settings.gate * len(innovation)
        if square > allowed:  # so much noise that it is just within the gate
            total = total * (square / allowed)
        gain = np.linalg.solve(total, cross.T).T
        left = state.covariance - gain @ cross.T
        error = gain @ innovation
        if not np.isfinite(error).all():
            raise NoMotion(f"the estimate is lost after {state.time:.3f} s")
        corrected = state.corrected(error, left)
        if square > allowed:
            return corrected, InnovationTally(disturbed=1)
        return corrected, InnovationTally(squares=square, dof=len(innovation))
