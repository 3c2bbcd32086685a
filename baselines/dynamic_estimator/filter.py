"""The extended Kalman filter: prediction by the dynamics, correction by IMU and poses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from baselines.dynamic_estimator.model import Model, NoMotion, Transition
from baselines.dynamic_estimator.settings import DynamicEstimatorSettings
from baselines.dynamic_estimator.state import FilterState
from carosac_toolkit.arrays import Array

SWEPT = (2.0, 5.0)  # [m/s^2, rad/s^2] by which twists change while a pose is late


@dataclass(frozen=True, kw_only=True, eq=False)
class Felt:
    """What an IMU said: the mean of some samples.

    Attributes:
        values: Angular rate [rad/s] and specific force [m/s^2] in its axes, shape (6,).
        samples: How many.
    """

    values: Array
    samples: int = 1


@dataclass(frozen=True, kw_only=True, eq=False)
class Tally:
    """What measurements said against the estimate.

    Attributes:
        squares: Sum of normalised innovations squared, of measurements within the gate.
        dof: Their degrees of freedom.
        disturbed: Measurements beyond the gate, or too late.
    """

    squares: float = 0.0
    dof: int = 0
    disturbed: int = 0

    def __add__(self, other: Tally) -> Tally:
        """Both together."""
        return Tally(
            squares=self.squares + other.squares,
            dof=self.dof + other.dof,
            disturbed=self.disturbed + other.disturbed,
        )


class Filter:
    """Steps of the filter for one robot."""

    def __init__(self, model: Model, settings: DynamicEstimatorSettings) -> None:
        """Take the dynamics and how wrong everything may be."""
        self._model = model
        self._settings = settings
        s = settings
        self._sensor = np.repeat([s.angular_rate_noise**2, s.specific_force_noise**2], 3)
        self._vibration = np.repeat([s.angular_vibration**2, s.vibration**2], 3)
        self._tension = s.tension_noise * model.robot.weight

    def step(
        self, state: FilterState, reading: Array, end: Array, duration: float,
        felt: Felt | None = None,
    ) -> tuple[FilterState, Tally]:  # fmt: skip
        """Predict, and correct by what the IMU felt at the end.

        Args:
            state: At the start.
            reading: Length readings at the start [m], shape (n,).
            end: Length readings at the end [m], shape (n,).
            duration: [s].
            felt: By the IMU, or None.

        Raises:
            NoMotion: The dynamics have no finite motion.
        """
        move = self._model.step(state, reading, end, duration)
        where = self._model.errors
        carry, noise = self._carry(move, duration)
        matrix = carry @ state.covariance @ carry.T + noise
        arrived = replace(
            move.state,
            wind=float(carry[where.wind.start, where.wind.start]) * state.wind,
            covariance=0.5 * (matrix + matrix.T),
        )
        if felt is None:
            return arrived, Tally()
        by = np.zeros((6, where.size))
        by[:, : where.moving] = move.felt_by
        by[:, where.imu] = np.eye(6)
        pulled = self._tension * move.pulled
        stretched = self._settings.stretch_rate * move.stretched
        unknown = np.diag(self._sensor / felt.samples + self._vibration)
        unknown += pulled @ pulled.T + stretched @ stretched.T
        return self._corrected(
            arrived,
            carry @ state.covariance @ by.T,
            by @ state.covariance @ by.T + unknown,
            felt.values - move.felt - state.imu_bias,
        )

    def pose(
        self, state: FilterState, position: Array, rotation: Array, late: float = 0.0
    ) -> tuple[FilterState, Tally]:
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
        turn = pinocchio.log3(np.ascontiguousarray(rotation @ state.rotation.T))
        innovation = np.concatenate([position - state.position, turn])
        s = self._settings
        swept = 0.5 * late**2 * np.repeat(SWEPT, 3)
        by = state.pose_by()
        cross = state.covariance @ by.T
        rigid = s.stretch_noise * state.sway.slaved
        sensor = np.repeat([s.position_noise**2, s.rotation_noise**2], 3)
        own = by @ cross + np.diag(sensor + swept**2) + rigid @ rigid.T
        return self._corrected(state, cross, own, innovation)

    def _carry(self, move: Transition, duration: float) -> tuple[Array, Array]:
        """Errors at the end per error at the start, and the noise added meanwhile."""
        where, s = self._model.errors, self._settings
        carry = np.eye(where.size)
        carry[: 2 * where.m, : where.moving] = move.sway
        keep = float(np.exp(-duration / s.wind_time))
        carry[where.wind, where.wind] *= keep
        spread = np.zeros(where.size)
        spread[where.wind] = s.wind_force**2 * (1.0 - keep**2)
        spread[where.bias] = s.length_bias_walk**2 * duration
        spread[where.speed] = s.acceleration_noise**2 * self._model.robot.mass * duration
        return carry, np.diag(spread)

    def _corrected(
        self, state: FilterState, cross: Array, total: Array, innovation: Array
    ) -> tuple[FilterState, Tally]:
        """The state after a measurement.

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
        found = state.corrected(error, left)
        if square > allowed:
            return found, Tally(disturbed=1)
        return found, Tally(squares=square, dof=len(innovation))
