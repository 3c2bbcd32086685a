"""The forward pass: the dynamics through a recording, and how errors go along with it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from baselines.dynamic_estimator.filter_state import DynamicFilterState, Errors
from baselines.dynamic_estimator.measurement_models import (
    ImuMean,
    LinearisedMeasurement,
    MeasurementModels,
)
from baselines.dynamic_estimator.model import DynamicModel
from baselines.dynamic_estimator.reading_models import READING_MODELS
from baselines.dynamic_estimator.rest_start import UNKNOWN_ANGLE
from baselines.smoother.arranged_recording import ArrangedRecording
from baselines.smoother.settings import SmootherSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import wrapped_angle
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.physics.motion.length_curve import LENGTH_SEGMENT_MAX, segment_ends
from carosac_toolkit.physics.scales import Scales

CONSTANT_NOISE_RATIO = Scaled(1e-4, "1/sqrt(s)")  # of the scale of an error
SWAY_SCALE = Scaled(0.01, "m")  # of the errors of the centre of mass
SWAY_RATE_SCALE = Scaled(3.0, "1/s")  # of the errors of its speed, over those
# Of errors that the settings take as known.
KNOWN_CENTER_SCALE, KNOWN_LENGTH_SCALE = Scaled(0.01, "m"), Scaled(7e-3, "m")
KNOWN_RATE_SCALE, KNOWN_FORCE_SCALE = Scaled(5e-3, "rad/s"), Scaled(0.05, "m/s^2")
KNOWN_WIND_SCALE, KNOWN_LOG_MASS_SCALE = Scaled(1.0, "N"), 0.03
KNOWN_ANGLE_SCALE = 1e-3  # [rad]


@dataclass(frozen=True, kw_only=True, eq=False)
class KeyFrameLink:
    """From one key frame to the next, to first order.

    Attributes:
        carry: Errors at the end per error at the start, shape (size, size).
        noise: Covariance of what is added, shape (size, size).
        felt: What the IMU said at its end of the errors at its start, or None.
        expected: What the IMU was expected to say then, shape (6,), or None.
    """

    carry: Array
    noise: Array
    felt: LinearisedMeasurement | None
    expected: Array | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class ForwardPass:
    """A forward pass through K key frames.

    Attributes:
        delay: By how much lengths led [s].
        states: At each key frame, corrections included; their covariance means nothing.
        corrections: What was added to each, shape (K, size): to the first, against rest.
        links: K - 1 of them.
        said: What poses and angles say, by key frame and channel; ``pose`` is that of poses.
    """

    delay: float
    states: list[DynamicFilterState]
    corrections: Array
    links: list[KeyFrameLink]
    said: dict[int, dict[str, LinearisedMeasurement]]


class ForwardModel:
    """Forward passes through one recording.

    Errors are those of `Errors`, and one more at the end: that of the delay [s]. A longer one is
    the same motion later.
    """

    def __init__(
        self, model: DynamicModel, measured: ArrangedRecording, settings: SmootherSettings
    ) -> None:
        """Take the dynamics and the recording."""
        self._model = model
        self._measured = measured
        self._settings = settings
        self._sensors = MeasurementModels(model, settings.dynamics)
        ratios = Scales(model.robot).ratios
        self._segment = LENGTH_SEGMENT_MAX.of(ratios)
        self._floor = (CONSTANT_NOISE_RATIO.of(ratios) * scales(model, settings)[:-1]) ** 2

    def run(
        self, rest: DynamicFilterState, wanted: list[DynamicFilterState] | None, delay: float
    ) -> ForwardPass:
        """Go through the recording.

        Args:
            rest: Where it begins without a correction.
            delay: By how much lengths lead [s].
            wanted: States that are to be reached at each key frame, as far as errors lead there:
                the dynamics start anew from each, so that what they are told too little or too
                much does not add up; None: they go on from rest.

        Raises:
            NoMotion: The dynamics have no finite motion.
        """
        time = self._measured.time
        size = self._model.errors.size
        states, links = [], []
        added = np.zeros((len(time), size + 1))
        added[0, size] = delay - self._measured.delay
        state = rest
        for k in range(len(time)):
            if k:
                state, link = self._to(state, float(time[k]), self._measured.felt.get(k), delay)
                links.append(link)
            if wanted is not None:
                added[k, :size] = missing(state, wanted[k])
                state = state.corrected(added[k, :size], state.covariance)
            states.append(state)
        heard = sorted({*self._measured.poses, *self._measured.readings})
        return ForwardPass(
            delay=delay, states=states, corrections=added, links=_delayed(links, time),
            said={k: self._said(k, states[k], delay) for k in heard},
        )  # fmt: skip

    def _said(
        self, k: int, state: DynamicFilterState, delay: float
    ) -> dict[str, LinearisedMeasurement]:
        """Return what a pose and angles say of a state at key frame k, by channel.

        Swivel encoders share the clock of the lengths: their readings are late by the same delay.
        """
        said, pose = {}, self._measured.poses.get(k)
        if pose is not None:
            said["pose"] = widened(self._sensors.pose(state, *pose), -state.twist)
        for channel, value in self._measured.readings.get(k, {}).items():
            shared = channel == "swivel_angle"
            there = shifted(state, self._measured.delay - delay) if shared else state
            model = READING_MODELS[channel]
            told = model(self._model.robot, there, value, self._settings.dynamics)
            assert told.by_pose is not None
            late = np.zeros(len(value)) if shared else -told.by_pose @ state.twist
            said[channel] = widened(told, late[: len(told.residual)])
        return said

    def _to(
        self, state: DynamicFilterState, end: float, felt: ImuMean | None, delay: float
    ) -> tuple[DynamicFilterState, KeyFrameLink]:
        """Move a state to the next key frame."""
        size = self._model.errors.size
        carry, noise, imu, expected = np.eye(size), np.zeros((size, size)), None, None
        stops = [state.time, *segment_ends(state.time, end, self._segment)]
        for start, stop in pairwise(stops):
            reading = self._measured.reading(start, delay), self._measured.reading(stop, delay)
            move = self._model.step(state, *reading, stop - start)
            step, keep = self._sensors.carried(move, stop - start)
            added = self._noise(stop - start, keep)
            if felt is not None and stop == stops[-1]:
                now = self._sensors.felt(move, felt)
                expected = move.felt
                imu = LinearisedMeasurement(
                    now.residual, now.by @ carry, now.noise + now.by @ noise @ now.by.T
                )
            carry, noise = step @ carry, step @ noise @ step.T + added
            state = replace(move.state, time=stop, wind=keep * state.wind)
        kept = np.eye(size + 1)  # the delay stays as it is
        kept[:size, :size] = carry
        link = KeyFrameLink(carry=kept, noise=np.pad(noise, (0, 1)), felt=imu, expected=expected)
        return replace(state, time=end), link

    def _noise(self, duration: float, keep: float) -> Array:
        """Return the covariance that a step adds; a share `keep` of the wind remains."""
        where, s = self._model.errors, self._settings.dynamics
        spread = self._floor * duration
        spread[where.wind] += s.wind_force**2 * (1.0 - keep**2)
        spread[where.bias] += s.length_bias_walk**2 * duration
        spread[where.heading] += s.attitude_heading_walk**2 * duration
        spread[where.mass.start : where.center.stop] = 0.0
        spread[where.imu] = 0.0
        noise = np.diag(spread)
        noise[where.motion, where.motion] += self._model.unknown_motion(s, duration)
        return noise


def widened(measurement: LinearisedMeasurement, late: Array) -> LinearisedMeasurement:
    """Add the delay's column: the change per second (k,) by which it is longer."""
    return measurement._replace(by=np.column_stack([measurement.by, late]))


