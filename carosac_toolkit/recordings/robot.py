"""Robot of a recording: the one that it names, or the one with its exit points."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.bundled_names import list_robots
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.robot.robot import Robot

EXIT_MATCH_MAX_M = 0.01  # [m]: exit points nearer than this are those of the robot


@dataclass(frozen=True, kw_only=True)
class FoundRobot:
    """A robot and how it was found.

    Attributes:
        robot: The robot.
        name: Its bundled name, or the path of its file.
        source: ``asked``, ``recording`` (it names the robot) or ``exit points`` (a guess).
        others: Bundled robots with the same exit points, where it is a guess.
    """

    robot: Robot
    name: str
    source: str
    others: tuple[str, ...] = ()


def find_robot(recording: Recording, path: Path, asked: str | None = None) -> FoundRobot:
    """Find the robot of a recording.

    Args:
        recording: The recording.
        path: Its file: a path that its metadata name is looked for in that folder first, then
            in the current one.
        asked: Bundled name or path that overrides that of the recording.

    Raises:
        CarosacError: None is known, or its file is missing or faulty.
    """
    if asked is not None:
        return FoundRobot(robot=load_robot(asked), name=asked, source="asked")
    named = recording.metadata.robot
    if named:
        return _named(named, path)
    near = _nearest(recording)
    if near:
        robot, *others = near
        names = tuple(other.name for other in others)
        return FoundRobot(robot=robot, name=robot.name, source="exit points", others=names)
    allowed = f"the recording names no robot; choose one of {list(list_robots())} or a YAML file"
    raise InvalidField("--robot", "nothing", allowed)


def _named(name: str, path: Path) -> FoundRobot:
    """Load the robot that a recording names."""
    beside = path.parent / name
    named = str(beside) if name not in list_robots() and beside.is_file() else name
    try:
        return FoundRobot(robot=load_robot(named), name=named, source="recording")
    except CarosacError as error:
        raise CarosacError(
            f"{error}\n  (the recording {str(path)!r} names {name!r} as its robot; a path is "
            "looked for in its folder, then in the current one; --robot names another)"
        ) from error


def _nearest(recording: Recording) -> list[Robot]:
    """List bundled robots by distance to the exit points measured in a run, nearest first."""
    points = recording.exit_points
    if points is None:
        return []
    robots = [load_robot(name) for name in list_robots()]
    away = {
        robot.name: float(np.linalg.norm(points - robot.exit_points, axis=1).max())
        for robot in robots
        if robot.exit_points.shape == points.shape
    }
    near = [robot for robot in robots if away.get(robot.name, np.inf) < EXIT_MATCH_MAX_M]
    return sorted(near, key=lambda robot: away[robot.name])
