"""Errors of a robot's other sensors, from its rests at measured poses.

Lengths and poses calibrate the robot. Where it rests, they then tell what its load cells, swivel
encoders and AHRS or inclinometer should read. Nothing need be known of zeros, mounting or heading
before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calibration.lengths.pose_path import PosePath
from calibration.rests.model import TENSION_FLOOR_SHARE
from calibration.rests.readings import RestReadings, rest_readings
from calibration.rests.settings import RestSettings
from calibration.sensor_errors import SENSOR_UNITS, SENSOR_WORDS, SensorError
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import roll_and_pitch, wrapped_angle
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics.cable.swivel import swivel_angle
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.statics import Equilibrium
from carosac_toolkit.recordings.encoders import calibrated
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.parameter_names import field_of
from carosac_toolkit.robot.robot import Robot

LEVEL = np.eye(3)  # frame of a robot whose z is up
RESTS_MIN = 4  # from which a sensor is calibrated
MISFIT_MAX = 3.0  # times the noise: residuals beyond say that readings are of something else
ANGLE_SIGMA_RAD = float(np.pi)  # of a zero, mounting or heading, of which nothing is known
MOUNTING_TOLD_RAD = float(np.deg2rad(2.0))  # known less well, it is said so
HELD_SHARE = 1e-9  # prior of what is held
HEADING_TRIES = 8  # of an AHRS, from which its mounting is sought


@dataclass(frozen=True, kw_only=True)
class SensorCalibration:
    """What rests at measured poses tell of the other sensors.

    Attributes:
        errors: Of these.
        sentences: What else should be known, in words.
    """

    errors: tuple[SensorError, ...] = ()
    sentences: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class _Rests:
    """K rests: readings, measured poses, and equilibria on the lengths there."""

    robot: Robot
    settings: RestSettings
    readings: RestReadings
    rotation: Array  # from P to a level frame, measured, shape (K, 3, 3)
    equilibrium: Equilibrium


@dataclass(frozen=True, kw_only=True, eq=False)
class _Fit:
    """Errors of a sensor; residuals in standard deviations of the noise."""

    names: tuple[str, ...]
    value: Array
    sigma: Array
    prior_sigma: Array
    residual: Array


def calibrate_sensors(
    recording: Recording,
    robot: Robot,
    *,
    level: Array = LEVEL,
    settings: RestSettings | None = None,
) -> SensorCalibration:
    """Estimate scales, zeros, mounting and heading of the sensors that a recording has.

    Args:
        recording: As it was recorded, with measured poses.
        robot: As calibrated from its lengths and poses.
        level: Rotation from W to a frame whose z is up, (3, 3), as of `LengthCalibration.level`.
        settings: Noise, and priors of the load cells. Nothing is taken to be known of angles.
    """
    there = [name for name in SENSOR_WORDS if name != "length" and _has(recording, name)]
    if not there:
        return SensorCalibration()
    rests, reason = _rests(recording, robot, level, settings or RestSettings())
    if rests is None:
        words = " and ".join(SENSOR_WORDS[name][0] for name in there)
        return SensorCalibration(sentences=(f"{words}: not calibrated, as {reason}",))
    errors: list[SensorError] = []
    lines: list[str] = []
    for name in there:
        words = SENSOR_WORDS[name][0]
        found = _FITS[name](rests)
        if isinstance(found, str):
            lines.append(f"{words}: not calibrated, as {found}")
            continue
        redundancy = max(found.residual.size - len(found.value), 1)
        misfit = float(np.sqrt((found.residual**2).sum() / redundancy))
        if misfit > MISFIT_MAX:
            lines.append(
                f"{words}: not calibrated, as readings miss what the measured poses let expect by "
                f"{misfit:.1f} times their noise: are the units, the order of the cables and the "
                "signs right?"
            )
            continue
        sigma = max(1.0, misfit) * found.sigma
        errors += [
            SensorError(
                name=each, unit=SENSOR_UNITS[field_of(each)], value=float(found.value[k]),
                sigma=float(sigma[k]), prior_sigma=float(found.prior_sigma[k]),
            )
            for k, each in enumerate(found.names)
        ]  # fmt: skip
        lines.append(
            f"{words}: calibrated at {len(rests.rotation)} rests; residuals are {misfit:.2f} times "
            "their noise"
        )
        if found.names[0] == "mounting.x":
            lines += _mounted(found.value[:3], sigma[:3])
    return SensorCalibration(errors=tuple(errors), sentences=tuple(lines))


def _has(recording: Recording, name: str) -> bool:
    """Return whether a recording has a sensor that counts: beside an AHRS, no inclinometer does."""
    if name == "inclination" and recording.attitude is not None:
        return False
    return getattr(recording, name) is not None


def _rests(
    recording: Recording, robot: Robot, level: Array, settings: RestSettings
) -> tuple[_Rests | None, str]:
    """Return the rests at measured poses; None, and why, where they are too few."""
    material = calibrated(recording, robot)
    readings = rest_readings(material)
    if len(readings.time) < RESTS_MIN:
        count = len(readings.time)
        return None, f"the recording has {count} rests with readings, and {RESTS_MIN} are needed"
    measured = PosePath(material).at(readings.time, 0.0)
    kept = np.flatnonzero(measured.valid)
    if len(kept) < RESTS_MIN:
        return None, f"{len(kept)} rests have a measured pose, and {RESTS_MIN} are needed"
    readings, rotation = readings.rows(kept), measured.rotation[kept]
    near = Pose(position=measured.position[kept], rotation=rotation)
    rest = statics.forward_kinematics(robot, readings.length, guess=near)
    found = np.flatnonzero(rest.converged)
    if len(found) < RESTS_MIN:
        return None, f"the lengths allow {len(found)} of the rests, and {RESTS_MIN} are needed"
    return (
        _Rests(
            robot=robot, settings=settings, readings=readings.rows(found),
            rotation=level @ rotation[found], equilibrium=rest.rows(found),
        ),
        "",
    )  # fmt: skip


def _load_cells(rests: _Rests) -> _Fit | str:
    """Fit scale and zero of each load cell."""
    robot, settings = rests.robot, rests.settings
    if robot.n > 6:
        return "tensions of more than six cables depend on their lengths too finely"
    read, tension = np.asarray(rests.readings.tension), rests.equilibrium.tension
    floor = TENSION_FLOOR_SHARE * robot.weight / robot.n
    noise = settings.tension_noise * np.maximum(np.abs(read), floor)
    share = np.array([settings.tension_scale_prior, settings.tension_offset_prior])
    prior = np.maximum(share, HELD_SHARE) * [1.0, robot.weight / robot.n]
    slopes = np.stack([tension, np.ones_like(tension)], axis=2) / noise[..., None]  # (K, n, 2)
    off = (read - tension) / noise
    told = np.einsum("kni,knj->nij", slopes, slopes) + np.diag(prior**-2.0)
    covariance = np.linalg.inv(told)
    value = np.einsum("nij,knj,kn->ni", covariance, slopes, off)
    names = [f"{kind}[{c}]" for kind in ("tension_scale", "tension_offset") for c in _cables(rests)]
    return _Fit(
        names=tuple(names),
        value=value.T.ravel(),
        sigma=np.sqrt(np.einsum("nii->in", covariance)).ravel(),
        prior_sigma=np.repeat(prior, robot.n),
        residual=off - np.einsum("kni,ni->kn", slopes, value),
    )


def _swivel_angles(rests: _Rests) -> _Fit | str:
    """Fit the zero of each swivel encoder."""
    robot = rests.robot
    which = np.flatnonzero(robot.pulley_radius > 0.0)
    if not len(which):
        return "the robot has no pulleys"
    predicted = swivel_angle(robot, -rests.equilibrium.exit_tension)[:, which]
    off = wrapped_angle(np.asarray(rests.readings.swivel_angle)[:, which] - predicted)
    zero = np.arctan2(np.sin(off).mean(axis=0), np.cos(off).mean(axis=0))
    noise = rests.settings.swivel_noise
    return _Fit(
        names=tuple(f"swivel_offset[{_cables(rests)[i]}]" for i in which),
        value=zero,
        sigma=np.full(len(which), noise / np.sqrt(len(off))),
        prior_sigma=np.full(len(which), ANGLE_SIGMA_RAD),
        residual=wrapped_angle(off - zero) / noise,
    )


def _attitude(rests: _Rests) -> _Fit:
    """Fit mounting and heading of an AHRS."""
    read = np.asarray(rests.readings.attitude)

    def off(value: Array) -> Array:
        turn = Rotation.from_rotvec([0.0, 0.0, value[3]]).as_matrix()
        predicted = turn @ rests.rotation @ Rotation.from_rotvec(value[:3]).as_matrix()
        return np.asarray(Rotation.from_matrix(predicted.swapaxes(1, 2) @ read).as_rotvec())

    starts = []
    for heading in 2.0 * np.pi * np.arange(HEADING_TRIES) / HEADING_TRIES - np.pi:
        back = Rotation.from_rotvec([0.0, 0.0, -heading]).as_matrix()
        mounting = Rotation.from_matrix(rests.rotation.swapaxes(1, 2) @ back @ read).mean()
        starts.append(np.append(mounting.as_rotvec(), heading))
    names = (*_MOUNTING, "heading")
    return _turned(off, starts, names, rests.settings.attitude_noise)


def _inclination(rests: _Rests) -> _Fit:
    """Fit the mounting of an inclinometer."""
    read = np.asarray(rests.readings.inclination)

    def off(value: Array) -> Array:
        mounting = Rotation.from_rotvec(value).as_matrix()
        return np.asarray(wrapped_angle(read - roll_and_pitch(rests.rotation @ mounting)))

    starts = list(Rotation.create_group("O").as_rotvec())  # however its axes lie
    return _turned(off, starts, _MOUNTING, rests.settings.attitude_noise)


def _turned(
    off: Callable[[Array], Array], starts: list[Array], names: tuple[str, ...], noise: float
) -> _Fit:
    """Fit angles from the best of some starts.

    Args:
        off: What readings miss, by the angles [rad], shape (K, any).
        starts: Angles.
        names: Of these.
        noise: Of a reading [rad].
    """

    def residual(value: Array) -> Array:
        return np.concatenate([off(value).ravel() / noise, value / ANGLE_SIGMA_RAD])

    begin = min(starts, key=lambda start: float((residual(start) ** 2).sum()))
    found = least_squares(residual, begin)
    value = np.asarray(found.x, float)
    value[3:] = wrapped_angle(value[3:])
    return _Fit(
        names=names,
        value=value,
        sigma=np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac))),
        prior_sigma=np.full(len(names), ANGLE_SIGMA_RAD),
        residual=off(value) / noise,
    )


def _mounted(value: Array, sigma: Array) -> list[str]:
    """Say how a sensor is mounted, and how well that is known."""
    stated = " ".join(f"{each:.4f}" for each in value)
    lines = [f"its mounting, for carosac smooth: --mounting {stated}"]
    if sigma.max() > MOUNTING_TOLD_RAD:
        lines.append(
            f"the mounting is known to {np.rad2deg(sigma.max()):.0f} degrees only: rests in which "
            "the platform is turned about more axes, or further, tell more"
        )
    return lines


def _cables(rests: _Rests) -> tuple[str, ...]:
    """Return the names of the cables."""
    return rests.robot.cable_names


_MOUNTING = ("mounting.x", "mounting.y", "mounting.z")
_FITS: dict[str, Callable[[_Rests], _Fit | str]] = {
    "tension": _load_cells, "attitude": _attitude, "inclination": _inclination,
    "swivel_angle": _swivel_angles,
}  # fmt: skip