def _delayed(links: list[KeyFrameLink], time: Array) -> list[KeyFrameLink]:
    """Add the delay to the links with an IMU, by how its readings change with time."""
    heard = [k for k, link in enumerate(links) if link.felt is not None]
    if not heard:
        return links
    expected = np.array([links[k].expected for k in heard])
    rate = np.zeros_like(expected)
    if len(heard) > 1:
        rate = np.gradient(expected, time[np.array(heard) + 1], axis=0)
    delayed = list(links)
    for k, change in zip(heard, rate, strict=True):
        felt = links[k].felt
        assert felt is not None
        delayed[k] = replace(links[k], felt=widened(felt, -change))
    return delayed


def shifted(state: DynamicFilterState, delay: float) -> DynamicFilterState:
    """Return a state as it is if the motion is later by a delay [s]."""
    import pinocchio

    turn = pinocchio.exp3(-delay * state.twist[3:])
    return replace(
        state, position=state.position - delay * state.twist[:3], rotation=turn @ state.rotation
    )


def missing(state: DynamicFilterState, wanted: DynamicFilterState) -> Array:
    """Return the errors of a state against another nearby, as in `Errors`, shape (size,).

    Of pose and twist these are what sway and length biases can put right; the rest, stretch, is
    the business of the dynamics.
    """
    import pinocchio

    where, errors = state.errors, np.zeros(state.errors.size)
    turn = pinocchio.log3(np.ascontiguousarray(wanted.rotation @ state.rotation.T))
    errors[where.bias] = wanted.length_bias - state.length_bias
    moved = np.concatenate([wanted.position - state.position, turn])
    moved -= state.sway.slaved @ errors[where.bias]
    errors[where.sway] = state.sway.momentum @ moved
    errors[where.speed] = state.sway.momentum @ (wanted.twist - state.twist)
    errors[where.wind] = wanted.wind - state.wind
    errors[where.mass] = wanted.log_mass - state.log_mass
    errors[where.center] = wanted.center - state.center
    errors[where.imu] = wanted.imu_bias - state.imu_bias
    errors[where.swivels] = wanted.swivel_offset - state.swivel_offset
    if state.mounting is not None and wanted.mounting is not None:
        mounted = np.ascontiguousarray(state.mounting.T @ wanted.mounting)
        errors[where.mounting] = pinocchio.log3(mounted)
        errors[where.heading] = wrapped_angle(np.array([wanted.heading - state.heading]))
    return errors


