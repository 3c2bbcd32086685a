"""Verdicts on poses: inside the workspace or not, by what margin, and by which limit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carosac_toolkit.base.arrays import Array, batch, rotations
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.physics.rest.distance import cable_distances, separate_pairs
from carosac_toolkit.physics.rest.hold import WidestRest, hold
from carosac_toolkit.physics.rest.statics import Equilibrium
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.workspace.frame import beyond_frame, too_flat, without_cable
from carosac_toolkit.workspace.limits import Limit, tension_limit
from carosac_toolkit.workspace.second_search import second_search
from carosac_toolkit.workspace.settings import WorkspaceSettings

WEIGHTLESS_DENSITY_RATIO = 1e-9  # of its own density: a cable that heavy is straight to rounding
LOOP_LENGTH_RATIO = 1.04  # of its straight line: longer, it pulls with less than its own weight
SHAPE_CHUNK_POSES = 4096  # poses whose cable shapes are in memory at a time


@dataclass(frozen=True, kw_only=True, eq=False)
class Verdicts:
    """Verdicts on B poses.

    Attributes:
        rest: Equilibria with the tensions of the largest margin; where `rest.converged` is False
            there is none and only position and, with n >= 6, rotation mean something.
        margin: Distance of the tensions from their limits [N], shape (B,), the least over
            the required wrenches; negative: by so much the limits would have to be widened.
            Minus infinity where nothing balances, NaN where it was not computed.
        limit: The `Limit` that keeps each pose out, `Limit.INSIDE` where none does, shape (B,). A
            cable that exceeds its winch only because it hangs in a loop is `Limit.SLACK`.
        cable: Index of the cable that the limit is about, for `Limit.NO_EQUILIBRIUM` the one that
            would have to push most; -1: none, shape (B,).
        nearest: The tension limit that counts most for the margin, inside as well: `Limit.SLACK`,
            `Limit.OVERLOAD` or `Limit.NO_EQUILIBRIUM`, shape (B,).
        nearest_cable: Its cable, -1: none, shape (B,).
        tilt: Angle of the platform's z axis to that at home [rad], shape (B,); NaN without a rest.
        distance: Smallest distance between the surfaces of two cables [m], shape (B,); NaN without
            a rest, infinity where no two cables can meet.
        pair: Indices of those two cables, shape (B, 2).
    """

    rest: Equilibrium
    margin: Array
    limit: NDArray[np.int32]
    cable: NDArray[np.int32]
    nearest: NDArray[np.int32]
    nearest_cable: NDArray[np.int32]
    tilt: Array
    distance: Array
    pair: NDArray[np.int64]

    @property
    def inside(self) -> NDArray[np.bool_]:
        """True where a pose belongs to the workspace, shape (B,)."""
        inside: NDArray[np.bool_] = self.limit == Limit.INSIDE
        return inside


def modelled(robot: Robot, settings: WorkspaceSettings) -> Robot:
    """Return the robot to judge: itself, or with cables so light that they are straight."""
    if settings.sag:
        return robot
    return replace(robot, linear_density=WEIGHTLESS_DENSITY_RATIO * robot.linear_density)


def judge(
    robot: Robot,
    position: ArrayLike,
    rotation: ArrayLike | None = None,
    *,
    settings: WorkspaceSettings | None = None,
    lines: ArrayLike | None = None,
) -> Verdicts:
    """Judge poses.

    Args:
        robot: Robot description, n cables.
        position: Platform origin in W [m], shape (B, 3).
        rotation: Rotation from P to W, shape (B, 3, 3); None: the home rotation with n >= 6. With
            n < 6 it must be None: the rotation is found.
        settings: Demands on a pose; None: the defaults.
        lines: Start of each line of neighbouring poses; see `widest_rest.hold`.

    Returns:
        A verdict for each pose. It does not depend on the other poses of the batch, apart from
        where along a line a free rotation is searched first.
    """
    asked = settings or WorkspaceSettings()
    where = batch("position", position, (3,))
    turn = _rotation(robot, rotation, len(where))
    model = modelled(robot, asked)
    free = robot.n < 6
    flat = too_flat(robot, where) if free else np.zeros(len(where), dtype=bool)
    apart = beyond_frame(robot, where) if free else without_cable(robot, where, turn)
    hopeless = apart | flat
    weight_only, worst = _hold(model, where, turn, asked, lines, hopeless)
    nearest, nearest_cable = tension_limit(worst.margin, worst.low, worst.high, worst.lowest)
    if not free:  # where the search failed a proof decides; elsewhere its margin says more
        failed = np.isnan(worst.margin)
        apart, flat = apart | failed & beyond_frame(robot, where), failed & too_flat(robot, where)
    margin = np.where(apart | flat, -np.inf, worst.margin)
    rest = weight_only.rest
    tilt = np.where(rest.converged, tilt_angle(robot, rest.rotation), np.nan)
    distance, pair = _distance(model, rest)
    limit, cable = _first_limit(robot, asked, rest, tilt, distance)
    by_tension = np.where(np.isnan(margin), Limit.NOT_CONVERGED, nearest)
    by_tension = np.where(flat, Limit.TOO_FLAT, by_tension)
    by_tension = np.where(apart, Limit.NO_PULL, by_tension)
    out = ~(margin >= 0.0)
    unknown = apart | flat | np.isnan(margin)
    return Verdicts(
        rest=rest,
        margin=margin,
        limit=np.where(out, by_tension, limit).astype(np.int32),
        cable=np.where(out, np.where(unknown, -1, nearest_cable), cable).astype(np.int32),
        nearest=by_tension.astype(np.int32),
        nearest_cable=np.where(unknown, -1, nearest_cable).astype(np.int32),
        tilt=tilt,
        distance=distance,
        pair=pair,
    )


def _rotation(robot: Robot, rotation: ArrayLike | None, size: int) -> Array | None:
    """Return one rotation per pose, checked."""
    if rotation is None:
        return None
    if robot.n < 6:
        raise InvalidField("rotation", "a rotation", f"None: {robot.n} cables leave it free")
    return rotations("rotation", rotation, size)


def _hold(
    robot: Robot,
    position: Array,
    rotation: Array | None,
    settings: WorkspaceSettings,
    lines: ArrayLike | None,
    hopeless: NDArray[np.bool_],
) -> tuple[WidestRest, WidestRest]:
    """Return the rest under the weight alone, and that of the worst required wrench.

    Hopeless poses stay at home while the others are computed, which costs least.
    """
    where = np.where(hopeless[:, None], robot.home_position, position)
    turn = rotation
    if turn is not None:
        turn = np.where(hopeless[:, None, None], robot.home_rotation, turn)
    held = hold(robot, where, turn, lines=lines)
    if robot.n < 6:
        held = second_search(robot, held, ~hopeless)
    shown = robot.home_rotation if rotation is None else rotation
    rest = replace(
        held.rest,
        position=position,
        rotation=np.where(hopeless[:, None, None], shown, held.rest.rotation),
        converged=held.rest.converged & ~hopeless,
        stable=held.rest.stable & ~hopeless,
        status=np.where(hopeless, 2, held.rest.status).astype(np.int32),
        stiffness=np.where(hopeless[:, None, None], np.nan, held.rest.stiffness),
    )
    held = replace(held, rest=rest)
    worst = held
    for wrench in settings.wrenches():
        if wrench.any():
            worst = _worse(worst, hold(robot, where, turn, wrench=wrench, lines=lines))
    return held, worst


def _worse(one: WidestRest, other: WidestRest) -> WidestRest:
    """Return row by row the smaller margin: proved infeasible, not computed, then numbers."""
    first, second = (
        np.where(np.isneginf(each.margin), 0, np.where(np.isnan(each.margin), 1, 2))
        for each in (one, other)
    )
    take = (second < first) | ((second == first) & (other.margin < one.margin))
    picked = {
        name: np.where(
            take if getattr(one, name).ndim == 1 else take[:, None],
            getattr(other, name),
            getattr(one, name),
        )
        for name in ("margin", "gap", "low", "high", "lowest", "solved")
    }
    return replace(one, **picked)


def tilt_angle(robot: Robot, rotation: Array) -> Array:
    """Return the angle of the platform's z axis to that at home [rad], shape (B,)."""
    cosine = rotation[:, :, 2] @ robot.home_rotation[:, 2]
    across = np.linalg.norm(np.cross(rotation[:, :, 2], robot.home_rotation[:, 2]), axis=1)
    angle: Array = np.arctan2(across, cosine)
    return angle


