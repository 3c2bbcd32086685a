"""Check of a home against all that senses the platform, and the error that this would notice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.numbers import check_fields
from carosac_toolkit.loop.values import Measurement, State
from carosac_toolkit.physics.rest.senses import AXES, SensedHome, sensed_home, turn_between
from carosac_toolkit.robot.robot import Robot

FALSE_ALARM_PROBABILITY = 1e-4  # of refusing a right home
SWAY_SAMPLES = 4  # a second of sway and vibration tells its mean as well as so many samples do
DETECTABLE_MAX_M = 10.0  # a larger error is not worth a number
DETECTION_DEVIATIONS = 2.33  # beyond the limit, so that 99 % of such errors are noticed
LOAD_CELLS, IMU, POSE = "load cells", "IMU", "pose measurement"


@dataclass(frozen=True, kw_only=True)
class SenseErrors:
    """Standard deviations of what senses the platform at rest, and of a home that is right.

    Attributes:
        tension_noise: Of a load cell, per sample [N].
        tension_bias: Of a load cell, constant; friction at pulleys and of its mounting too [N].
        tension_scale: Of the scale of a load cell.
        mass: Of the mass of the platform, relative to that of the robot file.
        specific_force_noise: Of the IMU, per axis and sample [m/s^2].
        specific_force_bias: Of the IMU, per axis, constant [m/s^2].
        imu_mounting: Of the rotation of the IMU on the platform, per axis [rad].
        position: Of a measured pose, per axis [m].
        rotation: Of a measured pose, per axis [rad].
        home_position: Of the home that a person measures, per axis [m].
        home_rotation: The same of its rotation, where six cables or more hold one [rad].
    """

    tension_noise: float = 0.5
    tension_bias: float = 1.0
    tension_scale: float = 0.005
    mass: float = 0.005
    specific_force_noise: float = 0.02
    specific_force_bias: float = 0.05
    imu_mounting: float = 0.01
    position: float = 0.005
    rotation: float = 0.005
    home_position: float = 0.01
    home_rotation: float = 0.01

    def __post_init__(self) -> None:
        """Refuse errors that are not positive, as no reading is exact."""
        check_fields(self, positive=tuple(vars(self)))


@dataclass(frozen=True, kw_only=True, eq=False)
class HomeEvidence:
    """Result of comparing readings with a home.

    Attributes:
        senses: Names of what senses the platform, besides encoders.
        deviation: Distance of all readings together from those expected, in their standard
            deviations.
        limit: Largest deviation of a right home.
        worst: The reading that is farthest off, in words.
        detectable: Error of the home that is noticed along each axis of W [m], shape (3,).
        detectable_worst: The same along the direction in which it is largest [m].
    """

    senses: tuple[str, ...]
    deviation: float
    limit: float
    worst: str
    detectable: Array
    detectable_worst: float

    @property
    def contradicts(self) -> bool:
        """True if the readings do not fit the home."""
        return self.deviation > self.limit

    @property
    def sensitivity(self) -> str:
        """Error of the home that the senses would notice, in words."""
        if not self.senses:
            return "encoders alone do not show a wrong home"
        seen = [
            f"{far:.2f} m along {axis}" if far < DETECTABLE_MAX_M else f"never along {axis}"
            for far, axis in zip(self.detectable, "xyz", strict=True)
        ]
        names = " and ".join(self.senses)
        return f"a wrong home shows in {names} from {seen[0]}, {seen[1]} and {seen[2]}"


def home_evidence(
    robot: Robot, home: State, measurements: Sequence[Measurement], errors: SenseErrors
) -> HomeEvidence:
    """Compare what senses the platform at rest with its home.

    Load cells count only where all cables are taut at home.

    Raises:
        InvalidField: The platform cannot rest there.
    """
    tensions = {float(m.tension.time[0]): m.tension.value[0] for m in measurements if m.tension}
    samples = np.array(list(tensions.values()))  # a late one is measured twice and counts once
    expected = sensed_home(robot, home, samples.mean(axis=0) if len(samples) else None)
    reading, noise = _means(expected, samples, measurements, errors)
    rows = np.flatnonzero(np.isfinite(reading))
    if not len(rows):
        far = np.full(AXES, np.inf)
        return HomeEvidence(senses=(), deviation=0.0, limit=0.0, worst="", detectable=far,
                            detectable_worst=float("inf"))  # fmt: skip
    from scipy.stats import chi2

    off = reading[rows] - expected.reading[rows]
    covariance = _covariance(expected, noise, errors, robot)[np.ix_(rows, rows)]
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))
    free = expected.by_stress.shape[1] if rows[0] < robot.n else 0  # which any stress explains
    limit = float(np.sqrt(chi2.isf(FALSE_ALARM_PROBABILITY, len(rows) - free)))
    change = whiten @ expected.by_position[rows]
    least = float(np.linalg.svd(change, compute_uv=False)[-1])
    seen = limit + DETECTION_DEVIATIONS
    with np.errstate(divide="ignore"):
        detectable = seen / np.linalg.norm(change, axis=0)
        detectable_worst = float(seen / np.float64(least))
    i = int(np.argmax(np.abs(off) / np.sqrt(np.diag(covariance))))
    names = _reading_names(robot)
    worst = f"{names[rows[i]]} is {reading[rows[i]]:.3f}, expected {expected.reading[rows[i]]:.3f}"
    return HomeEvidence(
        senses=tuple(name for name, part in _parts(robot.n) if np.isfinite(reading[part]).any()),
        deviation=float(np.linalg.norm(whiten @ off)), limit=limit, worst=worst,
        detectable=detectable, detectable_worst=detectable_worst,
    )  # fmt: skip


def _parts(n: int) -> tuple[tuple[str, slice], ...]:
    """Return who senses which readings of n cables."""
    return (
        (LOAD_CELLS, slice(0, n)),
        (IMU, slice(n, n + AXES)),
        (POSE, slice(n + AXES, n + 3 * AXES)),
    )


def _reading_names(robot: Robot) -> list[str]:
    """Return each reading in words, with its unit."""
    return [
        *(f"the tension of cable '{name}' in N" for name in robot.cable_names),
        *(f"the specific force along {axis} of the platform in m/s^2" for axis in "xyz"),
        *(f"the measured position along {axis} in m" for axis in "xyz"),
        *(f"the measured rotation about {axis} in rad" for axis in "xyz"),
    ]


def _means(
    expected: SensedHome, tensions: Array, measurements: Sequence[Measurement], errors: SenseErrors
) -> tuple[Array, Array]:
    """Return the mean of each reading, NaN where nothing senses it, and its variance, (n + 9,)."""
    n = len(expected.reading) - 3 * AXES
    reading, variance = np.full((2, n + 3 * AXES), np.nan)
    if len(tensions) and expected.taut:
        reading[:n] = tensions.mean(axis=0)
        scale = errors.tension_scale * expected.reading[:n]
        variance[:n] = _of_mean(tensions, errors.tension_noise) + errors.tension_bias**2 + scale**2
    forces = [m.imu.specific_force[0] for m in measurements if m.imu]
    if forces:
        samples, part = np.concatenate(forces), slice(n, n + AXES)
        mounting = errors.imu_mounting * np.linalg.norm(expected.reading[part])
        reading[part] = samples.mean(axis=0)
        variance[part] = _of_mean(samples, errors.specific_force_noise) + mounting**2
        variance[part] += errors.specific_force_bias**2
    pose = measurements[-1].pose
    if pose is not None:
        turn = turn_between(expected.rotation, pose.rotation[0])
        reading[n + AXES :] = np.concatenate([pose.position[0], turn])
        variance[n + AXES :] = np.repeat([errors.position**2, errors.rotation**2], AXES)
    return reading, variance


def _of_mean(samples: Array, noise: float) -> Array:
    """Return the variance of the mean of samples with noise of a platform that may sway."""
    return np.asarray(noise**2 / len(samples) + samples.var(axis=0) / SWAY_SAMPLES)


def _covariance(expected: SensedHome, variance: Array, errors: SenseErrors, robot: Robot) -> Array:
    """Return the covariance of readings at a home that is right, shape (n + 9, n + 9).

    Besides the sensors: how well a person measures a home, the mass, and cables that pull against
    each other by any stress, which no home decides.
    """
    weighed = np.zeros((len(variance), 1))
    weighed[: robot.n, 0] = errors.mass * expected.reading[: robot.n]
    unknown = np.concatenate(
        [
            errors.home_position * expected.by_position,
            errors.home_rotation * expected.by_rotation,
            float(robot.tension_max.max()) * expected.by_stress,
            weighed,
        ],
        axis=1,
    )
    return np.asarray(np.diag(variance) + unknown @ unknown.T)
