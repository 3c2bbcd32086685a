"""Fit after every sample, from where the last fit ended; and what a fit says of the next sample."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calibration.self_calibration.balance import operating_tensions
from calibration.self_calibration.knowledge import Knowledge, spare_directions
from calibration.self_calibration.motor_angles import MotorAngles
from calibration.self_calibration.problem import MotorAngleProblem
from calibration.self_calibration.settings import SelfCalibrationSettings
from calibration.self_calibration.solver import Trust, equations, fit, whiten
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot

LINE_SIGMA_BEFORE_M = 1e-3  # noise of the line that is expected before there are residuals
LINE_SIGMA_WEIGHT = 5.0  # lengths for which this expectation counts
NOISE_ROUNDS = 3
POSITION_STEPS = 10  # Gauss-Newton steps


@dataclass(frozen=True, kw_only=True, eq=False)
class GuideFit:
    """Fit of all samples.

    Attributes:
        known: Knowledge that they leave.
        position: Of the samples [m], shape (N, 3).
        spread: Root mean square of what the fit leaves of the line [m].
    """

    known: Knowledge
    position: Array
    spread: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Surprise:
    """Lengths of one sample beyond those that its position takes, against their prediction.

    Attributes:
        position: Platform origin by what was known [m], shape (3,).
        error: Measured less predicted line, in the spare directions [m], shape (n - 3,).
        covariance: Of that error, as predicted [m^2], shape (n - 3, n - 3).
        position_sigma: One standard deviation of the position, turns of the whole robot about home
            left out: the root of the trace of its covariance [m].
    """

    position: Array
    error: Array
    covariance: Array
    position_sigma: float

    @property
    def rms(self) -> float:
        """Root mean square error [m]."""
        return float(np.sqrt((self.error**2).mean()))

    @property
    def sigma(self) -> float:
        """Root mean square error that was predicted [m]."""
        return float(np.sqrt(np.trace(self.covariance) / len(self.error)))

    @property
    def chance(self) -> float:
        """Probability of an error as large, or larger, if the prediction is right."""
        from scipy.stats import chi2

        return float(chi2.sf(self.square, len(self.error)))

    @property
    def square(self) -> float:
        """Squared error in standard deviations, of n - 3 degrees of freedom."""
        return float(self.error @ np.linalg.solve(self.covariance, self.error))


def nothing_measured(
    robot: Robot, settings: SelfCalibrationSettings, *, tension: bool = False
) -> Knowledge:
    """Return what is known of a robot before any sample; `tension`: whether it is measured."""
    angles = MotorAngles(
        samples=("home",),
        cables=robot.cable_names,
        motor_angle=np.zeros((1, robot.n)),
        known_position=robot.home_position[None],
        is_known=np.ones(1, dtype=np.bool_),
        tension=operating_tensions(robot)[0][None] if tension else None,
    )
    problem = MotorAngleProblem(robot, angles, settings)
    mean = problem.prior.mean
    covariance: Array = np.asarray(np.linalg.inv(problem.before(mean).information), np.float64)
    return Knowledge(
        problem=problem, settings=settings, shared=mean, covariance=covariance,
        line_sigma=LINE_SIGMA_BEFORE_M,
    )  # fmt: skip


def refit(before: Knowledge, angles: MotorAngles, position: Array) -> GuideFit:
    """Fit all samples robustly, with the noise that they show.

    Args:
        before: Knowledge to start from.
        angles: N samples, the first at home.
        position: Start of their positions [m], shape (N, 3).
    """
    problem = MotorAngleProblem(before.problem.robot, angles, before.settings)
    sigma, shared = before.line_sigma, before.shared
    everything = np.ones(len(angles.samples), dtype=np.bool_)
    for _ in range(NOISE_ROUNDS):
        trust = Trust(line_sigma=sigma, lengths=everything, known=angles.is_known, robust=True)
        solution = fit(problem, shared, position, trust)
        shared, position = solution.shared, solution.position
        system = equations(problem, shared, position, trust)
        covariance: Array = np.asarray(np.linalg.inv(system.information), np.float64)
        line = problem.linearize(shared, position).residual * problem.advantage
        square = system.lengths[:, None] * line**2
        learnt = problem.size - float(np.trace(covariance @ problem.before(shared).information))
        spare = max((problem.robot.n - 3) * len(position) - learnt, 0.0)
        sigma = np.sqrt(
            (LINE_SIGMA_WEIGHT * LINE_SIGMA_BEFORE_M**2 + float(square.sum()))
            / (LINE_SIGMA_WEIGHT + spare)
        )
    known = Knowledge(
        problem=problem, settings=before.settings, shared=shared,
        covariance=0.5 * (covariance + covariance.T), line_sigma=float(sigma),
    )  # fmt: skip
    return GuideFit(known=known, position=position, spread=float(np.sqrt(square.mean())))


def exit_distances(known: Knowledge) -> Array:
    """Return the root mean square distance of each exit point from the truth [m], shape (n,).

    Turns of the whole robot about home are left out, as in the mean, `Knowledge.exit_distance`.
    """
    variance = np.diag(known.exit_covariance).reshape(-1, 3).sum(axis=1)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def first(angles: MotorAngles, count: int) -> MotorAngles:
    """Return the first samples."""
    return _rows(angles, slice(0, count))


def surprises(known: Knowledge, angles: MotorAngles, position: Array) -> list[Surprise]:
    """Compare samples, one by one, with what was known before them.

    Args:
        known: Knowledge without these samples.
        angles: N samples.
        position: Start of their positions [m], shape (3,).
    """
    return [
        _surprise(known, _rows(angles, slice(k, k + 1)), position)
        for k in range(len(angles.samples))
    ]


def _rows(angles: MotorAngles, rows: slice) -> MotorAngles:
    """Return some samples."""
    return replace(
        angles,
        samples=angles.samples[rows],
        motor_angle=angles.motor_angle[rows],
        known_position=angles.known_position[rows],
        is_known=angles.is_known[rows],
        known_axes=None if angles.known_axes is None else angles.known_axes[rows],
        tension=None if angles.tension is None else angles.tension[rows],
    )


def _surprise(known: Knowledge, sample: MotorAngles, position: Array) -> Surprise:
    """Compare one sample with what was known before it."""
    robot = known.problem.robot
    there = replace(
        sample, known_position=position[None], is_known=np.ones(1, dtype=np.bool_), known_axes=None
    )
    problem = MotorAngleProblem(robot, there, known.settings)
    where = position[None]
    for _ in range(POSITION_STEPS):
        white = whiten(problem, known.shared, where, known.line_sigma)
        where = where - np.linalg.lstsq(white.by_own[0], white.residual[0], rcond=None)[0]
    white = whiten(problem, known.shared, where, known.line_sigma)
    spare = spare_directions(white.by_own)[0]
    slope = spare.T @ white.by_shared[0]
    covariance = slope @ known.covariance @ slope.T + np.eye(len(slope))
    place = np.linalg.pinv(white.by_own[0])
    moved = place @ white.by_shared[0]
    spread = moved @ known.without_turns @ moved.T + place @ place.T
    return Surprise(
        position=where[0],
        position_sigma=float(np.sqrt(np.trace(spread))),
        error=known.line_sigma * spare.T @ white.residual[0],
        covariance=known.line_sigma**2 * covariance,
    )
