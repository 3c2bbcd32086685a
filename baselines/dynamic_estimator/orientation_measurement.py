"""Measurement models of an AHRS and an inclinometer on the platform.

How the sensor is mounted is stated, and the error of that is one of the filter. The level frame of
an AHRS may have any heading: it is a turn about the vertical, and exact however far off it is
believed.
"""

from __future__ import annotations

import numpy as np

from baselines.dynamic_estimator.filter_state import DynamicFilterState
from baselines.dynamic_estimator.measurement_models import LinearisedMeasurement
from baselines.dynamic_estimator.settings import DynamicEstimatorSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import cross_matrix, to_matrix, vertical, wrapped_angle
from carosac_toolkit.robot.robot import Robot


def measured_attitude(
    robot: Robot, state: DynamicFilterState, attitude: Array, settings: DynamicEstimatorSettings
) -> LinearisedMeasurement:
    """Linearise an orientation that an AHRS measured at the time of a state.

    Args:
        robot: The nominal one.
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
    ahead = float(wrapped_angle(np.asarray(nearest - state.heading)))
    up = headed[2]  # in the frame of the sensor
    linear = _by_turn(off + ahead * up, state, settings, sensor, np.eye(3))
    linear.by[:, state.errors.heading] = up[:, None]
    return linear


def measured_inclination(
    robot: Robot, state: DynamicFilterState, inclination: Array, settings: DynamicEstimatorSettings
) -> LinearisedMeasurement:
    """Linearise roll and pitch that an inclinometer measured at the time of a state.

    They tell the vertical in its frame, which is compared across the one expected.

    Args:
        robot: The nominal one.
        state: The estimate.
        inclination: Roll and pitch [rad], shape (2,).
        settings: Its noise, and that of lengths that stretch.
    """
    sensor = _in_world(state)
    up = sensor[2]
    across = np.linalg.svd(up[None])[2][1:]  # two axes
    residual = across @ (vertical(inclination[None])[0] - up)
    return _by_turn(residual, state, settings, sensor, across @ cross_matrix(up))


def _in_world(state: DynamicFilterState) -> Array:
    """Return the rotation from the frame of the sensor to W, shape (3, 3)."""
    assert state.mounting is not None
    return np.asarray(state.rotation @ state.mounting)


def _by_turn(
    residual: Array,
    state: DynamicFilterState,
    settings: DynamicEstimatorSettings,
    sensor: Array,
    rates: Array,
) -> LinearisedMeasurement:
    """Linearise a reading of how a sensor is turned, of any heading.

    Args:
        residual: Measured minus expected, shape (k,).
        state: The estimate.
        settings: Noise.
        sensor: Rotation from its frame to W, shape (3, 3).
        rates: Change of the reading per rotation vector in its frame, shape (k, 3).
    """
    by_pose = np.hstack([np.zeros_like(rates), rates @ sensor.T])
    by = by_pose @ state.pose_by()
    by[:, state.errors.mounting] = rates
    stretched = settings.stretch_deviation * by_pose @ state.sway.slaved
    own = settings.attitude_noise**2 * np.eye(len(rates))
    return LinearisedMeasurement(residual, by, own + stretched @ stretched.T, by_pose)
