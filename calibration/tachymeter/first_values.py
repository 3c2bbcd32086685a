"""First values: set-ups are placed by the points they share, outward from the known ones.

Heading and position of a levelled set-up follow from two points. Every pair is tried and the one
that most points agree with is taken, so that a blunder does not spoil the start.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from calibration.observability import Unobservable
from calibration.tachymeter.observations import ReferencePoint, Survey, cartesian
from carosac_toolkit.base.arrays import Array

HEADING_SPREAD_MIN_M = 0.2  # [m] across, seen from above, below which two points tell no heading
_AGREEMENT_MAX_M = 0.1  # [m] beyond which a point does not agree
Places = dict[str, Array]


def first_values(survey: Survey) -> tuple[Places, Places]:
    """Place all set-ups and points.

    Args:
        survey: With the known references.

    Returns:
        Set-ups by name, (6,) as in `model.predict`, and points in W by name [m], (3,).

    Raises:
        Unobservable: Too few known points, or a set-up that nothing ties to them.
    """
    check_known(survey)
    local = {name: _local(survey, name) for name in survey.setups}
    points: Places = {
        ref.name: np.array(ref.position) for ref in survey.known if ref.position is not None
    }
    stations: Places = {}
    while len(stations) < len(local):
        left = [name for name in local if name not in stations]
        name = max(left, key=lambda key: _ties(local[key], points))
        placed = _place(local[name], points)
        if placed is None:
            raise Unobservable(_loose(name, local[name], points, bool(stations)))
        stations[name] = placed
        seen = _to_world(placed, local[name])
        points |= {target: place for target, place in seen.items() if target not in points}
    return stations, points


def check_known(survey: Survey) -> None:
    """Refuse a survey that has no place or no heading in the robot's frame.

    Raises:
        Unobservable: Says what is missing.
    """
    known = survey.known
    need = (
        "needed are coordinates and sigma, in the robot's frame, of at least two sighted points "
        "that lie apart when seen from above; with three or more a wrong coordinate shows"
    )
    if len(known) < 2:
        unsighted = [
            ref.name for ref in survey.references.values()
            if ref.position is not None and ref not in known
        ]  # fmt: skip
        have = f"only {known[0].name} has" if known else "no sighted point has"
        extra = f" ({', '.join(unsighted)}: known, but never sighted)" if unsighted else ""
        missing = "heading" if known else "place and heading"
        raise Unobservable(
            f"{have} known coordinates{extra}, so the {missing} of the survey in the robot's frame "
            f"{'is' if known else 'are'} unknown; {need}"
        )
    if _spread(known) < HEADING_SPREAD_MIN_M:
        names = ", ".join(ref.name for ref in known)
        raise Unobservable(
            f"the known points {names} lie on one vertical line, within {_spread(known):.3f} m of "
            f"each other when seen from above, so the heading of the survey is unknown; {need}"
        )


def _spread(known: tuple[ReferencePoint, ...]) -> float:
    """Return the largest horizontal distance between two known points [m]."""
    flat = np.array([ref.position for ref in known])[:, :2]
    return float(np.linalg.norm(flat[:, None] - flat[None], axis=2).max())


def _local(survey: Survey, name: str) -> Places:
    """Return the points in the frame of a set-up: medians over the shots of a target."""
    shots = [shot for shot in survey.shots if shot.setup == name]
    points = cartesian(np.array([[s.hz, s.v, s.distance] for s in shots]))
    return {
        target: np.median([p for p, s in zip(points, shots, strict=True) if s.target == target], 0)
        for target in dict.fromkeys(shot.target for shot in shots)
    }


def _ties(local: Places, points: Places) -> int:
    """Count the points with a place that a set-up sees."""
    return sum(target in points for target in local)


def _place(local: Places, points: Places) -> Array | None:
    """Place a set-up by the pair of points with which most others agree."""
    common = [target for target in local if target in points]
    if len(common) < 2:
        return None
    here, there = np.array([local[t] for t in common]), np.array([points[t] for t in common])
    best, least = None, np.inf
    for i, j in combinations(range(len(common)), 2):
        station = _from_pair(here[[i, j]], there[[i, j]])
        if station is None:
            continue
        miss = np.linalg.norm(_moved(station, here) - there, axis=1)
        cost = float((np.minimum(miss, _AGREEMENT_MAX_M) ** 2).sum())
        if cost < least:
            best, least = station, cost
    return best


def _from_pair(here: Array, there: Array) -> Array | None:
    """Return the heading and position of a levelled set-up from two points, shapes (2, 3)."""
    a, b = here[1] - here[0], there[1] - there[0]
    if min(np.hypot(a[0], a[1]), np.hypot(b[0], b[1])) < HEADING_SPREAD_MIN_M:
        return None
    heading = np.arctan2(b[1], b[0]) - np.arctan2(a[1], a[0])
    station = np.array([0.0, 0.0, 0.0, heading, 0.0, 0.0])
    station[:3] = (there - _moved(station, here)).mean(axis=0)
    return station


def _moved(station: Array, here: Array) -> Array:
    """Return the points of a set-up's frame in W, shapes (B, 3)."""
    cosine, sine = np.cos(station[3]), np.sin(station[3])
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(station[:3] + here @ turn.T)


def _to_world(station: Array, local: Places) -> Places:
    """Return the points that a set-up sees, in W."""
    return {target: _moved(station, place[None])[0] for target, place in local.items()}


def _loose(name: str, local: Places, points: Places, others: bool) -> str:
    """Explain why a set-up cannot be placed."""
    common = [target for target in local if target in points]
    with_whom = "with the other set-ups and the known points" if others else "with the known points"
    if len(common) < 2:
        shared = f"only {common[0]}" if common else "nothing"
        why = f"shares {shared} {with_whom}"
    else:
        why = f"shares {', '.join(common)} {with_whom}, which lie above each other"
    return (
        f"set-up {name} {why}, so its heading or place is unknown; sight at least two common "
        "points from it that lie apart when seen from above (three to find blunders)"
    )
