"""Noise and priors of a calibration from lengths, as standard deviations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.errors import InvalidField

TYPICAL_LENGTH_NOISE_M = 2e-3  # [m], of a reading, to judge a set-up before its noise is known
TYPICAL_SWAY_RAD = 0.01  # [rad], of the balance of a platform


@dataclass(frozen=True, kw_only=True)
class LengthSettings:
    """Noise of the measurements and priors of the parameters.

    A prior of 0 holds a parameter at its value in the robot file. Where the robot carries a
    covariance of its exit points, as from a tachymeter, that is their prior; so is the joint
    covariance of an earlier calibration for all that it estimated.

    Attributes:
        length_noise: Of one reading [m]; None: estimated from what the fit leaves.
        position_noise: Of a measured position, per axis [m].
        rotation_noise: Of a measured rotation, per axis [rad].
        exit_prior: Exit points per axis [m], for a robot without covariance.
        anchor_prior: Anchor points per axis [m].
        offset_prior: Length offsets [m]; readings of relative length have no prior.
        scale_prior: Length scales.
        delay_prior: Delay between readings and poses [s].
        tilt_prior: Tilt of the frame of the poses against gravity, about x and y [rad].
        center_prior: Centre of mass per axis [m], for a robot with fewer than 6 cables, whose
            measured orientation depends on it.
    """

    length_noise: float | None = None
    position_noise: float = 1e-3
    rotation_noise: float = 0.5e-3
    exit_prior: float = 0.05
    anchor_prior: float = 2e-3
    offset_prior: float = 1.0
    scale_prior: float = 1e-3
    delay_prior: float = 0.1
    tilt_prior: float = 5e-3
    center_prior: float = 0.01

    def __post_init__(self) -> None:
        """Refuse noise that is not positive and priors that are negative."""
        for name, value in vars(self).items():
            if value is None and name == "length_noise":
                continue
            strict = name.endswith("_noise")
            good = value > 0.0 if strict else value >= 0.0
            if not (good and np.isfinite(value)):
                raise InvalidField(name, value, f"{name} {'>' if strict else '>='} 0")