def scales(model: DynamicModel, settings: SmootherSettings) -> Array:
    """Return the scales in which all errors are of order one, shape (size + 1,)."""
    where: Errors = model.errors
    s, ratios = settings.dynamics, Scales(model.robot).ratios
    scale = np.full(where.size, SWAY_SCALE.of(ratios) * np.sqrt(model.robot.mass))
    scale[where.speed] *= SWAY_RATE_SCALE.of(ratios)
    scale[where.wind] = s.wind_force or KNOWN_WIND_SCALE.of(ratios)
    scale[where.mass] = s.mass or KNOWN_LOG_MASS_SCALE
    scale[where.center] = s.center_of_mass or KNOWN_CENTER_SCALE.of(ratios)
    scale[where.bias] = s.bias_deviation or KNOWN_LENGTH_SCALE.of(ratios)
    scale[where.imu] = np.repeat(
        [
            s.angular_rate_bias or KNOWN_RATE_SCALE.of(ratios),
            s.specific_force_bias or KNOWN_FORCE_SCALE.of(ratios),
        ],
        3,
    )
    zeros = s.swivel_offset
    scale[where.swivels] = UNKNOWN_ANGLE if zeros is None else zeros or KNOWN_ANGLE_SCALE
    scale[where.mounting] = s.attitude_mounting or KNOWN_ANGLE_SCALE
    scale[where.heading] = s.attitude_heading or KNOWN_ANGLE_SCALE
    return np.append(scale, settings.delay)
