"""What may be behind much noise of the line: two motors exchanged, or one cable that is slack."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from calibration.self_calibration.blunder_tests import LINE_SIGMA_MIN_M, SettledFit, settle
from calibration.self_calibration.problem import MotorAngleProblem
from calibration.self_calibration.solver import SampleFit, Trust, equations, fit
from calibration.self_calibration.starting_points import all_data, quick_start, rough_cost
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError

SUSPICIOUS_NOISE_SHARE = 5e-4  # of the longest cable: noise of the line up to that is usual
EXCHANGED_NOISE_SHARE = 7e-4  # of the longest cable: motors that are exchanged leave more noise
NOISE_SHARE_USUAL = 2e-3  # of the longest cable: more noise of the line is warned of
BLUNDER_SHARE_MAX = 0.2  # of the samples: more blunders are none
NOISE_RATIO_MAX = 1.0 / 3.0  # of the noise: an explanation that leaves less is clearly better
SETTLED_MAX = 2  # explanations of one kind that are settled: those that fit best roughly
MISFIT_RATIO_MAX = 0.5  # of the mean square: a rough fit that leaves more is not settled
ROUGH_STEPS = 5  # of a fit without one cable
PRIOR_COST_MAX = 9.0  # for each shared unknown: three standard deviations from its prior


def suspects(problem: MotorAngleProblem, settled: SettledFit) -> tuple[str, ...]:
    """Name exchanged motors, or a cable that carries the noise, if one of these fits far better.

    Args:
        problem: The samples.
        settled: The fit.
    """
    many = (~settled.trust.lengths).mean() > BLUNDER_SHARE_MAX
    noise = settled.trust.line_sigma
    if problem.settings.line_sigma is not None:
        noise = _noise(problem, settled.fit)
    usual = noise <= SUSPICIOUS_NOISE_SHARE * problem.longest or np.isinf(noise)
    if usual and not many:
        return ()
    enough = NOISE_SHARE_USUAL * problem.longest if many else NOISE_RATIO_MAX * noise
    found: list[str] = []
    if many or noise > EXCHANGED_NOISE_SHARE * problem.longest:
        found += _exchanged(problem, settled, noise, enough)
    return (*found, *_one_cable(problem, settled, noise, enough))


def _exchanged(
    problem: MotorAngleProblem, settled: SettledFit, noise: float, enough: float
) -> list[str]:
    """Name the two motors that fit far better exchanged."""
    others = {
        pair: _with_exchanged(problem, pair) for pair in combinations(range(problem.robot.n), 2)
    }
    rough = {pair: rough_cost(other) for pair, other in others.items()}
    shared, position = settled.fit.shared, settled.fit.position
    as_they_are = equations(problem, shared, position, all_data(problem)).cost
    found = []
    for pair in sorted(others, key=lambda pair: rough[pair])[:SETTLED_MAX]:
        start = quick_start(others[pair])
        if start.cost < as_they_are:
            found.append((_noise(others[pair], start), pair))
    if not found:
        return []
    left, (first, second) = min(found)
    if left >= min(enough, noise):
        return []
    names = problem.robot.cable_names
    return [
        f"with the motors {names[first]} and {names[second]} exchanged the line fits to "
        f"{_compared(left, noise)}: are these two swapped?"
    ]


def _one_cable(
    problem: MotorAngleProblem, settled: SettledFit, noise: float, enough: float
) -> list[str]:
    """Name the cable without which the others fit far better."""
    spare = problem.robot.n - problem.own
    if spare < 2:
        return []
    # The cable that is left out has no misfit, but counts as one length to spare.
    share = float(np.sqrt(spare / (spare - 1.0)))
    rough = _misfits_without(problem, settled, noise)
    found = [
        (share * _noise(problem.without(cable=int(cable)), settled.fit), int(cable))
        for cable in np.argsort(rough)[:SETTLED_MAX]
        if rough[cable] < MISFIT_RATIO_MAX
    ]
    if not found:
        return []
    left, worst = min(found)
    if left >= min(enough, noise):
        return []
    return [
        f"without cable {problem.robot.cable_names[worst]} the line fits to "
        f"{_compared(left, noise)}: is this cable slack, off a pulley, or unevenly wound?"
    ]


def _with_exchanged(problem: MotorAngleProblem, pair: tuple[int, int]) -> MotorAngleProblem:
    """Return the problem with the motors of two cables exchanged."""
    order = np.arange(problem.robot.n)
    order[list(pair)] = pair[::-1]
    angles, tension = problem.angles, problem.angles.tension
    exchanged = replace(
        angles,
        motor_angle=angles.motor_angle[:, order],
        tension=None if tension is None else tension[:, order],
    )
    return MotorAngleProblem(problem.robot, exchanged, problem.settings)


def _misfits_without(problem: MotorAngleProblem, settled: SettledFit, noise: float) -> Array:
    """Return what short fits without one cable each leave of the mean square misfit, shape (n,)."""
    trust = all_data(problem)
    if np.isfinite(noise):
        trust = replace(trust, line_sigma=noise)
    if (~settled.trust.lengths).mean() <= BLUNDER_SHARE_MAX:
        trust = replace(trust, lengths=settled.trust.lengths, known=settled.trust.known)
    spare = problem.robot.n - problem.own
    before = _misfit(problem, settled.fit, trust) / spare
    left = []
    for cable in range(problem.robot.n):
        other = problem.without(cable=cable)
        short = fit(other, settled.fit.shared, settled.fit.position, trust, steps=ROUGH_STEPS)
        left.append(_misfit(other, short, trust) / (spare - 1))
    return np.array(left) / before


def _misfit(problem: MotorAngleProblem, solution: SampleFit, trust: Trust) -> float:
    """Return the cost without what is known before."""
    cost = equations(problem, solution.shared, solution.position, trust).cost
    return cost - problem.before(solution.shared).cost


def _compared(left: float, noise: float) -> str:
    """Return the noise that is left in words, beside what it was if that is known."""
    instead = f" instead of {1e3 * noise:.2g} mm" if np.isfinite(noise) else ""
    return f"{1e3 * left:.2g} mm{instead}"


def _noise(problem: MotorAngleProblem, start: SampleFit) -> float:
    """Return the noise of the line that a fit leaves [m].

    It is infinite if the fit leaves many samples out, or shrinks everything to a point.
    """
    try:
        found = settle(problem, start, replace(problem.settings, line_sigma=None))
    except CarosacError:
        return float("inf")
    line, out = found.trust.line_sigma, float((~found.trust.lengths).mean())
    far = problem.before(found.fit.shared).cost > PRIOR_COST_MAX * problem.size
    return float("inf") if far or line <= LINE_SIGMA_MIN_M or out > BLUNDER_SHARE_MAX else line
