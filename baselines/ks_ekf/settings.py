"""Settings of the filter: noise of its sensors, priors, coupling, detection and gates."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Literal, get_args

import numpy as np

from carosac_toolkit.base.arrays import Array, check_rotations, frozen_array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.numbers import check_fields, check_fraction
from carosac_toolkit.base.scaled import Scaled

Coupling = Literal["loose", "tight"]
FIELDS_CHECKED_APART = ("coupling", "imu_position", "imu_rotation", "gate")
FIELDS_MAY_BE_ZERO = ("tension_change", "center_of_mass_prior", "bias_walk", "length_walk")


@dataclass(frozen=True, kw_only=True, eq=False)
class KsEkfSettings:
    """Settings of `KsEkf`; noises and priors are one standard deviation.

    Defaults are those of the robot ``carosac`` and of the simulated sensors. Noise and bias of the
    IMU are the same for every robot; those of lengths are smaller on smaller robots, but not larger
    on larger ones. All others that have a unit scale with the robot.

    Attributes:
        coupling: What the lengths are to the filter: themselves the measurement (``"tight"``), or
            through the pose of rest that they give (``"loose"``, as published).
        imu_position: Where the IMU is on the platform, in P [m], shape (3,).
        imu_rotation: Rotation from the axes of the IMU to P, shape (3, 3).
        angular_rate_noise: Of a gyroscope sample, per axis [rad/s].
        specific_force_noise: Of an accelerometer sample, per axis [m/s^2].
        angular_rate_bias: Prior of the gyroscope's bias, per axis [rad/s].
        specific_force_bias: Prior of the accelerometer's bias, per axis [m/s^2].
        bias_walk: By how much both biases may walk in a minute, as a share of their priors.
        imu_gap: Longest time without an inertial sample that is bridged by the last one [s].
        rate_change: How fast the angular rate may change meanwhile [rad/s^2].
        force_change: How fast the specific force may change meanwhile [m/s^3].
        length_noise: Of a length [m].
        tension_change: What adds to that, as a share of what motion changes them by: a cable that
            swings itself does not sag as one at rest under the same tension.
        length_bias: Prior of the constant error of each length, that of its encoder [m].
        length_walk: By how much that error walks in a minute [m]: exit points that are off change
            it as the platform moves. 0: it is constant, as that of an encoder is.
        center_of_mass_prior: By how much the centre of mass may be elsewhere, per axis [m].
        gate: Probability with which a good measurement passes its gate.
        reading_jump: Distance from the last lengths, beyond what a winch can do, from which lengths
            are outliers, or encoders have slipped where they stay there [m].
        misfit_time: Once lengths have not fit for so long, the filter doubts itself: its covariance
            grows with each further misfit, until lengths are believed again or the position is as
            uncertain as by `sway`; then it starts anew. Inertial samples alone stay within some
            centimetres for so long, within decimetres on a platform that shakes [s].
        rest_rate: Largest angular rate in it, root mean square [rad/s].
        rest_force: Largest standard deviation of the specific force in it [m/s^2].
        sway: Sway that is possible in motion, as the root mean square of the position [m]. Its
            shape is that of equal energy in all modes.
    """

    coupling: Coupling = "tight"
    imu_position: Array = field(default_factory=lambda: np.zeros(3))
    imu_rotation: Array = field(default_factory=lambda: np.eye(3))
    angular_rate_noise: float = 3.5e-3
    specific_force_noise: float = 0.017
    angular_rate_bias: float = 5e-3
    specific_force_bias: float = 0.05
    bias_walk: float = 0.02
    imu_gap: float = Scaled(0.05, "s")
    rate_change: float = Scaled(10.0, "rad/s^2")
    force_change: float = Scaled(40.0, "m/s^3")
    length_noise: float = Scaled(0.3e-3, "m", most=0.3e-3)
    tension_change: float = 0.5
    length_bias: float = Scaled(5e-3, "m", most=5e-3)
    length_walk: float = Scaled(0.01, "m/sqrt(s)")
    center_of_mass_prior: float = Scaled(0.01, "m")
    gate: float = 0.9999
    reading_jump: float = Scaled(0.05, "m")
    misfit_time: float = Scaled(1.5, "s")
    rest_rate: float = Scaled(0.02, "rad/s")
    rest_force: float = Scaled(0.1, "m/s^2")
    sway: float = Scaled(0.15, "m")

    def __post_init__(self) -> None:
        """Refuse unknown couplings and numbers out of range; freeze the mounting of the IMU."""
        if self.coupling not in get_args(Coupling):
            allowed = f"one of {list(get_args(Coupling))}"
            raise InvalidField("coupling", repr(self.coupling), allowed)
        for name, shape in (("imu_position", (3,)), ("imu_rotation", (3, 3))):
            object.__setattr__(self, name, frozen_array(name, getattr(self, name), shape))
        check_rotations("imu_rotation", self.imu_rotation[None])
        check_fraction("gate", self.gate)
        numbers = [entry.name for entry in fields(self) if entry.name not in FIELDS_CHECKED_APART]
        check_fields(
            self, not_negative=FIELDS_MAY_BE_ZERO,
            positive=[name for name in numbers if name not in FIELDS_MAY_BE_ZERO],
        )  # fmt: skip
