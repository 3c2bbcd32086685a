"""The parameters that all rests share: geometry, zeros of the readings, errors of the sensors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.lengths.unknowns import LOOSE_OFFSET_SIGMA_M
from calibration.prior import Prior
from calibration.rest_readings import RestReadings
from calibration.rests.settings import RestSettings
from calibration.robot_update import prior_covariance
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.parameter_names import field_of, point_names
from carosac_toolkit.robot.parameters import values_of, with_values
from carosac_toolkit.robot.robot import Robot

MOVING_FIELDS = ("exit_points", "anchor_points", "center_of_mass", "mass")  # they move the platform


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorErrors:
    """Errors of the sensors of n cables.

    Attributes:
        tension_scale: Reading per tension less 1, shape (n,).
        tension_offset: Reading without tension [N], shape (n,).
        swivel_offset: Reading where the pulley stands at its zero [rad], shape (n,).
        mounting: Rotation from the inclinometer or AHRS to P, shape (3, 3).
        heading: Rotation from W to the level frame of the AHRS, about z, shape (3, 3).
    """

    tension_scale: Array
    tension_offset: Array
    swivel_offset: Array
    mounting: Array
    heading: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class RestUnknowns:
    """k parameters, those of the robot first.

    Attributes:
        robot: The robot before the calibration.
        prior: Names, values and covariance before.
        robot_names: The first of the names: those of the robot.
    """

    robot: Robot
    prior: Prior
    robot_names: tuple[str, ...]

    @cached_property
    def moving(self) -> tuple[int, ...]:
        """Places of the parameters on which the equilibria depend."""
        fields = [field_of(name) for name in self.robot_names]
        return tuple(k for k, field in enumerate(fields) if field in MOVING_FIELDS)

    def robot_at(self, value: Array) -> Robot:
        """Return the robot with these parameters."""
        return with_values(self.robot, self.robot_names, value[: len(self.robot_names)])

    def sensors_at(self, value: Array) -> SensorErrors:
        """Return the errors of the sensors with these parameters."""
        n = self.robot.n
        return SensorErrors(
            tension_scale=self._part("tension_scale", value, n),
            tension_offset=self._part("tension_offset", value, n),
            swivel_offset=self._part("swivel_offset", value, n),
            mounting=Rotation.from_rotvec(self._part("mounting", value, 3)).as_matrix(),
            heading=Rotation.from_rotvec([0.0, 0.0, *self._part("heading", value, 1)]).as_matrix(),
        )

    def _part(self, field: str, value: Array, size: int) -> Array:
        """Return some parameters, zeros where they are held."""
        rows = self.prior.rows(field)
        return value[rows] if len(rows) else np.zeros(size)


def find_unknowns(
    robot: Robot, readings: RestReadings, settings: RestSettings, *, relative: bool
) -> RestUnknowns:
    """Return the parameters whose prior leaves them free.

    Args:
        robot: Before the calibration; its covariances are priors.
        readings: Tell which sensors there are.
        settings: Priors of what the robot file does not describe.
        relative: True if the readings of length are known up to a constant each, which is another
            one in each recording: what an earlier calibration knew of it counts for nothing.
    """
    cables = robot.cable_names
    offsets = [f"length_offset[{c}]" for c in cables]
    names = (
        *offsets,
        *(f"length_scale[{c}]" for c in cables),
        *point_names("exit_points", cables),
        *point_names("anchor_points", cables),
        *(f"center_of_mass.{axis}" for axis in "xyz"),
        "mass",
    )
    loose = LOOSE_OFFSET_SIGMA_M if relative else settings.offset_prior
    known = prior_covariance(robot, names, np.zeros(len(names)))
    fresh = np.array([relative or name not in (robot.calibrated or ()) for name in offsets])
    rows = np.flatnonzero(fresh)
    known[rows] = known[:, rows] = 0.0
    known[rows, rows] = loose**2
    free = np.flatnonzero(np.diag(known) > 0.0)
    robot_names = tuple(names[k] for k in free)
    errors = _sensor_priors(robot, readings, settings)
    count = len(free)
    covariance = np.diag(np.concatenate([np.zeros(count), np.square(list(errors.values()))]))
    covariance[:count, :count] = known[np.ix_(free, free)]
    return RestUnknowns(
        robot=robot,
        prior=Prior(
            names=(*robot_names, *errors),
            mean=np.concatenate([values_of(robot, robot_names), np.zeros(len(errors))]),
            covariance=covariance,
        ),
        robot_names=robot_names,
    )


def _sensor_priors(
    robot: Robot, readings: RestReadings, settings: RestSettings
) -> dict[str, float]:
    """Return the prior sigma of each error of a sensor that is there and not held, by name."""
    cables, sigma = robot.cable_names, dict[str, float]()
    if readings.tension is not None:
        offset = settings.tension_offset_prior * robot.weight / robot.n
        sigma |= {f"tension_scale[{c}]": settings.tension_scale_prior for c in cables}
        sigma |= {f"tension_offset[{c}]": offset for c in cables}
    if readings.swivel_angle is not None:
        sigma |= {f"swivel_offset[{c}]": settings.swivel_offset_prior for c in cables}
    if readings.attitude is not None or readings.inclination is not None:
        sigma |= {f"mounting.{axis}": settings.mounting_prior for axis in "xyz"}
    if readings.attitude is not None:
        sigma["heading"] = settings.heading_prior
    return {name: value for name, value in sigma.items() if value > 0.0}
