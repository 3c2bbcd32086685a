r"""Feasibility of the paths of a study: can tensions and winches of the robot follow them at all?

Along each path the cables have to carry the weight and accelerate the platform,

.. math:: A f + m (g - a) = 0, \qquad f_{min} \le f \le f_{max},

and the winches have to follow the lengths. Cables are straight, half of the weight of each hangs at
the platform, and the platform neither sways nor turns: what is not feasible here no controller can
do without breaking a limit; what is feasible here may still be too hard for a controller. With
fewer than six cables the rotation is free, and forces alone are balanced. A path run through s
times as fast has s times the speed and s^2 times the acceleration, which gives the fastest one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.numbers import plain
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.protocols import replays
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.physics.rest import statics, tension_margin
from carosac_toolkit.physics.rest.structure import structure_matrix
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.studies.run.case import Case
from carosac_toolkit.studies.run.run_case import digest_of, path_of, robot_digest, robot_of
from carosac_toolkit.trajectories.path_file import is_path_file
from carosac_toolkit.trajectories.trajectory import Trajectory

PATH_SAMPLES = 160  # of one path
PATHS_MAX = 3  # seeds of each kind of path that are judged: they differ little
CABLES_MIN = 3  # with fewer the platform rests on a surface only, which a path need not lie on
MARGIN_TOLERANCE_RATIO = 0.02  # of the weight per cable: what straight cables may be wrong by
WINCH_TOLERANCE_RATIO = 1e-3  # of a winch limit: differences of lengths are not exact
STRETCH_STEPS = 1000  # of a factor of all times, which is rounded up
BISECTIONS = 10  # of the square of the time scale: 0.1 % of it


@dataclass(frozen=True, kw_only=True)
class PathFeasibility:
    """Feasibility of the paths of one kind on one robot, over the first seeds.

    Attributes:
        robot: Name or path of the robot, as in the study.
        robot_name: Its own name.
        trajectory: Kind of path.
        paths: Number of different paths judged.
        infeasible: Number of those that are not feasible.
        reason: What stops the one that is stopped first; empty where all are feasible.
        time_scale: Factor of all speeds with which every path is feasible; None where not even
            infinitely slow motion is, 1 where all are feasible as they are.
        speed: Highest speed of any path [m/s].
        acceleration: Highest acceleration of any path [m/s^2].
    """

    robot: str
    robot_name: str
    trajectory: str
    paths: int
    infeasible: int
    reason: str
    time_scale: float | None
    speed: float
    acceleration: float

    def sentence(self) -> str:
        """Say in words what is not feasible, why, and how fast it would be."""
        part = f" ({self.infeasible} of the first {self.paths} paths)" if self.paths > 1 else ""
        text = f"{self.trajectory}{part} is not feasible on {self.robot_name}: {self.reason}."
        if self.time_scale is None:
            return f"{text} At no speed: the robot cannot even rest there."
        platform = (
            f"{self.time_scale * self.speed:.3g} m/s and "
            f"{self.time_scale**2 * self.acceleration:.3g} m/s^2"
        )
        if is_path_file(self.trajectory):
            stretch = np.ceil(STRETCH_STEPS / self.time_scale) / STRETCH_STEPS
            return (
                f"{text} Feasible with all times in the file multiplied by {stretch:g} or more; "
                f"the platform then reaches {platform}."
            )
        return (
            f"{text} Feasible up to {100 * self.time_scale:.0f} % of the speed of this study, at "
            f"which the platform reaches {platform}."
        )

    def data(self) -> dict[str, Any]:
        """Return all numbers, for JSON."""
        return dict(vars(self))


class _Stop(NamedTuple):
    """What stops a path first: the largest time scale that is feasible, and the reason."""

    scale: float
    reason: str


def path_feasibility(cases: Sequence[Case]) -> list[PathFeasibility]:
    """Judge the first paths of a study, grouped by robot and kind of path.

    Args:
        cases: Cases of the study; on a driver that replays, and for robots of fewer than three
            cables, nothing is judged.

    Raises:
        InvalidField: A robot that can rest neither at home nor where any of its paths begins.
    """
    groups: dict[tuple[str, str], dict[int, Case]] = {}
    for case in cases:
        if not replays(plugins.load("drivers", str(case.settings.get("driver", "simulator")))):
            groups.setdefault((case.robot, case.trajectory), {})[case.seed] = case
    judged = []
    starts: dict[str, list[Array]] = {}
    for (name, kind), by_seed in groups.items():
        robot = robot_of(name, digest_of(next(iter(by_seed.values()))))
        paths = []
        for case in list(by_seed.values())[:PATHS_MAX]:
            try:
                paths.append(path_of(case, robot))
            except CarosacError:  # the case fails with this error as its reason
                continue
        starts.setdefault(name, []).extend(path.sample([0.0]).position for path in paths)
        if robot.n >= CABLES_MIN and paths:
            judged.append(_judge(name, kind, robot, paths))
    for name, places in starts.items():
        if places:
            _check_rest(name, robot_of(name, robot_digest(name)), np.concatenate(places))
    return judged


def _check_rest(name: str, robot: Robot, starts: Array) -> None:
    """Refuse a robot that can rest neither at home nor at any of the starts (K, 3).

    Raises:
        InvalidField: It cannot; says why.
    """
    places = np.concatenate([robot.home_position[None], starts])
    rest = statics.inverse_kinematics(robot, places)
    if not rest.converged.any():
        x, y, z = robot.home_position
        allowed = (
            f"a robot that can rest at home, ({x:g}, {y:g}, {z:g}) m, or where a path begins: "
            f"{statics.STATUS_REASONS[rest.status[0]]}; carosac check {name} says more"
        )
        raise InvalidField("robot", repr(robot.name), allowed)


def _judge(name: str, kind: str, robot: Robot, paths: list[Trajectory]) -> PathFeasibility:
    """Judge the paths of one kind."""
    different = {(path.curve.derivatives(np.zeros(1)).tobytes(), path.duration): path
                 for path in paths}  # fmt: skip
    stops = [stop for path in different.values() if (stop := slowest_stop(robot, path)).scale < 1.0]
    worst = min(stops, key=lambda stop: stop.scale, default=_Stop(1.0, ""))
    return PathFeasibility(
        robot=name, robot_name=robot.name, trajectory=kind, paths=len(different),
        infeasible=len(stops), reason=worst.reason,
        time_scale=worst.scale if worst.scale > 0.0 else None,
        speed=max(path.peak_speed for path in different.values()),
        acceleration=max(path.peak_acceleration for path in different.values()),
    )  # fmt: skip


def slowest_stop(robot: Robot, path: Trajectory) -> _Stop:
    """Return what limits a path most, and how much faster or slower it may be run at most."""
    time = np.union1d(np.linspace(0.0, path.duration, PATH_SAMPLES), path.peak_times)
    return min(
        (*_winch_stops(robot, path, time), _tension_stop(robot, path, time)),
        key=lambda stop: stop.scale,
    )


def _winch_stops(robot: Robot, path: Trajectory, time: Array) -> list[_Stop]:
    """Compare speed and acceleration of the lengths with what the winches can do."""
    step = path.duration / (PATH_SAMPLES - 1) * 1e-2
    before, now, after = (
        straight_length(robot, path.sample(time + shift).position).length
        for shift in (-step, 0.0, step)
    )
    stops = []
    for what, unit, rate, limit, power in (
        ("wind at", "m/s", (after - before) / (2.0 * step), robot.speed_max, 1.0),
        ("accelerate by", "m/s^2", (after - 2.0 * now + before) / step**2,
         robot.acceleration_max, 0.5),
    ):  # fmt: skip
        ratio = np.abs(rate) / (limit * (1.0 + WINCH_TOLERANCE_RATIO))
        k, i = (int(x) for x in np.unravel_index(np.argmax(ratio), ratio.shape))
        scale = float(ratio[k, i] ** -power) if ratio[k, i] > 0.0 else np.inf
        reason = (
            f"the winch of cable {robot.cable_names[i]} would have to {what} "
            f"{plain(abs(rate[k, i]), 3)} {unit}, its limit is {limit[i]:g} {unit}, "
            f"{_place(path, time[k])}"
        )
        stops.append(_Stop(scale, reason))
    return stops


def _tension_stop(robot: Robot, path: Trajectory, time: Array) -> _Stop:
    """Find the largest time scale at which tensions within their limits follow the path."""
    samples = path.sample(time)
    matrix, still, moving = _loads(robot, samples.position, samples.acceleration)
    usual = MARGIN_TOLERANCE_RATIO * Scales(robot).tension
    full = _margins(robot, matrix, still + moving)
    rows = np.flatnonzero(full.margin < -usual)
    if not len(rows):
        return _Stop(np.inf, "")
    low, high = np.zeros(len(rows)), np.ones(len(rows))  # of the square of the time scale
    rest = _margins(robot, matrix[rows], still[rows]).margin
    held = statics.inverse_kinematics(robot, samples.position[rows]).converged
    tolerance: Array = usual + np.where(
        held, np.maximum(0.0, -np.nan_to_num(rest, neginf=0.0)), 0.0
    )
    worse = full.margin[rows] < -tolerance  # than what straight cables are wrong by at rest
    if not worse.any():
        return _Stop(np.inf, "")
    rows, low, high, rest = rows[worse], low[worse], high[worse], rest[worse]
    tolerance = tolerance[worse]
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        part = _margins(robot, matrix[rows], still[rows] + middle[:, None] * moving[rows])
        holds = part.margin >= -tolerance
        low, high = np.where(holds, middle, low), np.where(holds, high, middle)
    square = np.where(rest < -tolerance, 0.0, low)
    first = np.flatnonzero(square == square.min())  # several cannot be held at rest: the worst
    k = int(rows[first[np.argmin(full.margin[rows[first]])]])
    return _Stop(
        float(np.sqrt(square.min())), f"{_broken(robot, full, k)}, {_place(path, time[k])}"
    )


def _loads(robot: Robot, position: Array, acceleration: Array) -> tuple[Array, Array, Array]:
    """Return structure matrix (B, 6, n), wrench at rest, and that of the acceleration (B, 6)."""
    cables = straight_length(robot, position).length * robot.weight_per_length  # (B, n) [N]
    hanging = np.zeros((*cables.shape, 3))
    hanging[..., 2] = -0.5 * cables
    arms = robot.anchor_points @ robot.home_rotation.T
    lever = robot.home_rotation @ robot.center_of_mass
    weight = np.tile([0.0, 0.0, -robot.weight], (len(position), 1))
    inertia = -robot.mass * acceleration
    matrix = structure_matrix(robot, position)
    still = np.concatenate(
        [
            weight + hanging.sum(axis=1),
            np.cross(lever, weight) + np.cross(arms, hanging).sum(axis=1),
        ],
        axis=1,
    )
    moving = np.concatenate([inertia, np.cross(lever, inertia)], axis=1)
    if robot.n < 6:  # the platform turns until moments balance
        matrix = np.concatenate([matrix[:, :3], np.zeros_like(matrix[:, 3:])], axis=1)
        still, moving = (np.pad(load[:, :3], ((0, 0), (0, 3))) for load in (still, moving))
    return matrix, still, moving


def _margins(robot: Robot, matrix: Array, wrench: Array) -> tension_margin.TensionMargin:
    """Return the largest margins of tensions to their limits."""
    arm = float(np.linalg.norm(robot.anchor_points, axis=1).max()) or 1.0
    return tension_margin.solve(matrix, wrench, robot.tension_min, robot.tension_max, arm=arm)


def _broken(robot: Robot, margin: tension_margin.TensionMargin, k: int) -> str:
    """Name the limit that counts most, and the tension that would be needed there."""
    if np.isneginf(margin.margin[k]):
        return "no tensions of any size balance weight and acceleration"
    strongest = int(np.argmax(np.concatenate([margin.low[k], margin.high[k]])))
    i, over = strongest % robot.n, strongest >= robot.n
    name, by = robot.cable_names[i], -float(margin.margin[k])
    if over:
        return (
            f"cable {name} would need {plain(robot.tension_max[i] + by, 3)} N, over its "
            f"tension_max of {robot.tension_max[i]:g} N"
        )
    needed = float(robot.tension_min[i]) - by
    what = f"have only {plain(needed, 3)} N" if needed >= 0.0 else "have to push"
    return f"cable {name} would {what}, its tension_min is {robot.tension_min[i]:g} N"


def _place(path: Trajectory, time: float) -> str:
    """Say where and when."""
    x, y, z = path.sample(np.array([time])).position[0]
    return f"at ({plain(x, 3)}, {plain(y, 3)}, {plain(z, 3)}) m after {plain(time, 3)} s"


def infeasible(judged: Sequence[PathFeasibility]) -> list[PathFeasibility]:
    """Return the kinds of path that are not feasible."""
    return [one for one in judged if one.infeasible]
