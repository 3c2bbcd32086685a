"""Self-calibration: exit points, drums and all positions from motor angles and a few positions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibration.estimate import ParameterEstimate
from calibration.observability import Observability, Unobservable, judge
from calibration.self_calibration.blunder_tests import SettledFit, settle
from calibration.self_calibration.map_estimate import MapEstimate, estimate
from calibration.self_calibration.motor_angles import MotorAngles
from calibration.self_calibration.problem import MotorAngleProblem
from calibration.self_calibration.result import LeftOut, SampleBlunder, SelfCalibration
from calibration.self_calibration.settings import SelfCalibrationSettings
from calibration.self_calibration.solver import SampleFit, Trust, equations, fit
from calibration.self_calibration.starting_points import LINE_SIGMA_START_M, starts
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.extras import require
from carosac_toolkit.robot.robot import Robot

LOOSE_EXIT_SHARE = (
    0.05  # of the longest cable: an exit point less sure than that was not calibrated
)
FLAT_EXTENT_SHARE = 1e-3  # of their extent: known positions that close to a line or plane lie in it
RIVAL_COST_MAX = 13.8  # squared standard deviations: another solution that is less worse is as good
RIVAL_STEPS_MAX = 30
BLUNDER_SHARE_MAX = 0.2  # of the samples: more blunders are none
LINE_NOISE_SHARE_MAX = 0.02  # of the longest cable: more noise of the line is none
PRIOR_SIGMAS_MAX = 4.0  # standard deviations before: nothing is that far off by chance
_FREE_MOTIONS = {
    0: "no position is known, which leaves place and turns of everything free.",
    1: "1 position is known, which leaves turns about it free.",
    2: "2 positions are known, which leaves a turn about the line through them free.",
}
PREDICTED_SIGMA_MAX_M = 0.05  # [m] sigma above which predicting a known position tells nothing


def calibrate_motor_angles(
    motor_angles: MotorAngles, robot: Robot, settings: SelfCalibrationSettings | None = None
) -> SelfCalibration:
    """Find what the motor angles of a resting platform tell of a robot.

    Cables are straight and stiff, as no tensions are known: what a constant tension stretches is
    taken for a larger drum. The rotation of the platform is that at home.

    Args:
        motor_angles: N samples, a few with known positions.
        robot: As known before: exit points, drums, home and workspace.
        settings: Priors of all else.

    Returns:
        Parameters with covariances, positions with sigmas, residuals and blunders.

    Raises:
        InvalidField: The motors are not those of the robot, its drums are unknown, or there are too
            few samples to tell the noise.
        Unobservable: The data leave the exit points free.
    """
    require("self-calibration", "gtsam")
    settings = settings or SelfCalibrationSettings()
    angles = motor_angles.in_order_of(robot.cable_names)
    problem = MotorAngleProblem(robot, angles, settings)
    fits = starts(problem)
    everything = np.ones(len(angles.samples), dtype=np.bool_)
    line = settings.line_sigma or LINE_SIGMA_START_M
    rough = Trust(line_sigma=line, lengths=everything, known=angles.is_known, robust=False)
    _refuse(problem, fits[0], rough)
    settled = settle(problem, fits[0], settings)
    _refuse(problem, settled.fit, settled.trust)
    best = estimate(problem, settled)
    return _result(problem, settled, best, _warnings(problem, settled, fits[1:]))


def _result(
    problem: MotorAngleProblem, settled: SettledFit, best: MapEstimate, warnings: tuple[str, ...]
) -> SelfCalibration:
    """Put everything together."""
    angles, trust = problem.angles, settled.trust
    system = equations(problem, settled.fit.shared, settled.fit.position, trust)
    lost = ~trust.lengths & ~trust.known
    position = np.where(lost[:, None], settled.fit.position, best.position)
    spread = np.sqrt(np.diagonal(best.position_covariance, axis1=1, axis2=2))
    sigma = np.sqrt(np.diag(best.covariance))
    return SelfCalibration(
        before=problem.robot,
        estimate=_parameters(problem, best),
        samples=angles.samples,
        position=position,
        position_sigma=np.where(lost[:, None], np.inf, spread),
        residual=problem.linearize(best.shared, position).residual,
        used=trust.lengths,
        is_known=angles.is_known,
        known_position=angles.known_position,
        advantage=problem.advantage,
        length_at_zero=best.shared[problem.zeros],
        length_at_zero_sigma=sigma[problem.zeros],
        line_sigma=trust.line_sigma,
        redundancy=settled.redundancy,
        blunders=_blunders(problem, settled),
        left_out=_left_out(problem, settled),
        observability=problem.prior.judge(system.information - problem.prior.information),
        warnings=warnings,
    )


def _parameters(problem: MotorAngleProblem, best: MapEstimate) -> ParameterEstimate:
    """Return the parameters of the robot, each cable with its own drum."""
    robot = problem.robot
    before, slope_before = problem.drum_radius(problem.prior.mean)
    radius, slope = problem.drum_radius(best.shared)
    exits = np.eye(problem.size)[problem.exits.ravel()]
    buildup = np.eye(problem.size)[problem.buildups]
    to_robot = np.vstack([exits, slope, buildup])
    prior = problem.prior.covariance
    from_before = np.vstack([exits, slope_before, buildup])
    names = (
        *problem.prior.names[: problem.exits.size],
        *(f"drum_radius[{cable}]" for cable in robot.cable_names),
        *(f"drum_buildup[{cable}]" for cable in robot.cable_names),
    )
    covariance = to_robot @ best.covariance @ to_robot.T
    return ParameterEstimate(
        names=names,
        value=np.concatenate(
            [best.shared[problem.exits].ravel(), radius, best.shared[problem.buildups]]
        ),
        covariance=0.5 * (covariance + covariance.T),
        start=np.concatenate(
            [
                problem.prior.mean[problem.exits].ravel(),
                before,
                problem.prior.mean[problem.buildups],
            ]
        ),
        prior_sigma=np.sqrt(np.diag(from_before @ prior @ from_before.T)),
    )


def _refuse(problem: MotorAngleProblem, solution: SampleFit, trust: Trust) -> None:
    """Refuse data that leave the exit points where they were guessed.

    The exit points are judged with everything else known as before, their own prior aside.
    """
    system = equations(problem, solution.shared, solution.position, trust)
    rows = np.arange(problem.exits.size)
    rest = np.arange(len(rows), problem.size)
    data = system.information - problem.prior.information
    both = data + problem.prior.information
    tied = data[np.ix_(rows, rest)]
    alone = data[np.ix_(rows, rows)] - tied @ np.linalg.solve(both[np.ix_(rest, rest)], tied.T)
    seen = judge(problem.prior.names[: len(rows)], alone, problem.prior.sigma[rows])
    left = np.linalg.inv(both)[np.ix_(rows, rows)]
    loose = float(np.sqrt(np.linalg.eigvalsh(left)[-1]))
    if (seen.blind or seen.weak) and loose > LOOSE_EXIT_SHARE * problem.longest:
        raise Unobservable(_reason(problem, trust, seen, loose))


def _reason(problem: MotorAngleProblem, trust: Trust, seen: Observability, loose: float) -> str:
    """Explain why the exit points stay free, and what would help."""
    known = problem.angles.known_position[trust.known]
    count = len(known)
    spread = np.linalg.svd(known - known.mean(axis=0), compute_uv=False) if count else np.zeros(3)
    free = (*seen.blind, *seen.weak)
    if _misfits(problem, trust):
        why = _misfits(problem, trust)
    elif count in _FREE_MOTIONS:
        why = _FREE_MOTIONS[count]
    elif spread[1] < FLAT_EXTENT_SHARE * spread[0]:
        why = "the known positions lie on one line, which leaves a turn about it free."
    else:
        why = f"{len(problem.angles.samples)} samples are too few, or too close together."
    return (
        f"the motor angles do not determine the exit points: {why} Up to {loose:.2g} m stay free, "
        f"above all in {free[0]}. Allowed: at least three known positions, not on one line, "
        "among samples spread over the workspace; or exit points that the robot file knows better"
    )


def _warnings(
    problem: MotorAngleProblem, settled: SettledFit, rivals: list[SampleFit]
) -> tuple[str, ...]:
    """Name rival solutions, many blunders, and parameters far from their priors."""
    lines = []
    for rival in rivals:
        other = fit(problem, rival.shared, rival.position, settled.trust, steps=RIVAL_STEPS_MAX)
        worse = other.cost - settled.fit.cost
        apart = np.abs(other.shared[problem.exits] - settled.fit.shared[problem.exits]).max()
        if worse < RIVAL_COST_MAX and apart > LOOSE_EXIT_SHARE * problem.longest:
            lines.append(
                f"another solution fits almost as well ({worse:.1f} squared standard deviations "
                f"worse), with exit points up to {apart:.2f} m elsewhere, such as a mirrored one; "
                "a known position out of the plane of the others tells them apart"
            )
    misfits = _misfits(problem, settled.trust)
    lines += [misfits] if misfits else []
    far = problem.prior.deviation(settled.fit.shared)
    k = int(np.argmax(far))
    if far[k] > PRIOR_SIGMAS_MAX:
        lines.append(
            f"{problem.prior.names[k]} is {far[k]:.1f} prior standard deviations from its prior: "
            "are cables swapped, or is the robot file wrong there?"
        )
    return tuple(lines)


def _misfits(problem: MotorAngleProblem, trust: Trust) -> str:
    """Explain why most samples do not fit each other; empty if they do."""
    out, count = int((~trust.lengths).sum()), len(trust.lengths)
    if out > BLUNDER_SHARE_MAX * count:
        what = f"the motor angles of {out} of {count} samples do not fit the others"
    elif trust.line_sigma > LINE_NOISE_SHARE_MAX * problem.longest:
        what = f"the motor angles of all samples fit only to {trust.line_sigma:.2g} m of line"
    else:
        return ""
    return (
        f"{what}; is the robot file right about gears and advantages, and the file about the order "
        "and sign of the motors?"
    )


def _blunders(problem: MotorAngleProblem, settled: SettledFit) -> tuple[SampleBlunder, ...]:
    """Name the samples that were left out."""
    tests, trust, angles = settled.tests, settled.trust, problem.angles
    blunders = []
    for k, name in enumerate(angles.samples):
        if not trust.lengths[k]:
            sigmas = float(np.sqrt(tests.closure[k] / max(tests.closure_free[k], 1.0)))
            blunders.append(SampleBlunder(sample=name, what="motor angles", sigmas=sigmas))
        if angles.is_known[k] and not trust.known[k]:
            sigmas = float(np.sqrt(tests.place[k] / max(tests.place_free[k], 1.0)))
            blunders.append(SampleBlunder(sample=name, what="known position", sigmas=sigmas))
    return tuple(blunders)


def _left_out(problem: MotorAngleProblem, settled: SettledFit) -> tuple[LeftOut, ...]:
    """Predict each known position from everything else."""
    trust, angles, left_out = settled.trust, problem.angles, []
    for k in np.flatnonzero(trust.known & trust.lengths):
        known = trust.known.copy()
        known[k] = False
        less = replace(trust, known=known)
        other = fit(problem, settled.fit.shared, settled.fit.position, less)
        sigma = np.sqrt(
            np.diag(_position_covariance(problem, other, less, int(k)))
            + problem.known_sigma[k] ** 2
        )
        if (sigma < PREDICTED_SIGMA_MAX_M).all():
            error = other.position[k] - angles.known_position[k]
            left_out.append(LeftOut(sample=angles.samples[k], error=error, sigma=sigma))
    return tuple(left_out)


def _position_covariance(
    problem: MotorAngleProblem, solution: SampleFit, trust: Trust, row: int
) -> Array:
    """Return the covariance of one position [m^2], shape (3, 3)."""
    system = equations(problem, solution.shared, solution.position, trust)
    slope = system.by_shared[row]
    covariance: Array = system.position_covariance[row] + slope @ np.linalg.solve(
        system.information, slope.T
    )
    return covariance
