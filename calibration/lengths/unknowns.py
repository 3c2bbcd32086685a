"""The parameters of a calibration from lengths: names, start, prior, and the robot they make."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.lengths.settings import LengthSettings
from calibration.prior import Prior
from calibration.robot_update import prior_covariance
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.parameter_names import field_of, point_names
from carosac_toolkit.robot.parameters import values_of, with_values
from carosac_toolkit.robot.robot import Robot

LOOSE_OFFSET_SIGMA_M = 1e3  # [m]: prior of an offset that nothing is known of


@dataclass(frozen=True, kw_only=True, eq=False)
class LengthUnknowns:
    """k parameters of a robot.

    Attributes:
        robot: The robot before the calibration.
        prior: Names, values and covariance before, k of them.
        columns: Column of each in the Jacobians by all parameters, shape (k,).
        anchored: True if the exit points are known in a levelled frame of their own, as by a
            tachymeter. If not, W is the frame of the measured poses, and the tilt of that frame
            turns gravity alone.
    """

    robot: Robot
    prior: Prior
    columns: NDArray[np.int64]
    anchored: bool

    @property
    def exits(self) -> NDArray[np.int64]:
        """Places of the exit points' coordinates among the parameters."""
        return self.prior.rows("exit_points")

    def robot_at(self, value: Array) -> Robot:
        """Return the robot with these parameters in W; swivel axes stay where they stand."""
        robot = with_values(self.robot, self.prior.names, value)
        if self.anchored or robot.pose_rotation is None:
            return robot
        return replace(robot, swivel_axis=robot.swivel_axis @ robot.pose_rotation)


def all_names(cable_names: Sequence[str], *, center: bool) -> tuple[str, ...]:
    """Return every parameter, in the order of the Jacobians' columns.

    Args:
        cable_names: Of the robot.
        center: True if the centre of mass is among them.
    """
    return (
        *point_names("exit_points", cable_names),
        *point_names("anchor_points", cable_names),
        *(f"length_offset[{c}]" for c in cable_names),
        *(f"length_scale[{c}]" for c in cable_names),
        "length_delay",
        "pose_tilt.x",
        "pose_tilt.y",
        *([f"center_of_mass.{axis}" for axis in "xyz"] if center else []),
    )


def find_unknowns(robot: Robot, settings: LengthSettings, *, relative: bool) -> LengthUnknowns:
    """Return the parameters whose prior leaves them free.

    Args:
        robot: Before the calibration; its covariances are priors.
        settings: Priors of what it knows no covariance of.
        relative: True if the readings are lengths up to an unknown constant, which is another one
            in each recording: what an earlier calibration knew of it counts for nothing.
    """
    names = all_names(robot.cable_names, center=robot.n < 6)
    sigma = np.array([_sigma(name, settings, relative) for name in names])
    anchored = is_anchored(robot)
    if not anchored and robot.n >= 6:  # nothing depends on it
        sigma[[names.index(f"pose_tilt.{axis}") for axis in "xy"]] = 0.0
    prior = prior_covariance(robot, names, sigma)
    fresh = (sigma == 0.0) | (sigma == LOOSE_OFFSET_SIGMA_M)  # held, or of this recording alone
    prior[fresh] = prior[:, fresh] = 0.0
    prior[fresh, fresh] = sigma[fresh] ** 2
    free = np.flatnonzero(np.diag(prior) > 0.0)
    return LengthUnknowns(
        robot=robot,
        prior=Prior(
            names=tuple(names[k] for k in free),
            mean=values_of(robot, [names[k] for k in free]),
            covariance=prior[np.ix_(free, free)],
        ),
        columns=free,
        anchored=anchored,
    )


def is_anchored(robot: Robot) -> bool:
    """Return whether the exit points are known apart from the measured poses.

    Points that an earlier calibration found from lengths alone are in the frame of those poses, and
    so they are no anchor for others.
    """
    fields = {field_of(name) for name in robot.calibrated or ()}
    surveyed = robot.exit_covariance is not None or "exit_points" in fields
    from_poses = "length_offset" in fields and "pose_tilt" not in fields
    return robot.pose_rotation is not None or (surveyed and not from_poses)


def _sigma(name: str, settings: LengthSettings, relative: bool) -> float:
    """Return the prior of one parameter."""
    if name.startswith("length_offset") and relative and settings.offset_prior > 0.0:
        return LOOSE_OFFSET_SIGMA_M
    return {
        "exit_points": settings.exit_prior,
        "anchor_points": settings.anchor_prior,
        "length_offset": settings.offset_prior,
        "length_scale": settings.scale_prior,
        "length_delay": settings.delay_prior,
        "pose_tilt": settings.tilt_prior,
        "center_of_mass": settings.center_prior,
    }[field_of(name)]
