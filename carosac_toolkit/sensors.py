"""Sensors of simulated drivers: rates, noise, bias, resolution and delay."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from carosac_toolkit.arrays import Array
from carosac_toolkit.errors import InvalidField

SUITES = ("lengths", "lengths+imu", "lengths+imu+pose")


@dataclass(frozen=True, kw_only=True)
class SensorSettings:
    """Numbers of the sensors, one standard deviation where they are random.

    Attributes:
        encoder_rate: [Hz].
        encoder_noise: [m].
        encoder_resolution: [m].
        encoder_bias: Constant, drawn once per cable [m].
        encoder_delay: From the sample to its arrival [s].
        pose_rate: Motion capture [Hz].
        position_noise: Per axis [m].
        rotation_noise: Per axis [rad].
        pose_delay: From the sample to its arrival [s].
    """

    encoder_rate: float = 100.0
    encoder_noise: float = 0.2e-3
    encoder_resolution: float = 0.05e-3
    encoder_bias: float = 5e-3
    encoder_delay: float = 0.01
    pose_rate: float = 100.0
    position_noise: float = 1e-3
    rotation_noise: float = 0.5e-3
    pose_delay: float = 0.01

    def __post_init__(self) -> None:
        """Refuse negative numbers and rates of zero."""
        for name, value in vars(self).items():
            lowest = "> 0" if name.endswith("rate") else ">= 0"
            if not (value > 0.0 or (value == 0.0 and lowest == ">= 0")) or not np.isfinite(value):
                raise InvalidField(name, value, f"{name} {lowest}")


PERFECT = SensorSettings(
    encoder_noise=0.0,
    encoder_resolution=0.0,
    encoder_bias=0.0,
    encoder_delay=0.0,
    position_noise=0.0,
    rotation_noise=0.0,
    pose_delay=0.0,
)


class DelayLine:
    """Samples on a grid of their own, each available `delay` later."""

    def __init__(self, rate: float, delay: float) -> None:
        """Start empty.

        Args:
            rate: Samples per second [Hz].
            delay: [s].
        """
        self._period = 1.0 / rate
        self._delay = delay
        self._count = 0
        self._samples: deque[tuple[float, Array]] = deque()

    @property
    def next_due(self) -> float:
        """When the next sample is to be taken [s]."""
        return self._count * self._period

    def due(self, now: float) -> bool:
        """Whether a sample is to be taken at this time."""
        return now >= self.next_due - 1e-9

    def put(self, now: float, sample: Array) -> None:
        """Take a sample."""
        self._samples.append((now, sample))
        self._count += 1

    def newest(self, now: float) -> tuple[float, Array]:
        """Newest sample that has arrived: when it was taken [s], and what it says.

        Before the first one arrives, the first one: the robot has been at rest before time 0.
        """
        while len(self._samples) > 1 and self._samples[1][0] + self._delay <= now + 1e-9:
            self._samples.popleft()
        return self._samples[0]


def quantised(value: Array, resolution: float) -> Array:
    """Round to a resolution; 0 leaves the value as it is."""
    return np.round(value / resolution) * resolution if resolution > 0.0 else value
