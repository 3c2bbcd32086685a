"""How the covariance of a belief on lengths alone grows along a run, by what it comes from.

It is linear in the variance of each source, so that a few sources of unit size tell it for every
size: what a recording says about the sizes can be read off without a filter for each guess.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from baselines.dynamic_estimator.filter import DynamicFilter
from baselines.dynamic_estimator.measurement_models import MeasurementModels
from baselines.dynamic_estimator.model import DynamicModel
from baselines.dynamic_estimator.rest_start import RestStart
from baselines.dynamic_estimator.settings import DynamicEstimatorSettings, settings_for
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.physics.motion.length_curve import LENGTH_SEGMENT_MAX, segment_ends
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.model_error import ModelError
from carosac_toolkit.robot.robot import Robot

SOURCES = (
    "length",
    "force",
    "mass",
    "acceleration",
)  # fields of `ModelError` that move the platform


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorGrowth:
    """Covariances of the pose error at K times: positions [m], rotation vectors [rad], in W.

    Attributes:
        usual: What the estimator takes for granted of a robot that nobody identified.
        always: What it claims whatever the model misses: vibration of the stretch, and the start.
        by_source: What each of `SOURCES` of the size in `usual` adds, shape (4, K, 6, 6).
    """

    usual: ModelError
    always: Array
    by_source: Array


def usual_error(robot: Robot) -> ModelError:
    """Return what the estimator takes for granted of a robot that nobody identified."""
    usual = settings_for(replace(robot, model_error=None), DynamicEstimatorSettings())
    return ModelError(
        length=usual.bias_deviation, force=usual.wind_force, mass=usual.mass,
        acceleration=usual.acceleration_noise, position=usual.position_noise,
        rotation=usual.rotation_noise,
    )  # fmt: skip


def error_growth(robot: Robot, reading: Callable[[float], Array], time: Array) -> ErrorGrowth:
    """Follow the covariance of the estimator on lengths alone, which it starts at rest.

    Args:
        robot: As identified, n cables.
        reading: Lengths (n,) [m] that count at a time [s].
        time: When to look, increasing; the run starts at the first [s], shape (K,).

    Raises:
        CarosacError: The robot cannot hang on the first lengths, or has no finite motion.
    """
    usual = usual_error(robot)
    nothing = replace(usual, **dict.fromkeys(SOURCES, 0.0))
    one_each = [replace(nothing, **{name: getattr(usual, name)}) for name in SOURCES]
    settings = [
        settings_for(replace(robot, model_error=error), DynamicEstimatorSettings())
        for error in (nothing, *one_each)
    ]
    first = float(time[0])
    model = DynamicModel(robot, settings[0])
    states = [
        RestStart(robot, each, model.errors).state(first, reading(first)) for each in settings
    ]
    state = states[0]
    if state is None:
        raise CarosacError("the robot cannot hang at rest on the first recorded lengths")
    covariances = [each.covariance for each in states if each is not None]
    filters = [DynamicFilter(model, each) for each in settings]
    sensors = MeasurementModels(model, settings[0])
    longest = LENGTH_SEGMENT_MAX.of(Scales(robot).ratios)
    seen = np.empty((len(settings), len(time), 6, 6))
    for k, when in enumerate(time.tolist()):
        for end in segment_ends(state.time, when, longest) if when > state.time else ():
            start = state.time
            move = model.step(state, reading(start), reading(end), end - start)
            carry, keep = sensors.carried(move, end - start)
            covariances = [
                carry @ covariance @ carry.T + each.noise(end - start, keep)
                for each, covariance in zip(filters, covariances, strict=True)
            ]
            state = replace(move.state, time=end)
        for j, (each, covariance) in enumerate(zip(settings, covariances, strict=True)):
            claimed = replace(state, covariance=covariance)
            whole = claimed.platform_covariance(each.stretch_deviation, each.rate_noise)
            seen[j, k] = whole[:6, :6]
    return ErrorGrowth(usual=usual, always=seen[0], by_source=seen[1:] - seen[0])
