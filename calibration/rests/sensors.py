"""Errors of a robot's other sensors, from its rests at measured poses.

Lengths and poses calibrate the robot. Where it rests, they then tell what its load cells, swivel
encoders and AHRS or inclinometer should read. Nothing need be known of zeros, mounting or heading
before. Each sensor counts at all rests where it and the poses have samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calibration.lengths.settings import LengthSettings
from calibration.rest_readings import RestReadings, mean_angle, rest_readings
from calibration.rests.blunders import BLUNDER_SIGMAS, MISFIT_USELESS
from calibration.rests.model import tension_noise
from calibration.rests.settings import RestSettings
from calibration.sensor_errors import SENSOR_UNITS, SENSOR_WORDS, SensorError
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import vertical, wrapped_angle
from carosac_toolkit.base.tables import counted
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics.cable.swivel import swivel_angle
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.statics import Equilibrium
from carosac_toolkit.recordings.encoders import calibrated
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.parameter_names import field_of
from carosac_toolkit.robot.robot import Robot

SENSORS = ("tension", "attitude", "inclination", "swivel_angle")
RESTS_MIN = 4  # from which a sensor is calibrated
BLUNDERS_SHARE_MAX = 0.2  # of the rests: more are no blunders
SPREAD_OF_MEDIAN = 1.4826  # standard deviation over median absolute deviation, of a normal one
PRIOR_SIGMAS_MAX = 4.0  # a scale or zero that is farther off contradicts its prior
ANGLE_SIGMA_RAD = float(np.pi)  # of a zero, mounting or heading, of which nothing is known
MOUNTING_SIGMA_MAX_RAD = float(np.deg2rad(2.0))  # known less well, a mounting is of no use
HELD_SHARE = 1e-9  # prior sigma in place of 0, which holds a scale or zero
HEADINGS_TRIED = 8  # of an AHRS, from each of which its mounting is sought


@dataclass(frozen=True, kw_only=True)
class SensorCalibration:
    """Calibration of the sensors beside the encoders.

    Attributes:
        errors: Of those that could be calibrated.
        sentences: Of each sensor, at how many rests, or why it was not calibrated.
        warnings: Sensors whose readings do not fit lengths and poses.
    """

    errors: tuple[SensorError, ...] = ()
    sentences: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class _Rests:
    """K rests: readings, measured poses, and equilibria on the lengths there."""

    robot: Robot
    settings: RestSettings
    angle_noise: float  # of an AHRS or inclinometer, that of the poses included [rad]
    readings: RestReadings
    rotation: Array  # from P to W, measured, shape (K, 3, 3)
    equilibrium: Equilibrium

    def rows(self, which: NDArray[np.int64]) -> _Rests:
        """Return some of the rests."""
        return replace(
            self, readings=self.readings.rows(which), rotation=self.rotation[which],
            equilibrium=self.equilibrium.rows(which),
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class _Fit:
    """Errors of a sensor, and residuals in standard deviations of the noise, shape (K, m)."""

    names: tuple[str, ...]
    value: Array
    sigma: Array
    prior_sigma: Array
    residual: Array
    per_rest: int  # independent residuals

    @property
    def misfit(self) -> float:
        """Size of the residuals over that which their noise lets expect; about 1."""
        redundancy = max(len(self.residual) * self.per_rest - len(self.value), 1)
        return float(np.sqrt((self.residual**2).sum() / redundancy))


def calibrate_sensors(
    recording: Recording,
    robot: Robot,
    *,
    settings: RestSettings | None = None,
    rotation_noise: float = LengthSettings.rotation_noise,
) -> SensorCalibration:
    """Estimate scales, zeros, mounting and heading of the sensors that a recording has.

    Args:
        recording: As it was recorded, with measured poses.
        robot: As calibrated from its lengths and poses, z of its W up: `LengthCalibration.level`.
        settings: Noise, and priors of the load cells. Nothing is taken to be known of angles.
        rotation_noise: Of a measured rotation, per axis [rad].
    """
    material = calibrated(recording, robot)
    errors: list[SensorError] = []
    sentences: list[str] = []
    warnings: list[str] = []
    for name in SENSORS:
        if getattr(recording, name) is None:
            continue
        label = SENSOR_WORDS[name][0]
        if name == "inclination" and recording.attitude is not None:
            sentences.append(f"{label}: not calibrated, as there is an AHRS")
            continue
        others: dict[str, Any] = dict.fromkeys(other for other in SENSORS if other != name)
        alone = replace(material, **others)
        rests = _rests(alone, robot, settings or RestSettings(), rotation_noise)
        fit, blunders = (rests, 0) if isinstance(rests, str) else _without_blunders(name, rests)
        if isinstance(fit, str):
            sentences.append(f"{label}: not calibrated, as {fit}")
            continue
        doubt = _doubt(fit)
        if doubt:
            warnings.append(f"{label}: not calibrated, as {doubt}: {_QUESTIONS[name]}")
            continue
        sigma = max(1.0, fit.misfit) * fit.sigma
        errors += [
            SensorError(
                name=each, unit=SENSOR_UNITS[field_of(each)], value=float(fit.value[k]),
                sigma=float(sigma[k]), prior_sigma=float(fit.prior_sigma[k]),
            )
            for k, each in enumerate(fit.names)
        ]  # fmt: skip
        without = f", without {counted(blunders, 'blunder')}" if blunders else ""
        sentences.append(
            f"{label}: calibrated at {len(fit.residual)} rests{without}; residuals are "
            f"{fit.misfit:.2f} times their noise"
        )
        if fit.names[: len(_MOUNTING)] == _MOUNTING:
            sentences.append(_mounted(fit.value[:3], sigma[:3]))
    return SensorCalibration(
        errors=tuple(errors), sentences=tuple(sentences), warnings=tuple(warnings)
    )


def _rests(
    recording: Recording, robot: Robot, settings: RestSettings, rotation_noise: float
) -> _Rests | str:
    """Return the rests of a material recording at measured poses; why not where they are few."""
    readings = rest_readings(recording, poses=True)
    if len(readings.time) < RESTS_MIN:
        return (
            f"the recording has {counted(len(readings.time), 'rest')} with its readings and a "
            f"measured pose, and {RESTS_MIN} are needed: do all clocks agree "
            "('carosac import recording --align')?"
        )
    position, rotation = np.asarray(readings.position), np.asarray(readings.rotation)
    near = Pose(position=position, rotation=rotation)
    rest = statics.forward_kinematics(robot, readings.length, guess=near)
    rests = _Rests(
        robot=robot, settings=settings, readings=readings, rotation=rotation, equilibrium=rest,
        angle_noise=float(np.hypot(settings.attitude_noise, rotation_noise)),
    )  # fmt: skip
    stable = np.flatnonzero(rest.converged & rest.stable)
    if len(stable) < RESTS_MIN:
        return f"the lengths allow {counted(len(stable), 'rest')}, and {RESTS_MIN} are needed"
    return rests.rows(stable)


def _without_blunders(name: str, rests: _Rests) -> tuple[_Fit | str, int]:
    """Fit a sensor, leaving out the worst rests, and say how many; or why it cannot be fitted."""
    most = int(BLUNDERS_SHARE_MAX * len(rests.rotation))
    out = 0
    while True:
        fit = _FITS[name](rests)
        if isinstance(fit, str):
            return fit, out
        size = np.abs(fit.residual).max(axis=1)
        usual = max(1.0, SPREAD_OF_MEDIAN * float(np.median(np.abs(fit.residual))))
        if size.max() <= BLUNDER_SIGMAS * usual or out == most or len(size) == RESTS_MIN:
            return fit, out
        rests, out = rests.rows(np.delete(np.arange(len(size)), int(size.argmax()))), out + 1


def _doubt(fit: _Fit) -> str:
    """Say why errors of a sensor are not to be believed; empty where they are."""
    if fit.misfit > MISFIT_USELESS:
        return (
            f"readings miss what lengths and poses let expect by {fit.misfit:.1f} times their noise"
        )
    off = np.abs(fit.value) / fit.prior_sigma
    worst = int(off.argmax())
    if off[worst] > PRIOR_SIGMAS_MAX:
        return (
            f"{fit.names[worst]} would be {fit.value[worst]:+.3g}, {off[worst]:.0f} times what is "
            "taken for possible"
        )
    return ""


def _load_cells(rests: _Rests) -> _Fit | str:
    """Fit scale and zero of each load cell."""
    robot, settings = rests.robot, rests.settings
    if robot.n > 6:
        return "tensions of more than six cables depend on their lengths too finely"
    read, tension = np.asarray(rests.readings.tension), rests.equilibrium.tension
    noise = tension_noise(robot, read, settings)
    share = np.array([settings.tension_scale_prior, settings.tension_offset_prior])
    prior = np.maximum(share, HELD_SHARE) * [1.0, robot.weight / robot.n]
    slopes = np.stack([tension, np.ones_like(tension)], axis=2) / noise[..., None]  # (K, n, 2)
    off = (read - tension) / noise
    information = np.einsum("kni,knj->nij", slopes, slopes) + np.diag(prior**-2.0)
    covariance = np.linalg.inv(information)
    value = np.einsum("nij,knj,kn->ni", covariance, slopes, off)
    fields = ("tension_scale", "tension_offset")
    return _Fit(
        names=tuple(f"{field}[{cable}]" for field in fields for cable in robot.cable_names),
        value=value.T.ravel(),
        sigma=np.sqrt(np.einsum("nii->in", covariance)).ravel(),
        prior_sigma=np.repeat(prior, robot.n),
        residual=off - np.einsum("kni,ni->kn", slopes, value),
        per_rest=robot.n,
    )


def _swivel_angles(rests: _Rests) -> _Fit | str:
    """Fit the zero of each swivel encoder."""
    robot = rests.robot
    which = np.flatnonzero(robot.pulley_radius > 0.0)
    if not len(which):
        return "the robot has no pulleys"
    predicted = swivel_angle(robot, -rests.equilibrium.exit_tension)[:, which]
    off = wrapped_angle(np.asarray(rests.readings.swivel_angle)[:, which] - predicted)
    zero = mean_angle(off)
    noise = rests.settings.swivel_noise
    return _Fit(
        names=tuple(f"swivel_offset[{robot.cable_names[i]}]" for i in which),
        value=zero,
        sigma=np.full(len(which), noise / np.sqrt(len(off))),
        prior_sigma=np.full(len(which), ANGLE_SIGMA_RAD),
        residual=wrapped_angle(off - zero) / noise,
        per_rest=len(which),
    )


def _attitude(rests: _Rests) -> _Fit:
    """Fit mounting and heading of an AHRS."""
    read = np.asarray(rests.readings.attitude)

    def off(value: Array) -> Array:
        turn = Rotation.from_rotvec([0.0, 0.0, value[3]]).as_matrix()
        predicted = turn @ rests.rotation @ Rotation.from_rotvec(value[:3]).as_matrix()
        return np.asarray(Rotation.from_matrix(predicted.swapaxes(1, 2) @ read).as_rotvec())

    starts = []
    for heading in 2.0 * np.pi * np.arange(HEADINGS_TRIED) / HEADINGS_TRIED - np.pi:
        back = Rotation.from_rotvec([0.0, 0.0, -heading]).as_matrix()
        mounting = Rotation.from_matrix(rests.rotation.swapaxes(1, 2) @ back @ read).mean()
        starts.append(np.append(mounting.as_rotvec(), heading))
    return _turned(off, starts, (*_MOUNTING, "heading"), rests.angle_noise, per_rest=3)


def _inclination(rests: _Rests) -> _Fit:
    """Fit the mounting of an inclinometer, by the vertical in its frame."""
    read = vertical(np.asarray(rests.readings.inclination))

    def off(value: Array) -> Array:
        return np.asarray(rests.rotation[:, 2] @ Rotation.from_rotvec(value).as_matrix() - read)

    starts = list(Rotation.create_group("O").as_rotvec())  # whichever way its axes point
    return _turned(off, starts, _MOUNTING, rests.angle_noise, per_rest=2)


def _turned(
    off: Callable[[Array], Array], starts: Sequence[Array], names: tuple[str, ...], noise: float,
    *, per_rest: int,
) -> _Fit:  # fmt: skip
    """Fit angles from the best of some starts.

    Args:
        off: What readings miss with these angles [rad], shape (K, m).
        starts: Angles [rad].
        names: Of these.
        noise: Of a reading [rad].
        per_rest: Independent residuals.
    """

    def residual(value: Array) -> Array:
        return np.concatenate([off(value).ravel() / noise, value / ANGLE_SIGMA_RAD])

    begin = min(starts, key=lambda start: float((residual(start) ** 2).sum()))
    solution = least_squares(residual, begin)
    value = np.asarray(solution.x, float)
    value[3:] = wrapped_angle(value[3:])
    return _Fit(
        names=names,
        value=value,
        sigma=np.sqrt(np.diag(np.linalg.inv(solution.jac.T @ solution.jac))),
        prior_sigma=np.full(len(names), ANGLE_SIGMA_RAD),
        residual=off(value) / noise,
        per_rest=per_rest,
    )


def _mounted(value: Array, sigma: Array) -> str:
    """Say how a sensor is mounted, or that this is hardly known."""
    if sigma.max() > MOUNTING_SIGMA_MAX_RAD:
        return (
            f"its mounting is known to {np.rad2deg(sigma.max()):.0f} degrees only: rests in which "
            "the platform is turned about more axes, or further, tell more"
        )
    stated = " ".join(f"{each:.4f}" for each in value)
    return f"its mounting, for carosac smooth: --mounting {stated}"


_QUESTIONS = {
    "tension": "are the unit, the order of the cables and the sign right?",
    "attitude": "is it the rotation from the AHRS to a level frame, and of this platform?",
    "inclination": "are these roll and pitch, in this order and in radians?",
    "swivel_angle": "are the unit, the order of the cables and the sense of rotation right?",
}
_MOUNTING = ("mounting.x", "mounting.y", "mounting.z")
_FITS: dict[str, Callable[[_Rests], _Fit | str]] = {
    "tension": _load_cells, "attitude": _attitude, "inclination": _inclination,
    "swivel_angle": _swivel_angles,
}  # fmt: skip