def _distance(robot: Robot, rest: Equilibrium) -> tuple[Array, NDArray[np.int64]]:
    """Return the smallest distance of two cables and their indices; NaN without a rest."""
    size = len(rest.position)
    least, pair = np.full(size, np.nan), np.full((size, 2), -1)
    rows = np.flatnonzero(rest.converged)
    if len(separate_pairs(robot)) == 0:
        least[rows] = np.inf
        return least, pair
    for start in range(0, len(rows), SHAPE_CHUNK_POSES):
        part = rows[start : start + SHAPE_CHUNK_POSES]
        distances, pairs = cable_distances(robot, pick(rest, part))
        first = np.argmin(distances, axis=1)
        least[part] = distances[np.arange(len(part)), first]
        pair[part] = pairs[first]
    return least, pair


def pick(rest: Equilibrium, rows: NDArray[np.intp]) -> Equilibrium:
    """Return some of the equilibria."""
    return Equilibrium(**{name: value[rows] for name, value in vars(rest).items()})


def _first_limit(
    robot: Robot, settings: WorkspaceSettings, rest: Equilibrium, tilt: Array, distance: Array
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the first limit, apart from the tensions', that a rest breaks, and its cable."""
    length = rest.unstrained_length
    short, long = length < robot.length_min, length > robot.length_max
    longest = np.argmax(length - robot.length_max, axis=1)
    loop = _hangs_in_a_loop(robot, rest, longest, np.flatnonzero(long.any(axis=1)))
    near = np.zeros(len(tilt), dtype=bool)
    if settings.clearance is not None:
        near = distance < settings.clearance
    steep = np.zeros(len(tilt), dtype=bool)
    if settings.tilt_max is not None:
        steep = tilt > settings.tilt_max
    cases = (
        (~rest.stable, Limit.UNSTABLE, -1),
        (steep, Limit.TILT, -1),
        (short.any(axis=1), Limit.TOO_SHORT, np.argmax(robot.length_min - length, axis=1)),
        (loop, Limit.SLACK, longest),
        (long.any(axis=1), Limit.TOO_LONG, longest),
        (near, Limit.COLLISION, -1),
    )
    limit = np.full(len(tilt), Limit.INSIDE, dtype=np.int32)
    cable = np.full(len(tilt), -1, dtype=np.int32)
    for broken, name, which in reversed(cases):
        limit = np.where(broken, name, limit)
        cable = np.where(broken, which, cable)
    return limit.astype(np.int32), cable.astype(np.int32)


def _hangs_in_a_loop(
    robot: Robot, rest: Equilibrium, cable: NDArray[np.intp], rows: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """Return where a cable would fit on its winch, were it not for its loop, shape (B,).

    Only the weight of the loop keeps the tension at the platform above its limit. A parabola whose
    horizontal pull equals its weight sags by 1/8 of its span, and is longer by 8/3 of 1/8 squared.

    Args:
        robot: Robot description.
        rest: Equilibria, B poses.
        cable: Index of the cable of each pose, shape (B,).
        rows: Indices of the poses to judge; the others are False.
    """
    loop = np.zeros(len(cable), dtype=bool)
    if len(rows) == 0:
        return loop
    which = cable[rows]
    straight = straight_length(robot, rest.position[rows], rest.rotation[rows]).length
    line = straight[np.arange(len(rows)), which]
    length = rest.unstrained_length[rows, which]
    loop[rows] = (line <= robot.length_max[which]) & (length > LOOP_LENGTH_RATIO * line)
    return loop
