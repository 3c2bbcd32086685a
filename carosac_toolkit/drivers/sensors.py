"""Sensors of simulated drivers: rates, noise, bias, resolution and delay."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.numbers import check_fields
from carosac_toolkit.base.scaled import Scaled

SENSORS = ("imu", "pose", "tension", "swivel", "attitude", "inclination")  # beside the encoders
# Of all suites those that are offered to choose from.
SENSOR_SUITES = (
    "lengths", "lengths+imu", "lengths+pose", "lengths+imu+pose", "lengths+tension",
    "lengths+imu+tension", "lengths+swivel", "lengths+imu+swivel", "lengths+attitude",
    "lengths+inclination",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class SensorSettings:
    """Rates, errors and delays of the sensors; random errors as one standard deviation.

    Default errors of lengths, positions and tensions are those on ``carosac`` and on larger or
    heavier robots. On others they are smaller in proportion, as people choose drums, load cells and
    the distance of cameras to suit a robot, and home a small one more accurately.

    Attributes:
        encoder_rate: Sampling rate of the encoders [Hz].
        encoder_noise: Noise per sample [m].
        encoder_resolution: Length per count [m].
        encoder_bias: Constant, drawn once per cable [m].
        encoder_delay: From the sample to its arrival [s].
        pose_rate: Sampling rate of motion capture [Hz].
        position_noise: Per axis [m].
        rotation_noise: Per axis [rad].
        pose_delay: From the sample to its arrival [s].
        imu_rate: Sampling rate of the IMU [Hz].
        angular_rate_noise: Per axis and sample [rad/s].
        angular_rate_bias: Constant, drawn once per axis [rad/s].
        specific_force_noise: Per axis and sample [m/s^2].
        specific_force_bias: Constant, drawn once per axis [m/s^2].
        imu_delay: From the sample to its arrival [s].
        tension: True to add load cells at the platform to a suite without them.
        tension_rate: Sampling rate of the load cells [Hz].
        tension_noise: Noise per sample [N].
        tension_bias: Constant, drawn once per cable [N].
        tension_scale: Constant error as a share of the tension, drawn once per cable [1].
        tension_delay: From the sample to its arrival [s].
        swivel: True to add encoders of the swivel axes of pulleys to a suite without them.
        swivel_rate: Sampling rate of these [Hz].
        swivel_noise: Noise per sample [rad].
        swivel_bias: Constant error of their zeros, drawn once per pulley [rad].
        swivel_delay: From the sample to its arrival [s].
        attitude: True to add an AHRS on the platform to a suite without one.
        attitude_rate: Its sampling rate [Hz].
        attitude_noise: Per axis and sample [rad].
        attitude_mounting: Constant turn of the sensor on the platform, drawn once per axis [rad].
        attitude_heading: Heading of its level frame in W, drawn once [rad].
        attitude_delay: From the sample to its arrival [s].
        inclination: True to add an inclinometer on the platform to a suite without one.
        inclination_rate: Its sampling rate [Hz].
        inclination_noise: Of roll and pitch, per sample [rad].
        inclination_mounting: Constant turn of the sensor on the platform, drawn once per axis
            [rad].
        inclination_delay: From the sample to its arrival [s].
    """

    encoder_rate: float = 100.0
    encoder_noise: float = Scaled(0.2e-3, "m", most=0.2e-3)
    encoder_resolution: float = Scaled(0.05e-3, "m", most=0.05e-3)
    encoder_bias: float = Scaled(5e-3, "m", most=5e-3)
    encoder_delay: float = 0.01
    pose_rate: float = 100.0
    position_noise: float = Scaled(1e-3, "m", most=1e-3)
    rotation_noise: float = 0.5e-3
    pose_delay: float = 0.01
    imu_rate: float = 200.0
    angular_rate_noise: float = 3.5e-3
    angular_rate_bias: float = 5e-3
    specific_force_noise: float = 0.017
    specific_force_bias: float = 0.05
    imu_delay: float = 0.0
    tension: bool = False
    tension_rate: float = 100.0
    tension_noise: float = Scaled(0.5, "N", most=0.5)
    tension_bias: float = Scaled(1.0, "N", most=1.0)
    tension_scale: float = 0.0
    tension_delay: float = 0.01
    swivel: bool = False
    swivel_rate: float = 100.0
    swivel_noise: float = 3.5e-3
    swivel_bias: float = 3.5e-3
    swivel_delay: float = 0.01
    attitude: bool = False
    attitude_rate: float = 100.0
    attitude_noise: float = 5e-3
    attitude_mounting: float = 0.02
    attitude_heading: float = math.pi
    attitude_delay: float = 0.01
    inclination: bool = False
    inclination_rate: float = 100.0
    inclination_noise: float = 5e-3
    inclination_mounting: float = 0.02
    inclination_delay: float = 0.01

    def __post_init__(self) -> None:
        """Refuse negative numbers and rates of zero."""
        for name in _ADDED:
            if not isinstance(getattr(self, name), bool):
                raise InvalidField(name, repr(getattr(self, name)), "True or False")
        others = [name for name in vars(self) if name not in (*_RATE_FIELDS, *_ADDED)]
        check_fields(self, positive=_RATE_FIELDS, not_negative=others)

    def sensors_of(self, suite: str) -> tuple[str, ...]:
        """Return the sensors of a suite beside the encoders, with those that are added."""
        parts = suite.split("+")
        return tuple(
            name for name in SENSORS if name in parts or (name in _ADDED and getattr(self, name))
        )


_ADDED = ("tension", "swivel", "attitude", "inclination")  # to any suite
_RATE_FIELDS = ("encoder_rate", *(f"{name}_rate" for name in SENSORS))

PERFECT_SENSORS = SensorSettings(
    encoder_noise=0.0,
    encoder_resolution=0.0,
    encoder_bias=0.0,
    encoder_delay=0.0,
    position_noise=0.0,
    rotation_noise=0.0,
    pose_delay=0.0,
    angular_rate_noise=0.0,
    angular_rate_bias=0.0,
    specific_force_noise=0.0,
    specific_force_bias=0.0,
    tension_noise=0.0,
    tension_bias=0.0,
    tension_delay=0.0,
    swivel_noise=0.0,
    swivel_bias=0.0,
    swivel_delay=0.0,
    attitude_noise=0.0,
    attitude_mounting=0.0,
    attitude_heading=0.0,
    attitude_delay=0.0,
    inclination_noise=0.0,
    inclination_mounting=0.0,
    inclination_delay=0.0,
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
        """Time at which the next sample is due [s]."""
        return self._count * self._period

    def due(self, now: float) -> bool:
        """Return True if a sample is due at this time."""
        return now >= self.next_due - 1e-9

    def put(self, now: float, sample: Array) -> None:
        """Take a sample."""
        self._samples.append((now, sample))
        self._count += 1

    def overwrite(self, rows: NDArray[Any], now: float, sample: Array) -> None:
        """Replace all pending samples of some robots by one sample, at least one."""
        if not self._samples:
            self._samples.append((now, sample))
        for _, kept in self._samples:
            kept[rows] = sample[rows]

    def newest(self, now: float) -> tuple[float, Array]:
        """Return the newest sample that has arrived: when it was taken [s], and its values.

        Before the first one arrives, the first one: the robot has been at rest before time 0.
        """
        while len(self._samples) > 1 and self._samples[1][0] + self._delay <= now + 1e-9:
            self._samples.popleft()
        return self._samples[0]

    def arrived(self, now: float) -> list[tuple[float, Array]]:
        """Take out all samples that have arrived, the oldest first."""
        samples = []
        while self._samples and self._samples[0][0] + self._delay <= now + 1e-9:
            samples.append(self._samples.popleft())
        return samples

    def state(self) -> dict[str, Any]:
        """Return what changes; the samples are not copied."""
        return {"count": self._count, "samples": list(self._samples)}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a state; its samples become those of this line."""
        self._count, self._samples = state["count"], deque(state["samples"])


def check_suite(suite: str, *, inertial: bool) -> None:
    """Refuse an unknown suite, or an IMU on a plant without inertia.

    Raises:
        InvalidField: Names ``suite``.
    """
    has = [name for name in SENSORS if inertial or name != "imu"]
    parts = suite.split("+")
    if parts != ["lengths", *(name for name in has if name in parts[1:])]:
        why = "" if inertial else "; this plant has no inertia"
        allowed = f"'lengths', then any of {', '.join(f'+{name}' for name in has)}, in this order"
        raise InvalidField("suite", repr(suite), allowed + why)


def quantised(value: Array, resolution: float) -> Array:
    """Round to a resolution; 0 leaves the value as it is."""
    return np.round(value / resolution) * resolution if resolution > 0.0 else value
