"""Calibrations of simulated robots of which no position is known; figures go to RESULTS.md."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from benchmarks.results import table, write_section
from benchmarks.unknown_robots import (
    FRICTION_SHARE,
    LINE_SIGMA_M,
    SAMPLINGS,
    STIFFNESS_N,
    TENSION_N,
    UnknownRobot,
    draw_unknown_robot,
)
from calibration import SelfCalibration, calibrate_motor_angles
from calibration.self_calibration.frame import find_frame, mean_distance
from calibration.self_calibration.problem import MotorAngleProblem
from calibration.self_calibration.solver import Trust, equations
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.base.rotations import best_rotation

COMMAND = "python -m benchmarks.calibration_unknown"
ROBOTS = 200
CABLES = (4, 5, 6, 7, 8)
UNDETERMINED = 50
SIZE_M = 3.0  # of the frame for which errors are stated
ACCURACY_M = 10e-3  # wanted of the exit points of a frame of that size
SEED = 31


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """A calibration that was tried.

    Attributes:
        cables: Number of cables.
        expected: RMS error of the exit points, by the covariance at the truth [m of a 3 m frame].
        stated: The same by the calibration, NaN where it was refused.
        error: Mean distance of exit points from the truth after a rigid motion, as `expected`.
        nees: Squared error of the exit points in the frame of convention, by the covariance.
        freedoms: Of `nees`.
        accepted: True if it was neither refused nor warned of.
        reason: First words of the refusal or warning.
        seconds: Processor time.
    """

    cables: int
    expected: float
    stated: float
    error: float
    nees: float
    freedoms: int
    accepted: bool
    reason: str
    seconds: float


def calibrate(case: UnknownRobot, *, wanted: bool = True) -> Outcome:
    """Calibrate one robot and compare it with the truth.

    Args:
        case: The robot.
        wanted: True if an accuracy is asked for.
    """
    scale = SIZE_M / case.size
    settings = replace(case.settings, accuracy=ACCURACY_M / scale if wanted else None)
    expected = scale * expected_at_truth(case)
    begin = time.process_time()
    try:
        result = calibrate_motor_angles(case.angles, case.before, settings)
    except CarosacError as error:
        return Outcome(
            cables=case.before.n, expected=expected, stated=np.nan, error=np.nan, nees=np.nan,
            freedoms=0, accepted=False, reason=str(error),
            seconds=time.process_time() - begin,
        )  # fmt: skip
    seconds = time.process_time() - begin
    k = case.exit_points.size
    exits = result.estimate.value[:k].reshape(-1, 3)
    there = exits.mean(axis=0) + turned(
        case.exit_points - case.exit_points.mean(axis=0), exits - exits.mean(axis=0)
    )
    nees, freedoms = frame_nees(result, case)
    return Outcome(
        cables=case.before.n,
        expected=expected,
        stated=scale * mean_distance(result.estimate.covariance[:k, :k]),
        error=scale * float(np.linalg.norm(exits - there, axis=1).mean()),
        nees=nees,
        freedoms=freedoms,
        accepted=not result.warnings,
        reason=result.warnings[0] if result.warnings else "",
        seconds=seconds,
    )


def turned(points: Array, towards: Array) -> Array:
    """Return points turned about the origin to fit others best."""
    return np.asarray(points @ best_rotation(points, towards).T)


def frame_nees(result: SelfCalibration, case: UnknownRobot) -> tuple[float, int]:
    """Return the squared error of the exit points, in standard deviations, and its freedoms.

    The truth is brought into the frame of convention: home at the origin, and for point-like
    movers turned to fit the exit points known before. The three turns that this takes away have no
    variance.
    """
    k = case.exit_points.size
    free = result.frame.free.shape[1]
    truth = turned(case.exit_points, case.before.exit_points) if free else case.exit_points
    error = result.estimate.value[:k] - truth.ravel()
    variance, axes = np.linalg.eigh(result.estimate.covariance[:k, :k])
    along = axes.T @ error
    return float((along[free:] ** 2 / variance[free:]).sum()), k - free


def expected_at_truth(case: UnknownRobot) -> float:
    """Return the RMS error of the exit points that the data allow [m], by the truth."""
    problem = MotorAngleProblem(case.before, case.angles, case.settings)
    shared = problem.prior.mean.copy()
    shared[problem.exits] = case.exit_points
    shared[problem.zeros] = np.linalg.norm(case.exit_points - problem.offsets, axis=1)
    stretch = FRICTION_SHARE / np.sqrt(3.0) * TENSION_N / STIFFNESS_N * shared[problem.zeros].mean()
    trust = Trust(
        line_sigma=float(np.hypot(LINE_SIGMA_M, stretch)),
        lengths=np.array([name not in case.blunders for name in case.angles.samples]),
        known=problem.is_known,
        robust=False,
    )
    system = equations(problem, shared, case.position, trust)
    frame = find_frame(problem, shared, system.information - problem.before(shared).information)
    rows = problem.exits.ravel()
    return mean_distance(frame.covariance(system.information)[np.ix_(rows, rows)])


def rows_of(outcomes: Sequence[Outcome], bad: Sequence[tuple[str, Outcome]]) -> list[list[str]]:
    """Return the table."""
    kept = {n: [one for one in outcomes if one.cables == n] for n in CABLES}
    each = ", ".join(
        f"{n}: {sum(one.accepted for one in those)} of {len(those)}" for n, those in kept.items()
    )
    allowed = ", ".join(
        f"{n}: {1e3 * np.median([one.expected for one in those]):.1f}" for n, those in kept.items()
    ) + " mm"  # fmt: skip
    accepted = [one for one in outcomes if one.accepted]
    error = 1e3 * np.array([one.error for one in accepted])
    nees = sum(one.nees for one in accepted)
    freedoms = sum(one.freedoms for one in accepted)
    low, high = chi2.ppf([0.025, 0.975], freedoms) / freedoms
    good = [one for one in outcomes if one.expected <= ACCURACY_M]
    refused = sum(not one.accepted for one in good)
    wrong = sum(one.error > 4.0 * one.stated for one in accepted)
    kinds = [kind for kind, one in bad if one.accepted]
    seconds = [one.seconds for one in outcomes]
    return [
        ["robots; accepted, neither refused nor warned of", "reported",
         f"{len(outcomes)}; {len(accepted)}"],
        ["accepted, by number of cables", "reported", each],
        ["RMS error that the data allow (covariance at the truth), median by number of cables",
         "reported", allowed],
        ["mean error of the exit points, median over accepted robots", "5 mm",
         f"{np.median(error):.2f} mm"],
        ["the same, 95 % of them", "10 mm", f"{np.percentile(error, 95):.2f} mm"],
        ["normalised squared error of the exit points", f"{low:.3f} to {high:.3f}",
         f"{nees / freedoms:.3f}"],
        ["accepted with an error of more than four stated ones (wrong basin)", "0", f"{wrong}"],
        ["well determined (by the covariance at the truth); of these not accepted", "10 %",
         f"{len(good)}; {100.0 * refused / max(len(good), 1):.1f} %"],
        [f"undetermined ({', '.join(SAMPLINGS[1:])} samples); of these accepted", "0",
         f"{len(bad)}; {len(kinds)}"],
        ["time of one calibration, median and longest", "10 s",
         f"{np.median(seconds):.1f} s, {max(seconds):.1f} s"],
    ]  # fmt: skip


def main(count: int = ROBOTS) -> None:
    """Measure and write."""
    outcomes, bad = [], []
    for k in range(count):
        case = draw_unknown_robot(np.random.default_rng([SEED, k]), cables=CABLES[k % len(CABLES)])
        outcomes.append(calibrate(case))
    kinds = SAMPLINGS[1:]
    for k in range(UNDETERMINED * count // ROBOTS):
        kind = kinds[k % len(kinds)]
        case = draw_unknown_robot(
            np.random.default_rng([SEED, 1, k]),
            cables=CABLES[k // len(kinds) % len(CABLES)],
            sampling=kind,
        )
        bad.append((kind, calibrate(case, wanted=kind != "home")))
    for one in [*outcomes, *(outcome for _, outcome in bad)]:
        print(
            f"{one.cables} cables, expected {1e3 * one.expected:.1f} stated {1e3 * one.stated:.1f} "
            f"error {1e3 * one.error:.2f} mm, NEES {one.nees / max(one.freedoms, 1):.2f}, "
            f"{one.seconds:.1f} s {'' if one.accepted else 'NOT ACCEPTED ' + one.reason[:90]}"
        )
    body = table(["what", "bar", "measured"], rows_of(outcomes, bad))
    print(body)
    if count == ROBOTS:
        write_section(
            "calibration-unknown", "Self-calibration without any known position", COMMAND, body
        )


if __name__ == "__main__":
    main(*(int(word) for word in sys.argv[1:]))
