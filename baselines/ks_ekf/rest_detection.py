"""Detection of rest: quiet encoders and a quiet IMU over a window."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from baselines.ks_ekf.filter_settings import FilterSettings
from baselines.ks_ekf.filter_state import NO_SAMPLES, InertialSamples
from baselines.ks_ekf.timed_lengths import TimedLengths
from carosac_toolkit.base.arrays import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class RecentMeasurements:
    """The last measurements.

    Attributes:
        time: Of the lengths [s], shape (K,).
        lengths: [m], shape (K, n).
        samples: Inertial ones.
    """

    time: Array
    lengths: Array
    samples: InertialSamples = NO_SAMPLES

    def extended(
        self, readings: Sequence[TimedLengths], samples: InertialSamples, span: float
    ) -> RecentMeasurements:
        """Append later measurements, and drop those older than `span` seconds."""
        last = self.time[-1] if len(self.time) else -np.inf
        new = [reading for reading in readings if reading.time > last]
        when = np.append(self.time, [reading.time for reading in new])
        lengths = np.concatenate([self.lengths, *(reading.lengths[None] for reading in new)])
        first = max(int(np.searchsorted(when, when[-1] - span, side="right")) - 1, 0)
        inertial = self.samples.joined(samples)
        if len(inertial):
            inertial = inertial.after(inertial.time[-1] - span)
        return RecentMeasurements(time=when[first:], lengths=lengths[first:], samples=inertial)


@dataclass(frozen=True, kw_only=True, eq=False)
class RestMeans:
    """Means over a window at rest: angular rate [rad/s] and specific force [m/s^2], axes of P."""

    rate: Array
    force: Array


def detect_rest(
    window: RecentMeasurements, rate_bias: Array, settings: FilterSettings
) -> RestMeans | None:
    """Decide whether the platform rests; None where it does not, or the window is too short.

    Without an IMU nothing is known of sway, and no rest is ever detected.

    Args:
        window: Of at least the time in which rest shows.
        rate_bias: Of the gyroscope, axes of P [rad/s], shape (3,).
        settings: The thresholds.
    """
    samples = window.samples
    span = settings.rest_window
    short = 0.02  # of the span: the sampling of both
    if len(samples) < 2 or window.time[-1] - window.time[0] < (1.0 - short) * span:
        return None
    if samples.time[-1] - samples.time[0] < (1.0 - 5.0 * short) * span:
        return None
    spread = samples.force.std(axis=0).max()
    rate = np.sqrt(((samples.rate - rate_bias) ** 2).sum(axis=1).mean())
    moved = np.ptp(window.lengths, axis=0).max()
    if moved > settings.rest_length_range:
        return None
    if rate > settings.rest_rate or spread > settings.rest_force:
        return None
    return RestMeans(rate=samples.rate.mean(axis=0), force=samples.force.mean(axis=0))
