"""Other solutions of a self-calibration: other basins, and mirror images."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calibration.self_calibration.blunder_tests import SettledFit
from calibration.self_calibration.frame import Frame
from calibration.self_calibration.problem import MotorAngleProblem
from calibration.self_calibration.solver import SampleFit, Trust, fit
from carosac_toolkit.base.arrays import Array

SAME_EXIT_SHARE = 0.05  # of the longest cable: solutions with exit points that close are the same
RIVAL_COST_MAX = 13.8  # squared standard deviations: another solution that is less worse is as good
BETTER_COST_MIN = 1.0  # squared standard deviations: another solution that is that much better wins
RIVAL_STEPS_MAX = 30
MIRROR_SHARE = 0.02  # of the longest cable: mirrored exit points agree that well
OUTSIDE_SHARE = 0.03  # of the workspace's diagonal: positions that far out of it, RMS, are outside


@dataclass(frozen=True, kw_only=True, eq=False)
class Rival:
    """Another solution.

    Attributes:
        cost: By how much worse it fits [squared standard deviations].
        distance: Largest distance of an exit point from that of the best solution [m].
        mirrored: True if it is the mirror image of the best solution.
        outside: RMS distance of its positions from the workspace over the workspace's diagonal.
        fit: The solution.
    """

    cost: float
    distance: float
    mirrored: bool
    outside: float
    fit: SampleFit

    @property
    def as_good(self) -> bool:
        """Return whether the data and priors cannot tell it from the best one."""
        return self.cost < RIVAL_COST_MAX and not (self.mirrored and self.outside > OUTSIDE_SHARE)

    @property
    def better(self) -> bool:
        """Return whether it fits clearly better than the best one, inside the workspace or not."""
        return self.cost < -BETTER_COST_MIN

    @property
    def comparison(self) -> str:
        """Say how well it fits beside the best one."""
        if self.cost < 0.0:
            return f"as well ({-self.cost:.1f} squared standard deviations better)"
        return f"almost as well ({self.cost:.1f} squared standard deviations worse)"


def find_rivals(
    problem: MotorAngleProblem, settled: SettledFit, frame: Frame, others: list[SampleFit]
) -> list[Rival]:
    """Fit other solutions, and the mirror image, with the data that the best one trusts.

    Args:
        problem: The samples.
        settled: The best solution.
        frame: Its frame.
        others: Where other starts ended.

    Returns:
        Those that differ, the best first.
    """
    rivals = list[Rival]()
    best, near = settled.fit, SAME_EXIT_SHARE * problem.longest
    before, points = problem.points(problem.prior.mean), problem.points(settled.fit.shared)
    image = frame.aligned(problem, best, before, mirror=True)
    for start in [image, *_one_mirrored(problem, settled), *others]:
        first = frame.aligned(problem, start, before) if start is not image else image
        end = fit(problem, first.shared, first.position, settled.trust, steps=RIVAL_STEPS_MAX)
        end = frame.aligned(problem, end, before)
        other = fit(problem, end.shared, end.position, settled.trust, steps=RIVAL_STEPS_MAX)
        apart = _apart(problem, frame, other, points)
        new = all(
            _apart(problem, frame, other, problem.points(r.fit.shared)) > near for r in rivals
        )
        if apart > near and new:
            rivals.append(
                Rival(
                    cost=other.cost - best.cost,
                    distance=apart,
                    mirrored=_mirrored(problem, other, best, settled.trust),
                    outside=_outside(problem, other, settled.trust),
                    fit=other,
                )
            )
    return sorted(rivals, key=lambda rival: rival.cost)


def _apart(problem: MotorAngleProblem, frame: Frame, other: SampleFit, points: Array) -> float:
    """Return the largest distance of exit points from others, turned to fit them best [m]."""
    turned = frame.aligned(problem, other, points)
    return float(np.abs(problem.points(turned.shared) - points).max())


def better_rival(
    problem: MotorAngleProblem, settled: SettledFit, rivals: list[Rival]
) -> Rival | None:
    """Return a solution to adopt: one that fits better, or a mirror image in the workspace.

    A mirror image that fits as well is better where the best one is outside the workspace.
    """
    if rivals and rivals[0].better:
        return rivals[0]
    outside = _outside(problem, settled.fit, settled.trust)
    for rival in rivals:
        close = rival.mirrored and rival.cost < RIVAL_COST_MAX
        if close and outside > OUTSIDE_SHARE and rival.outside < 0.5 * outside:
            return rival
    return None


def fits_better(one: SettledFit, other: SettledFit) -> bool:
    """Return whether one solution fits more samples, or as many better, each with its own noise."""
    used = [int(settled.trust.lengths.sum()) for settled in (one, other)]
    misfit = [
        settled.fit.cost + 2.0 * settled.redundancy * np.log(settled.trust.line_sigma)
        for settled in (one, other)
    ]
    return used[0] > used[1] or (used[0] == used[1] and misfit[0] < misfit[1])


def rival_warning(rival: Rival) -> str:
    """Describe another solution that is as good."""
    if rival.mirrored:
        return (
            f"the mirror image fits {rival.comparison}, with exit points up to "
            f"{rival.distance:.2f} m elsewhere; exit points that the robot file knows better, or "
            "a known position out of the plane of the others, tell them apart"
        )
    return (
        f"another solution fits {rival.comparison}, with exit points up to "
        f"{rival.distance:.2f} m elsewhere; more samples, spread over the whole workspace, "
        "or a known position tell them apart"
    )


def _one_mirrored(problem: MotorAngleProblem, settled: SettledFit) -> list[SampleFit]:
    """Return starts with one exit point mirrored at the plane that the samples are nearest to.

    Samples in a plane cannot tell the sides of it, cable by cable.
    """
    best, used = settled.fit, settled.trust.lengths
    place = best.position[used, :3]
    middle = place.mean(axis=0)
    normal = np.linalg.svd(place - middle, full_matrices=False)[2][2]
    starts = []
    for cable, point in enumerate(problem.points(best.shared)):
        shared = best.shared.copy()
        shared[problem.exits[cable]] -= 2.0 * ((point - middle) @ normal) * normal
        starts.append(replace(best, shared=shared))
    return starts


def _mirrored(problem: MotorAngleProblem, other: SampleFit, best: SampleFit, trust: Trust) -> bool:
    """Return whether a solution is the mirror image of the other one.

    A platform that turns has none: its anchor points are not mirrored.
    """
    if problem.own == 6:
        return False
    both = [
        np.vstack([problem.points(one.shared), one.position[trust.lengths]])
        for one in (other, best)
    ]
    here, there = (points - points.mean(axis=0) for points in both)
    left, _, right = np.linalg.svd(here.T @ there)
    turn = left @ right
    away = float(np.sqrt(((here @ turn - there) ** 2).sum(axis=1).mean()))
    return bool(np.linalg.det(turn) < 0.0 and away < MIRROR_SHARE * problem.longest)


def _outside(problem: MotorAngleProblem, solution: SampleFit, trust: Trust) -> float:
    """Return the RMS distance of positions from the workspace over the workspace's diagonal."""
    low, high = problem.robot.workspace_min, problem.robot.workspace_max
    place = solution.position[trust.lengths, :3]
    out = np.maximum(low - place, 0.0) + np.maximum(place - high, 0.0)
    diagonal = float(np.linalg.norm(high - low))
    return float(np.sqrt((out**2).sum(axis=1).mean()) / diagonal)
