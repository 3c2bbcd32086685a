"""Tests of every sample: its misfit, the noise of all, and which samples are blunders.

A sample of n lengths has n - 3 more than its position takes, n - 6 where its rotation is unknown as
well: what they leave is its closure. A known position is compared with the one that the lengths
alone give. Both are tested against their own covariance, in which a sample that was used takes part
of the noise away.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calibration.linear_samples import LinearSamples
from calibration.self_calibration.problem import MotorAngleProblem
from calibration.self_calibration.settings import SelfCalibrationSettings
from calibration.self_calibration.solver import (
    Mask,
    SampleFit,
    Trust,
    equations,
    fit,
    inverse,
    whiten,
)
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField

CHECKED_VARIANCE_MIN = 0.05  # share of its own noise that a combination must show for a test of it
NOISE_ROUNDS_MAX = 20
ROUND_STEPS_MAX = 10  # steps of a robust fit in each of them
POSITION_STEPS_MAX = 20  # Gauss-Newton steps
POSITION_STEP_MIN_M = 1e-7  # [m]
NOISE_CHANGE_MIN = 0.01  # relative change of the noise
LINE_SIGMA_MIN_M = 1e-6  # [m] that no line is known better than
REDUNDANCY_MIN = 5.0  # lengths beyond what is estimated, below which the noise must be given


@dataclass(frozen=True, kw_only=True, eq=False)
class SampleTests:
    """Squared misfits in standard deviations, and of how many combinations they are.

    Attributes:
        closure: Of the lengths of each sample, shape (N,).
        closure_free: Number of combinations in it, shape (N,).
        square: Sum of squares of each closure, not divided by its own variance, shape (N,).
        share: Mean of that by noise alone, shape (N,).
        place: Of each known position, 0 where unknown, shape (N,).
        place_free: shape (N,).
    """

    closure: Array
    closure_free: Array
    square: Array
    share: Array
    place: Array
    place_free: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class SettledFit:
    """A fit with the data that it believes.

    Attributes:
        fit: The values.
        soft: Those of the robust fit before, in which every sample has a position.
        trust: Noise and which data count.
        tests: Of every sample.
        redundancy: Lengths beyond what they were needed for.
    """

    fit: SampleFit
    soft: SampleFit
    trust: Trust
    tests: SampleTests
    redundancy: float


def settle(
    problem: MotorAngleProblem, start: SampleFit, settings: SelfCalibrationSettings
) -> SettledFit:
    """Find noise and blunders, and fit without them.

    Args:
        problem: The samples.
        start: A robust fit in the right basin.
        settings: Noise, if it is known, and what counts as a blunder.

    Raises:
        InvalidField: There are too few samples to tell the noise.
    """
    angles = problem.angles
    trust = Trust(
        line_sigma=settings.line_sigma or 5e-3,
        lengths=np.ones(len(angles.samples), dtype=np.bool_),
        known=problem.is_known,
        robust=True,
    )
    soft, trust = _soft(problem, start, trust, settings)
    solution = soft
    for _ in range(NOISE_ROUNDS_MAX):
        tests = test_samples(problem, solution, trust)
        lengths, known = _believed(problem, tests, settings)
        same = (lengths == trust.lengths).all() and (known == trust.known).all()
        line = trust.line_sigma
        if settings.line_sigma is None:
            share = _enough(float(tests.share[lengths].sum()))
            line *= np.sqrt(float(tests.square[lengths].sum()) / share)
        settled = (
            abs(line / trust.line_sigma - 1.0) < NOISE_CHANGE_MIN and not trust.robust and same
        )
        trust = Trust(
            line_sigma=max(line, LINE_SIGMA_MIN_M), lengths=lengths, known=known, robust=False
        )
        solution = _placed(
            problem, fit(problem, solution.shared, solution.position, trust), soft, trust
        )
        if settled or (line <= LINE_SIGMA_MIN_M and same):
            break
    tests = test_samples(problem, solution, trust)
    redundancy = float(tests.share[trust.lengths].sum())
    return SettledFit(fit=solution, soft=soft, trust=trust, tests=tests, redundancy=redundancy)


def cautious(problem: MotorAngleProblem, settled: SettledFit) -> Trust:
    """Return the data with the noise that makes covariances right where it was estimated.

    With an estimated noise, errors have a t distribution of as many freedoms as there are lengths
    to spare, whose variance is larger than that of a normal one.
    """
    trust, freedoms = settled.trust, settled.redundancy
    if problem.settings.line_sigma is not None or freedoms <= 2.0:
        return trust
    return replace(trust, line_sigma=trust.line_sigma * np.sqrt(freedoms / (freedoms - 2.0)))


def _placed(
    problem: MotorAngleProblem, solution: SampleFit, soft: SampleFit, trust: Trust
) -> SampleFit:
    """Return a fit with left-out samples at the positions that their lengths give."""
    out = ~trust.lengths & ~trust.known
    position = np.where(out[:, None], soft.position, solution.position)
    everything = replace(trust, lengths=np.ones_like(trust.lengths))
    for _ in range(POSITION_STEPS_MAX if out.any() else 0):
        step = equations(problem, solution.shared, position, everything).step
        position = np.where(out[:, None], position + step, position)
    return replace(solution, position=position)


def test_samples(problem: MotorAngleProblem, solution: SampleFit, trust: Trust) -> SampleTests:
    """Test every sample, used or not."""
    system = equations(problem, solution.shared, solution.position, trust)
    shared = inverse(system.information)
    where, white, own, gain = _by_lengths(problem, solution, trust)
    sign = 1.0 - 2.0 * system.lengths[:, None, None]  # -1: the sample was used, 1: it was not
    slope = white.by_own
    rest = np.eye(slope.shape[1]) - slope @ gain
    by_shared = rest @ white.by_shared
    covariance = rest + sign * (by_shared @ shared @ by_shared.swapaxes(1, 2))
    closure = np.einsum("kij,kj->ki", rest, white.residual)
    square, free = _normalised(closure, covariance)
    known = problem.is_known
    miss = where - problem.known_position
    moved = gain @ white.by_shared
    spread = own + np.eye(problem.own) * problem.known_sigma[:, None, :] ** 2
    both = 1.0 - 2.0 * (system.lengths * system.known)[:, None, None]
    place = spread + both * (moved @ shared @ moved.swapaxes(1, 2))
    scale = problem.known_axes / np.sqrt(np.diagonal(spread, axis1=1, axis2=2))
    away, away_free = _normalised(miss * scale, place * scale[:, :, None] * scale[:, None, :])
    return SampleTests(
        closure=square,
        closure_free=free,
        square=(closure**2).sum(axis=1),
        share=np.trace(covariance, axis1=1, axis2=2),
        place=np.where(known, away, 0.0),
        place_free=np.where(known, away_free, 0.0),
    )


def _by_lengths(
    problem: MotorAngleProblem, solution: SampleFit, trust: Trust
) -> tuple[Array, LinearSamples, Array, Array]:
    """Find the samples' own unknowns by the lengths alone, whatever is known of them.

    Returns:
        Own unknowns (N, own), the samples there, their covariances (N, own, own), and how they
        follow from the residuals (N, own, n).
    """
    where = solution.position
    for step in range(POSITION_STEPS_MAX):
        white = whiten(problem, solution.shared, where, trust.line_sigma)
        slope = white.by_own
        square = slope.swapaxes(1, 2) @ slope
        own: Array = np.asarray(np.linalg.pinv(square, rcond=1e-10, hermitian=True), np.float64)
        gain = own @ slope.swapaxes(1, 2)
        move = np.einsum("kij,kj->ki", gain, white.residual)
        if step == POSITION_STEPS_MAX - 1 or np.abs(move).max() < POSITION_STEP_MIN_M:
            break
        where = where - move
    return where, white, own, gain


def _soft(
    problem: MotorAngleProblem, start: SampleFit, trust: Trust, settings: SelfCalibrationSettings
) -> tuple[SampleFit, Trust]:
    """Fit robustly, with the noise of the median sample."""
    from scipy.stats import chi2

    solution = fit(problem, start.shared, start.position, trust)
    if settings.line_sigma is not None:
        return solution, trust
    for _ in range(NOISE_ROUNDS_MAX):
        tests = test_samples(problem, solution, trust)
        some = tests.closure_free > 0
        _enough(float(tests.share.sum()))
        ratio = tests.closure[some] / chi2.median(tests.closure_free[some])
        change = float(np.sqrt(np.median(ratio)))
        line = max(trust.line_sigma * change, LINE_SIGMA_MIN_M)
        done = abs(change - 1.0) < NOISE_CHANGE_MIN or line == LINE_SIGMA_MIN_M
        trust = replace(trust, line_sigma=line)
        solution = fit(problem, solution.shared, solution.position, trust, steps=ROUND_STEPS_MAX)
        if done:
            break
    return solution, trust


def _believed(
    problem: MotorAngleProblem, tests: SampleTests, settings: SelfCalibrationSettings
) -> tuple[Mask, Mask]:
    """Return which lengths, and which known positions, are no blunders."""
    lengths = chance(tests.closure, tests.closure_free) > settings.blunder
    places = chance(tests.place, tests.place_free) > settings.blunder
    # What a known position is compared with are the lengths: where they are wrong it stays.
    return lengths, problem.is_known & (places | ~lengths)


def chance(square: Array, free: Array) -> Array:
    """Return the probability of a squared misfit as large by noise alone; 1 without a test."""
    from scipy.stats import chi2

    return np.asarray(np.where(free > 0, chi2.sf(square, np.maximum(free, 1)), 1.0))


def _normalised(vector: Array, covariance: Array) -> tuple[Array, Array]:
    """Return the squared norms by the covariance, and the rank used, each shape (N,)."""
    values, axes = np.linalg.eigh(0.5 * (covariance + covariance.swapaxes(1, 2)))
    seen = values > CHECKED_VARIANCE_MIN
    along = np.einsum("kji,kj->ki", axes, vector)
    square = np.where(seen, along**2 / np.where(seen, values, 1.0), 0.0)
    return square.sum(axis=1), seen.sum(axis=1).astype(np.float64)


def _enough(share: float) -> float:
    """Refuse to tell the noise from hardly anything."""
    if share < REDUNDANCY_MIN:
        allowed = (
            f"at least {REDUNDANCY_MIN:g} more consistent lengths than parameters estimated from "
            "them; check the unit of the known positions and the order and sign of the motors; if "
            "these are right, set line_sigma, the noise of the line, in the settings"
        )
        raise InvalidField("motor angles", f"{max(share, 0.0):.1f} more", allowed)
    return share
