"""Measurement models of sensors beside IMU and poses, by channel, for filter and smoother."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from baselines.dynamic_estimator.filter_state import DynamicFilterState
from baselines.dynamic_estimator.measurement_models import LinearisedMeasurement
from baselines.dynamic_estimator.orientation_measurement import (
    measured_attitude,
    measured_inclination,
)
from baselines.dynamic_estimator.settings import DynamicEstimatorSettings
from baselines.dynamic_estimator.swivel_measurement import measured_swivels, with_swivel_zeros
from baselines.dynamic_estimator.tension_measurement import measured_tension
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot

ReadingModel = Callable[
    [Robot, DynamicFilterState, Array, DynamicEstimatorSettings], LinearisedMeasurement
]
READING_MODELS: Mapping[str, ReadingModel] = {
    "tension": measured_tension,
    "swivel_angle": measured_swivels,
    "attitude": measured_attitude,
    "inclination": measured_inclination,
}
"""By the channel of `carosac_toolkit.loop.values.Measurement`; each takes the nominal robot, the
estimate, a reading at its time, and the settings."""


def prepared(
    robot: Robot, state: DynamicFilterState, channel: str, value: Array
) -> DynamicFilterState:
    """Return a state that knows what its first reading tells of the sensor: zeros of angles.

    Args:
        robot: The nominal one.
        state: The estimate.
        channel: Of the reading.
        value: At the time of the state.
    """
    if channel == "swivel_angle":
        return with_swivel_zeros(robot, state, value)
    return state
