"""The verdict on a self-calibration: what the data leave undetermined, and what contradicts it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibration.observability import Unobservable, judge
from calibration.self_calibration.blunder_tests import SettledFit
from calibration.self_calibration.frame import Frame, mean_distance
from calibration.self_calibration.knowledge import Knowledge
from calibration.self_calibration.problem import POINT_LIKE_SHARE, MotorAngleProblem
from calibration.self_calibration.rivals import Rival, rival_warning
from calibration.self_calibration.solver import SampleFit, Trust, equations
from calibration.self_calibration.suggested_positions import most_informative
from calibration.self_calibration.suspects import BLUNDER_SHARE_MAX, NOISE_SHARE_USUAL
from carosac_toolkit.base.arrays import Array

LOOSE_EXIT_SHARE = (
    0.05  # of the longest cable: an exit point less sure than that was not calibrated
)
NEXT_POSITIONS = 3  # that are named
GRID_POINTS = 4  # along each side of the workspace from which they are chosen
LINE_NOISE_SHARE_MAX = 0.02  # of the longest cable: more noise of the line is none
TAUGHT_SHARE_MAX = 0.75  # of the exit points' sigma before: samples that leave more teach little
ACCURACY_SHARE = 0.01  # of the longest cable: wanted of the exit points where nothing is stated
PRIOR_SIGMAS_MAX = 4.0  # standard deviations before: nothing is that far off by chance
FLAT_SHARE = 0.05  # of their largest extent: samples that close to a plane or line lie in it


def check_rotation(problem: MotorAngleProblem) -> None:
    """Refuse a platform whose rotation is unknown where no lengths are to spare for it.

    Raises:
        Unobservable: With the reason.
    """
    if problem.keeps_rotation or problem.own == 6:
        return
    raise Unobservable(
        f"the cables end up to {problem.spread:.2g} m apart on the platform, which turns as it "
        f"moves, and lengths of {problem.robot.n} cables have nothing to spare for its rotation. "
        "Allowed: seven cables or more; cables that end within "
        f"{POINT_LIKE_SHARE * problem.longest:.2g} m of each other; a recording of rests with an "
        "AHRS, swivel angles or load cells; or a platform that is built to keep its rotation "
        "(keeps_rotation in the settings, --keeps-rotation)"
    )


def check_determined(
    problem: MotorAngleProblem, solution: SampleFit, trust: Trust, frame: Frame
) -> None:
    """Refuse data that leave the exit points where they were guessed.

    The exit points are judged with everything else known as before, their own prior aside, and
    without the free motions of everything.

    Raises:
        Unobservable: With the reason.
    """
    system = equations(problem, solution.shared, solution.position, trust)
    rows = np.arange(problem.exits.size)
    rest = np.arange(len(rows), problem.size)
    data = frame.held(system.information - problem.prior.information)
    both = data + problem.prior.information
    tied = data[np.ix_(rows, rest)]
    alone = data[np.ix_(rows, rows)] - tied @ np.linalg.solve(both[np.ix_(rest, rest)], tied.T)
    seen = judge(problem.prior.names[: len(rows)], alone, problem.prior.sigma[rows])
    left = np.linalg.inv(both)[np.ix_(rows, rows)]
    variance, axes = np.linalg.eigh(left)
    loose = float(np.sqrt(variance[-1]))
    if loose > LOOSE_EXIT_SHARE * problem.longest:
        named = problem.prior.names[int(np.argmax(np.abs(axes[:, -1])))]
        free = (*seen.blind, *seen.weak, named)[0]
        covariance = frame.covariance(system.information)
        further = ""
        if problem.robot.n > 3 and not misfits(problem, trust):
            further = next_positions(problem, solution.shared, covariance, trust.line_sigma)
        raise Unobservable(_reason(problem, solution, trust, free, loose) + further)


def next_positions(
    problem: MotorAngleProblem, shared: Array, covariance: Array, line_sigma: float
) -> str:
    """Name the positions of the workspace that would teach most about the exit points.

    Args:
        problem: The samples.
        shared: Values of the shared unknowns, shape (m,).
        covariance: Shape (m, m).
        line_sigma: Noise of the line paid out [m].
    """
    robot = problem.robot
    sides = [np.linspace(*ends, GRID_POINTS) for ends in zip(
        robot.workspace_min, robot.workspace_max, strict=True)]  # fmt: skip
    grid = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    # Candidates have home's rotation and no tensions: the compliances, the last unknowns, are out.
    settings = replace(problem.settings, x_through=None, keeps_rotation=True)
    plain = MotorAngleProblem(robot, replace(problem.angles, tension=None), settings)
    known = Knowledge(
        problem=plain,
        settings=settings,
        shared=shared[: plain.size],
        covariance=covariance[: plain.size, : plain.size],
        line_sigma=line_sigma,
    )
    chosen, _ = most_informative(known, grid, NEXT_POSITIONS)
    places = ", ".join("(" + ", ".join(f"{part:.2f}" for part in grid[k]) + ")" for k in chosen)
    return f". Of the workspace, samples near {places} m would teach most"


def check_reference(problem: MotorAngleProblem, trust: Trust) -> None:
    """Refuse a reference that does not fit the other samples, as the origin hangs on it.

    Raises:
        Unobservable: Naming the sample.
    """
    reference = problem.reference
    if reference is not None and not trust.lengths[reference.row]:
        raise Unobservable(
            f"the motor angles of sample {reference.sample!r}, the reference, which is the origin, "
            "do not fit the other samples. Allowed: another sample there, or known positions"
        )


def _reason(
    problem: MotorAngleProblem, solution: SampleFit, trust: Trust, free: str, loose: float
) -> str:
    """Explain why the exit points stay free, and what would help."""
    count, spare = len(problem.angles.samples), problem.robot.n - problem.own
    unknown = problem.size - 6
    if misfits(problem, trust):
        why = misfits(problem, trust)
    elif problem.angles.spans_plane:
        why = f"{count} samples are too few, or too close together."
    elif spare == 0:
        why = (
            "three cables have no length to spare beyond those that a position takes, so that "
            "known positions alone can tell their exit points."
        )
    elif count * spare < unknown:
        why = (
            f"{count} samples have {count * spare} lengths to spare, fewer than the {unknown} "
            "unknowns."
        )
    else:
        why = _thin(problem, solution, trust) or (
            f"{count} samples are too few, or too close together."
        )
    help_ = "samples spread over the whole workspace, high and low; " if spare else ""
    return (
        f"the motor angles do not determine the exit points: {why} Up to {loose:.2g} m stay free, "
        f"above all in {free}. Allowed: {help_}at least three known positions, not on one "
        "line, among samples spread over the workspace; or exit points that the robot file knows "
        "better"
    )


def _thin(problem: MotorAngleProblem, solution: SampleFit, trust: Trust) -> str:
    """Explain in which direction the samples do not spread; empty if they do."""
    place = solution.position[trust.lengths, :3]
    _, size, axes = np.linalg.svd(place - place.mean(axis=0), full_matrices=False)
    extent = size / np.sqrt(len(place))
    if extent[2] > FLAT_SHARE * extent[0]:
        return ""
    across = ", ".join(f"{part:.2f}" for part in axes[2])
    what = "on a line" if extent[1] < FLAT_SHARE * extent[0] else "in a plane"
    return (
        f"the samples lie {what}, within {extent[2]:.2g} m RMS along ({across}); others off it are "
        "needed."
    )


def misfits(
    problem: MotorAngleProblem, trust: Trust, noise_share: float = LINE_NOISE_SHARE_MAX
) -> str:
    """Explain why most samples do not fit each other; empty if they do.

    Args:
        problem: The samples.
        trust: Noise and which data count.
        noise_share: Of the longest cable: more noise of the line is no noise.
    """
    out, count = int((~trust.lengths).sum()), len(trust.lengths)
    if out > BLUNDER_SHARE_MAX * count:
        what = f"the motor angles of {out} of {count} samples do not fit the others"
    elif trust.line_sigma > noise_share * problem.longest:
        what = f"the motor angles of all samples fit only to {trust.line_sigma:.2g} m of line"
    else:
        return ""
    return (
        f"{what}; is the robot file right about gears and advantages, and the file about the order "
        "and sign of the motors?"
    )


def warnings_of(
    problem: MotorAngleProblem,
    settled: SettledFit,
    rivals: list[Rival],
    frame: Frame,
    covariance: Array,
) -> tuple[str, ...]:
    """Name rival solutions, many blunders, what taught nothing, and what contradicts the prior.

    Args:
        problem: The samples.
        settled: The fit.
        rivals: Other solutions.
        frame: Of the result.
        covariance: Of the shared unknowns in the frame of the result, shape (m, m).
    """
    lines = [rival_warning(rival) for rival in rivals if rival.as_good][:1]
    bad = misfits(problem, settled.trust, NOISE_SHARE_USUAL)
    lines += [bad] if bad else []
    far = problem.prior.deviation(settled.fit.shared)
    k = int(np.argmax(far))
    if far[k] > PRIOR_SIGMAS_MAX:
        lines.append(
            f"{problem.prior.names[k]} is {far[k]:.1f} prior standard deviations from its prior: "
            "are cables swapped, or is the robot file wrong there?"
        )
    stated = problem.settings.accuracy
    wanted = ACCURACY_SHARE * problem.longest if stated is None else stated
    rows = problem.exits.ravel()
    expected = mean_distance(covariance[np.ix_(rows, rows)])
    before = mean_distance(_untaught(problem, settled, frame)[np.ix_(rows, rows)])
    if expected > TAUGHT_SHARE_MAX * before:
        lines.append(
            "the samples teach hardly anything about the exit points, which are known to "
            f"{1e3 * before:.1f} mm without them and to {1e3 * expected:.1f} mm with them: samples "
            "spread over the whole workspace are needed"
        )
    if expected > wanted:
        usual = f", {ACCURACY_SHARE:.0%} of the longest cable unless stated" * (stated is None)
        lines.append(
            f"exit points are known to {1e3 * expected:.1f} mm on average, not to the "
            f"{1e3 * wanted:.1f} mm wanted{usual}: more samples are needed"
            + next_positions(problem, settled.fit.shared, covariance, settled.trust.line_sigma)
        )
    return tuple(lines)


def _untaught(problem: MotorAngleProblem, settled: SettledFit, frame: Frame) -> Array:
    """Return the covariance of the shared unknowns without all samples but the reference."""
    reference = problem.reference
    rows = np.arange(len(problem.angles.samples))
    only = rows == reference.row if reference is not None else np.zeros_like(rows, dtype=np.bool_)
    trust = replace(settled.trust, lengths=only)
    system = equations(problem, settled.fit.shared, settled.fit.position, trust)
    return frame.covariance(system.information)
