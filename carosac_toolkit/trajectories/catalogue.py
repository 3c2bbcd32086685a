"""Trajectories by name, fitted to a robot's workspace box, for studies and the command line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.trajectories.arcs import circle, spiral
from carosac_toolkit.trajectories.draws import draw_points, random_minimum_snap, random_spline
from carosac_toolkit.trajectories.moves import line, waypoints
from carosac_toolkit.trajectories.resting import onto_rest
from carosac_toolkit.trajectories.trajectory import Trajectory

BOX_SHARE = 0.7  # share of the box that circle, spiral and line span
SPEED_MAX, ACCELERATION_MAX = Scaled(1.0, "m/s"), Scaled(1.0, "m/s^2")
FAST_MOVE = "fast_move"
FAST_MOVE_RATIO = 2.0  # of its limits to those of the other paths
WAYPOINT_REST = Scaled(2.0, "s")  # at each of the waypoints


def build(
    name: str,
    robot: Robot,
    seed: int = 0,
    *,
    speed_max: float | None = None,
    acceleration_max: float | None = None,
) -> Trajectory:
    """Build a trajectory of the catalogue inside the workspace box of a robot.

    With two cables it is moved onto positions at which the robot can rest.

    Args:
        name: One of `TRAJECTORY_NAMES`.
        robot: Whose box it is.
        seed: Draws the points of the random ones, the diagonal of the line, the direction of the
            fast move and the start angle of the others.
        speed_max: [m/s]; None: as `default_limits`.
        acceleration_max: [m/s^2]; None: likewise.

    Raises:
        InvalidField: A name that is not in the catalogue.
    """
    if name not in _TRAJECTORY_BUILDERS:
        raise InvalidField("trajectory", repr(name), f"one of {list(TRAJECTORY_NAMES)}")
    rng = np.random.default_rng(seed)
    speed, acceleration = default_limits(robot, name)
    speed = speed if speed_max is None else speed_max
    acceleration = acceleration if acceleration_max is None else acceleration_max
    wanted = _TRAJECTORY_BUILDERS[name](robot, rng, speed, acceleration)
    return onto_rest(robot, wanted).within(robot)


def default_limits(robot: Robot, name: str | None = None) -> tuple[float, float]:
    """Return speed [m/s] and acceleration [m/s^2] of a path that is not asked to be faster.

    On the robot ``carosac`` they are 1 m/s and 1 m/s^2, and twice as much for the path
    ``fast_move``; other robots take them by their size.

    Args:
        robot: Robot that follows the path.
        name: Name of the path; None: any but the fast move.
    """
    ratios = Scales(robot).ratios
    ratio = FAST_MOVE_RATIO if name == FAST_MOVE else 1.0
    return ratio * SPEED_MAX.of(ratios), ratio * ACCELERATION_MAX.of(ratios)


def _box(robot: Robot) -> tuple[Array, Array]:
    """Return the middle and half the edges of the box [m]."""
    low, high = robot.workspace_min, robot.workspace_max
    return (low + high) / 2, (high - low) / 2


def _minimum_snap(robot: Robot, rng: np.random.Generator, v: float, a: float) -> Trajectory:
    return random_minimum_snap(robot, rng, speed_max=v, acceleration_max=a)


def _cubic_spline(robot: Robot, rng: np.random.Generator, v: float, a: float) -> Trajectory:
    return random_spline(robot, rng, speed_max=v, acceleration_max=a)


def _waypoints(robot: Robot, rng: np.random.Generator, v: float, a: float) -> Trajectory:
    rest = WAYPOINT_REST.of(Scales(robot).ratios)
    return waypoints(draw_points(robot, rng, count=6), rest=rest, speed_max=v, acceleration_max=a)


def _line(robot: Robot, rng: np.random.Generator, v: float, a: float) -> Trajectory:
    middle, half = _box(robot)
    reach = BOX_SHARE * half * rng.choice([-1.0, 1.0], size=3)
    return line(middle - reach, middle + reach, speed_max=v, acceleration_max=a)


def _fast_move(robot: Robot, rng: np.random.Generator, v: float, a: float) -> Trajectory:
    """Cross half of the box on the level, along the shorter side of the frame, to either side."""
    middle, half = _box(robot)
    reach = np.zeros(3)
    across = int(np.ptp(robot.exit_points[:, :2], axis=0).argmin())
    reach[across] = half[across] / 2 * rng.choice([-1.0, 1.0])
    move = line(middle - reach, middle + reach, speed_max=v, acceleration_max=a)
    return replace(move, name=FAST_MOVE)


def _circle(robot: Robot, rng: np.random.Generator, v: float, a: float) -> Trajectory:
    middle, half = _box(robot)
    angle = float(rng.uniform(0.0, 2 * np.pi))
    radius = BOX_SHARE * float(half[:2].min())
    return circle(middle, radius, turns=2.0, start_angle=angle, speed_max=v, acceleration_max=a)


def _spiral(robot: Robot, rng: np.random.Generator, v: float, a: float) -> Trajectory:
    middle, half = _box(robot)
    angle = float(rng.uniform(0.0, 2 * np.pi))
    radius = BOX_SHARE * float(half[:2].min())
    bottom = middle - [0.0, 0.0, BOX_SHARE * half[2]]
    return spiral(
        bottom, radius, radius / 2, 2 * BOX_SHARE * float(half[2]),
        turns=3.0, start_angle=angle, speed_max=v, acceleration_max=a,
    )  # fmt: skip


_TRAJECTORY_BUILDERS: dict[
    str, Callable[[Robot, np.random.Generator, float, float], Trajectory]
] = {
    "minimum_snap": _minimum_snap,
    "cubic_spline": _cubic_spline,
    "waypoints": _waypoints,
    "line": _line,
    "fast_move": _fast_move,
    "circle": _circle,
    "spiral": _spiral,
}
TRAJECTORY_NAMES = tuple(_TRAJECTORY_BUILDERS)
