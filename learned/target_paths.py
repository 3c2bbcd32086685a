"""Paths that targets of an episode follow, drawn in the workspace of a robot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.numbers import check_positive, check_whole
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.trajectories import Trajectory, random_minimum_snap, random_spline

PATH_ATTEMPTS_MAX = 100  # to draw a feasible path
COARSE_STRIDE = 40  # points of a path: the first of so many is looked at before all are
SCATTER_KIND = "scatter"
PATH_LOOKAHEAD_S = 1.0  # of a path that are known beyond the end of an episode, as when driving

Feasible = Callable[[Array], NDArray[np.bool_]]


@dataclass(frozen=True, kw_only=True)
class PathSettings:
    """Settings of the motion of targets in an episode.

    Attributes:
        kind: ``spline``: a cubic spline through six random points of the box; ``minimum_snap``:
            the smoothest curve through them, from rest to rest; ``scatter``: no curve, but points
            anywhere in the box, denser towards its faces, as Chebyshev nodes are.
        speed: Least and largest peak speed that is drawn [m/s].
        acceleration_max: [m/s^2].
        steps: Of an episode.
        period: Time between two targets [s]; None spreads the steps over the whole path, as
            set-points.
        pool: How many different paths there are; each episode follows one of them.
    """

    kind: Literal["spline", "minimum_snap", "scatter"] = "spline"
    speed: tuple[float, float] = (0.5, 5.0)
    acceleration_max: float = 20.0
    steps: int = 200
    period: float | None = None
    pool: int = 1000

    def __post_init__(self) -> None:
        """Refuse numbers that make no sense."""
        if self.kind not in (*_DRAWS, SCATTER_KIND):
            raise InvalidField("kind", repr(self.kind), f"one of {sorted((*_DRAWS, SCATTER_KIND))}")
        if self.kind == SCATTER_KIND and self.period is not None:
            raise InvalidField("kind", repr(self.kind), "a curve, where there is a period")
        if not 0.0 < self.speed[0] <= self.speed[1] < np.inf:
            raise InvalidField("speed", f"{self.speed} m/s", "0 < least <= largest, finite")
        check_positive("acceleration_max", self.acceleration_max, "m/s^2")
        for name in ("steps", "pool"):
            check_whole(name, getattr(self, name), 1)
        if self.period is not None:
            check_positive("period", self.period, "s")


@dataclass(frozen=True, kw_only=True, eq=False)
class TargetPath:
    """Targets of one episode: the first is where it starts.

    Attributes:
        position: In W [m], shape (steps + 1, 3).
        velocity: [m/s], shape (steps + 1, 3); zero for set-points.
        acceleration: [m/s^2], shape (steps + 1, 3); zero for set-points.
        later: Position, velocity and acceleration after that, of a path that goes on beyond the
            episode, shape (K, 3, 3); after the last of them it rests. None: it rests at once.
    """

    position: Array
    velocity: Array
    acceleration: Array
    later: Array | None = None

    def targets(self) -> Array:
        """Return position, velocity and acceleration in turn, shape (N, 3, 3).

        In the last row it rests where it ends, as it does from there on.
        """
        known = np.stack([self.position, self.velocity, self.acceleration], axis=1)
        parts = [known] if self.later is None else [known, self.later]
        end = np.zeros((1, 3, 3))
        end[0, 0] = parts[-1][-1, 0]
        return np.concatenate([*parts, end])


class PathPool:
    """The paths that the episodes of an environment follow, each drawn when it is needed first.

    Attributes:
        watch: Called with the number of paths after each that is drawn; None: nothing is.
    """

    def __init__(
        self, robot: Robot, settings: PathSettings, seed: int, feasible: Feasible | None = None
    ) -> None:
        """Draw nothing yet; arguments as in `draw_path`, with the seed of all paths."""
        self._arguments = (robot, settings)
        self._seed = seed
        self._feasible = feasible
        self._paths: dict[int, TargetPath] = {}
        self.watch: Callable[[int], None] | None = None

    def path(self, index: int) -> TargetPath:
        """Return a path by its number, always the same one."""
        if index not in self._paths:
            rng = np.random.default_rng([self._seed, 7, index])
            self._paths[index] = draw_path(*self._arguments, rng, self._feasible)
            if self.watch is not None:
                self.watch(len(self._paths))
        return self._paths[index]


def draw_path(
    robot: Robot, settings: PathSettings, rng: np.random.Generator, feasible: Feasible | None = None
) -> TargetPath:
    """Draw until all targets are feasible.

    Args:
        robot: Whose workspace it is.
        settings: What to draw.
        rng: Source of randomness.
        feasible: Says of positions (K, 3) which can be reached; None: all of them.

    Raises:
        CarosacError: No feasible path was found in 100 attempts.
    """
    if settings.kind == SCATTER_KIND:
        return _scattered(robot, settings, rng, feasible)
    for _ in range(PATH_ATTEMPTS_MAX):
        try:
            path = sampled(_draw(robot, settings, rng), settings)
        except InvalidField:  # a curve that leaves the box however its points are drawn together
            continue
        if feasible is None or _all(feasible, path.position):
            return path
    raise CarosacError(
        f"{robot.name}: none of {PATH_ATTEMPTS_MAX} random paths in its workspace box is feasible; "
        "`carosac check` shows why"
    )


def _all(feasible: Feasible, position: Array) -> bool:
    """Return whether all of a path is feasible; few points show most that are not."""
    return bool(feasible(position[::COARSE_STRIDE]).all() and feasible(position).all())


def _scattered(
    robot: Robot, settings: PathSettings, rng: np.random.Generator, feasible: Feasible | None
) -> TargetPath:
    """Draw feasible points with the density of Chebyshev nodes along each axis."""
    center = (robot.workspace_max + robot.workspace_min) / 2
    half = (robot.workspace_max - robot.workspace_min) / 2
    count = settings.steps + 1
    points_kept = np.zeros((0, 3))
    for _ in range(PATH_ATTEMPTS_MAX):
        points = center + half * np.cos(np.pi * rng.uniform(size=(count, 3)))
        good = points if feasible is None else points[feasible(points)]
        points_kept = np.concatenate([points_kept, good])
        if len(points_kept) >= count:
            still = np.zeros((count, 3))
            return TargetPath(position=points_kept[:count], velocity=still, acceleration=still)
    raise CarosacError(
        f"{robot.name}: too few of {PATH_ATTEMPTS_MAX * count} random points in its workspace box "
        "are feasible; `carosac check` shows why"
    )


def sampled(trajectory: Trajectory, settings: PathSettings) -> TargetPath:
    """Sample targets along a trajectory: in even steps from start to end, or one each period."""
    if settings.period is None:
        times = np.linspace(0.0, trajectory.duration, settings.steps + 1)
        position = trajectory.sample(times).position
        still = np.zeros_like(position)
        return TargetPath(position=position, velocity=still, acceleration=still)
    count = settings.steps + 1
    ahead = int(np.ceil(PATH_LOOKAHEAD_S / settings.period))
    reference = trajectory.sample(settings.period * np.arange(count + ahead))
    every = np.stack([reference.position, reference.velocity, reference.acceleration], axis=1)
    position, velocity, acceleration = (every[:count, k] for k in range(3))
    return TargetPath(
        position=position, velocity=velocity, acceleration=acceleration, later=every[count:]
    )


def _draw(robot: Robot, settings: PathSettings, rng: np.random.Generator) -> Trajectory:
    speed = float(rng.uniform(*settings.speed))
    return _DRAWS[settings.kind](
        robot, rng, speed_max=speed, acceleration_max=settings.acceleration_max
    )


_DRAWS: dict[str, Callable[..., Trajectory]] = {
    "spline": random_spline, "minimum_snap": random_minimum_snap
}  # fmt: skip
