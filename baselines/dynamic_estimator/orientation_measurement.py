"""Measurement models of an AHRS and an inclinometer on the platform.

How the sensor is mounted is an error of the filter, and so is the heading of an AHRS, which may be
any: it is a turn about the vertical, and exact however far off it is believed.
"""

from __future__ import annotations

import numpy as np

from baselines.dynamic_estimator.filter_state import DynamicFilterState
from baselines.dynamic_estimator.measurement_models import LinearisedMeasurement
from baselines.dynamic_estimator.settings import DynamicEstimatorSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import roll_and_pitch, to_matrix, wrapped_angle
from carosac_toolkit.robot.robot import Robot


def measured_attitude(
    robot: Robot, state: DynamicFilterState, attitude: Array, settings: DynamicEstimatorSettings
) -> LinearisedMeasurement:
    """Linearise an orientation that an AHRS measured at the time of a state.

    Args:
        robot: Has no part in it.
        state: The estimate.
        attitude: Quaternion w x y z from the frame of the sensor to its level frame, shape (4,).
        settings: Its noise, and that of lengths that stretch.
    """
    import pinocchio

    sensor = _in_world(state)
    measured = to_matrix(attitude[None])[0]
    turn = measured @ sensor.T
    nearest = float(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]))
    headed = pinocchio.exp3(np.array([0.0, 0.0, nearest])) @ sensor
    off = pinocchio.log3(np.ascontiguousarray(headed.T @ measured))
    by, noise = _by_turn(state, settings, sensor, np.eye(3))
    by[:, state.errors.heading] = headed[2][:, None]  # its z in the frame of the sensor
    ahead = float(wrapped_angle(np.asarray(nearest - state.heading)))
    return LinearisedMeasurement(residual=off + ahead * headed[2], by=by, noise=noise)


def measured_inclination(
    robot: Robot, state: DynamicFilterState, inclination: Array, settings: DynamicEstimatorSettings
) -> LinearisedMeasurement:
    """Linearise roll and pitch that an inclinometer measured at the time of a state.

    Args:
        robot: Has no part in it.
        state: The estimate.
        inclination: Roll and pitch [rad], shape (2,).
        settings: Its noise, and that of lengths that stretch.
    """
    sensor = _in_world(state)
    expected = roll_and_pitch(sensor[None])[0]
    (sin, cos), tan = (f(expected[0]) for f in (np.sin, np.cos)), np.tan(expected[1])
    rates = np.array([[1.0, tan * sin, tan * cos], [0.0, cos, -sin]])
    by, noise = _by_turn(state, settings, sensor, rates)
    return LinearisedMeasurement(wrapped_angle(inclination - expected), by, noise)


def _in_world(state: DynamicFilterState) -> Array:
    """Return the rotation from the frame of the sensor to W, shape (3, 3)."""
    assert state.mounting is not None
    return np.asarray(state.rotation @ state.mounting)


def _by_turn(
    state: DynamicFilterState, settings: DynamicEstimatorSettings, sensor: Array, rates: Array
) -> tuple[Array, Array]:
    """Return the change of a reading per error, shape (k, size), and its noise, shape (k, k).

    Args:
        state: The estimate.
        settings: Noise.
        sensor: Rotation from its frame to W, shape (3, 3).
        rates: Change of the reading per rotation vector in its frame, shape (k, 3).
    """
    where, by_turn = state.errors, rates @ sensor.T  # of a rotation vector in W
    by = by_turn @ state.pose_by()[3:]
    by[:, where.mounting] = rates
    stretched = settings.stretch_deviation * by_turn @ state.sway.slaved[3:]
    return by, settings.attitude_noise**2 * np.eye(len(rates)) + stretched @ stretched.T
