"""Next positions that would teach most about the exit points, among those that are safe to reach.

A position of a point-like platform takes three of its n lengths; the n - 3 others teach something
about the exit points. The choice is greedy and D-optimal: each position is the one that shrinks the
volume of the joint uncertainty of the exit points most, together with those before. Turns of the
whole robot about home are left out: no length tells them.

A position is safe if every robot that is likely by now can hold all cables taut there, below the
highest tensions that are used on purpose.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calibration.box_points import EDGE_SHARE, draw_in_box
from calibration.self_calibration.knowledge import Knowledge, spare_lengths
from calibration.self_calibration.problem import MotorAngleProblem
from calibration.self_calibration.safe_tensions import safe_margin, tension_error
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField

CANDIDATE_POSITIONS = 600
SUGGESTED_POSITIONS_MAX = 40
TENTATIVE_SHARE = 0.1  # of the candidates: the safest ones, where none is safe for sure
PATH_SHARES = (0.25, 0.5, 0.75, 1.0)  # of the way to a position, where it must be safe as well


class NoSafePosition(CarosacError):
    """No position can be reached safely with what is known."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Reach:
    """Part of the workspace to choose from.

    Attributes:
        start: Place from which the platform moves on straight lines [m], shape (3,).
        visited: Places where it has rested safely [m], shape (V, 3).
        distance: Largest distance from one of them [m].
        tension_error_max: Largest predicted error of a tension on the way there [N]; infinite
            where tensions are measured and kept by feedback.
        tentative: Whether the safest tenth of all positions will do where none is safe for sure;
            only where tensions are measured and a move turns back before the limits.
    """

    start: Array
    visited: Array
    distance: float = np.inf
    tension_error_max: float = np.inf
    tentative: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class SuggestedPositions:
    """Positions in the order of their worth, N of them.

    Attributes:
        position: Platform origin in W [m], shape (N, 3).
        sigma: Largest one standard deviation of an exit point after each further position [m],
            shape (N + 1,); the first is that before.
        margin: Smallest margin of a tension to the tensions used on purpose, over the robots that
            are likely by what is known [N], shape (N,).
    """

    position: Array
    sigma: Array
    margin: Array

    def data(self) -> list[dict[str, Any]]:
        """Return all numbers, ready for JSON."""
        return [
            {"position_m": p, "exit_sigma_max_m": s, "tension_margin_N": m}
            for p, s, m in zip(
                self.position.tolist(), self.sigma[1:].tolist(), self.margin.tolist(), strict=True
            )
        ]  # fmt: skip


def suggest_positions(
    known: Knowledge,
    count: int,
    *,
    rng: np.random.Generator,
    reach: Reach | None = None,
) -> SuggestedPositions:
    """Choose positions one after the other, each the best together with those before.

    Args:
        known: Present knowledge.
        count: How many.
        rng: Source of candidates and of the robots that are likely.
        reach: Part of the workspace to choose from; None: all of it, starting at home.

    Raises:
        InvalidField: No number of positions that can be suggested.
        NoSafePosition: None of the candidates is safe.
    """
    if not 1 <= count <= SUGGESTED_POSITIONS_MAX:
        raise InvalidField("count", count, f"1 to {SUGGESTED_POSITIONS_MAX}")
    where, margin = safe_positions(known, rng, reach)
    chosen, sigma = most_informative(known, where, count)
    return SuggestedPositions(position=where[chosen], sigma=sigma, margin=margin[chosen])


def most_informative(known: Knowledge, where: Array, count: int) -> tuple[list[int], Array]:
    """Choose some of these positions, each the best together with those before.

    Args:
        known: Present knowledge.
        where: Candidates [m], shape (C, 3).
        count: How many.

    Returns:
        Numbers of the chosen ones, and the largest one standard deviation of an exit point before
        and after each of them [m], shape (count + 1,).
    """
    slope = spare_lengths(known, where)
    now, chosen, sigma = known, list[int](), [float(known.exit_sigma.max())]
    for _ in range(count):
        best, covariance = _best(now, slope)
        chosen.append(best)
        now = replace(now, covariance=covariance)
        sigma.append(float(now.exit_sigma.max()))
    return chosen, np.array(sigma)


def safe_positions(
    known: Knowledge,
    rng: np.random.Generator,
    reach: Reach | None = None,
    *,
    candidates: int = CANDIDATE_POSITIONS,
    edges: float = EDGE_SHARE,
) -> tuple[Array, Array]:
    """Draw positions that are safe to reach on a straight line.

    Args:
        known: Present knowledge.
        rng: Source of candidates and of the robots that are likely.
        reach: Part of the workspace to draw from; None: all of it, starting at home.
        candidates: How many are drawn; those that are safe remain.
        edges: Share of them that lie on the edges of the workspace box [1].

    Returns:
        Positions [m], shape (C, 3), and their margins [N], shape (C,).

    Raises:
        NoSafePosition: There is none.
    """
    robot = known.problem.robot
    area = reach or Reach(start=robot.home_position, visited=robot.home_position[None])
    where = _candidates(known.problem, area, rng, candidates, edges)
    ways = area.start + np.array(PATH_SHARES)[:, None, None] * (where - area.start)
    margin = safe_margin(known, ways.reshape(-1, 3), rng).reshape(len(PATH_SHARES), -1)
    worst = margin.min(axis=0)
    good = worst >= 0.0
    if area.tentative and not good.any():
        good = worst >= np.quantile(worst, 1.0 - TENTATIVE_SHARE)
    if np.isfinite(area.tension_error_max):
        error = tension_error(known, area.start, where)
        good &= error <= area.tension_error_max
        if not good.any() and (worst >= 0.0).any():
            raise NoSafePosition(
                f"tensions would be wrong by {error[worst >= 0.0].min():.3g} N (3 sigma) or more "
                f"on the way to every position, as the exit points are known to "
                f"{known.exit_sigma.max():.2g} m only; allowed: {area.tension_error_max:.3g} N"
            )
    if not good.any():
        raise NoSafePosition(
            f"no position within {area.distance:.2g} m of those visited can be held taut within "
            f"the tension limits by all robots that are likely by now; the best lacks "
            f"{-worst.max():.3g} N"
        )
    return where[good], worst[good]


def _candidates(
    problem: MotorAngleProblem, area: Reach, rng: np.random.Generator, count: int, edges: float
) -> Array:
    """Draw positions from the workspace box, some of them on its edges [m], shape (C, 3).

    Those out of reach are drawn towards a visited place.
    """
    where = draw_in_box(problem.robot, rng, count, edges)
    if not np.isfinite(area.distance):
        return np.asarray(where)
    near = area.visited[rng.integers(0, len(area.visited), len(where))]
    way = where - near
    far = np.linalg.norm(way, axis=1, keepdims=True)
    return np.asarray(near + way * np.minimum(1.0, area.distance / np.maximum(far, 1e-12)))


def _best(known: Knowledge, slope: Array) -> tuple[int, Array]:
    """Return the position that shrinks the volume most, and the covariance that it leaves."""
    now, rows = known.covariance, known.problem.exits.ravel()
    moved = slope @ now
    gain = np.linalg.solve(moved @ slope.swapaxes(1, 2) + np.eye(slope.shape[1]), moved)
    taken = moved[:, :, rows].swapaxes(1, 2) @ gain[:, :, rows]
    best = int(np.argmin(known.volume(now[np.ix_(rows, rows)] - taken)))
    after = now - moved[best].T @ gain[best]
    return best, np.asarray(0.5 * (after + after.T))
