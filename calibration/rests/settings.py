"""Settings of a calibration from rests: noise of the sensors and priors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.errors import InvalidField


@dataclass(frozen=True, kw_only=True)
class RestSettings:
    """Noise and priors, as one standard deviation. A prior of 0 holds the error of a sensor at 0.

    Exit points, anchor points, centre of mass, mass and length scales have the covariances of the
    robot file as priors, and are held where it has none.

    Attributes:
        length_noise: Of a reading of length at a rest [m].
        tension_noise: Of a load cell at a rest, as a share of its reading [1].
        attitude_noise: Of an inclinometer or AHRS at a rest, per axis [rad].
        swivel_noise: Of a swivel angle at a rest [rad].
        offset_prior: Of the readings' zeros, where the readings are not relative [m].
        tension_scale_prior: Of the load cells' scales [1].
        tension_offset_prior: Of the load cells' zeros, as a share of the weight per cable [1].
        mounting_prior: Of the orientation of the inclinometer or AHRS on the platform [rad].
        heading_prior: Of the heading of an AHRS in W [rad]; the default knows nothing of it.
        swivel_offset_prior: Of the swivel angles' zeros [rad].
    """

    length_noise: float = 0.5e-3
    tension_noise: float = 0.01
    attitude_noise: float = float(np.deg2rad(0.3))
    swivel_noise: float = float(np.deg2rad(0.2))
    offset_prior: float = 1.0
    tension_scale_prior: float = 0.2
    tension_offset_prior: float = 0.1
    mounting_prior: float = float(np.deg2rad(2.0))
    heading_prior: float = float(np.pi)
    swivel_offset_prior: float = 0.0

    def __post_init__(self) -> None:
        """Refuse noise that is not positive, negative priors, and lengths without error."""
        for name, value in vars(self).items():
            strict = name.endswith("_noise") or name == "offset_prior"
            good = value > 0.0 if strict else value >= 0.0
            if not (good and np.isfinite(value)):
                raise InvalidField(name, value, f"{name} {'>' if strict else '>='} 0")
