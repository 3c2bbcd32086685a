"""Evidence that a recording was made with another robot than the one it is compared with."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from carosac_toolkit.base.numbers import plain
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.recordings.encoders import calibrated
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.bundled_names import list_robots
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.robot.parameters import turn_between
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.validation.plausibility import exit_point_distance

POINT_RATIO_MAX = 0.02  # of the mean cable length: what a calibration may move points by
WEIGHT_RATIO_MAX = 1.2  # of two weights: what a calibration or a plant may differ by


def another_robot(recording: Recording, robot: Robot) -> tuple[str, ...]:
    """Name what shows that a recording is of another robot; empty if nothing does.

    Args:
        recording: The recording, with as many cables as the robot.
        robot: The robot that it is compared with.
    """
    return tuple([*_named(recording, robot), *_measured_points(recording, robot)])


def cable_count_hint(recording: Recording, robot: Robot) -> str:
    """Name the robots that have as many cables as a recording, for a robot that has not."""
    fit = [name for name in list_robots() if load_robot(name).n == recording.n]
    names = recording.metadata.robot
    said = f"; the recording names {names!r}" if names else ""
    return (
        f"this is a recording of another robot than {robot.name!r}{said}; bundled robots with "
        f"{recording.n} cables: {', '.join(fit) or 'none'}"
    )


def _named(recording: Recording, robot: Robot) -> Iterator[str]:
    """Compare with the bundled robot that the recording names; a file may have changed since."""
    name = recording.metadata.robot
    if name not in list_robots():
        return
    different = list(_differences(load_robot(name), robot))
    if different:
        yield (
            f"This is a recording of another robot: it names {name}, and is compared with "
            f"{robot.name}, which differs in {', '.join(different)}."
        )


def _differences(one: Robot, other: Robot) -> Iterator[str]:
    """Tell by what two descriptions differ that no calibration changes by as much.

    Points are compared in the frame of measured poses, which a calibration may find tilted.
    """
    if one.n != other.n:
        yield f"the number of cables ({one.n}, {other.n})"
        return
    for what, points, others in (
        ("exit points", one.exit_points @ turn_between(one, other).T, other.exit_points),
        ("anchor points", one.anchor_points, other.anchor_points),
    ):
        apart = float(np.linalg.norm(points - others, axis=1).max())
        if apart > POINT_RATIO_MAX * Scales(one).length:
            yield f"{what} (up to {plain(apart, 3)} m)"
    if max(one.weight, other.weight) > WEIGHT_RATIO_MAX * min(one.weight, other.weight):
        yield f"weight ({plain(one.weight, 4)} N, {plain(other.weight, 4)} N)"


def _measured_points(recording: Recording, robot: Robot) -> Iterator[str]:
    """Compare the exit points that were measured in the recording."""
    points = recording.exit_points
    if points is None or points.shape != robot.exit_points.shape:
        return
    apart = exit_point_distance(calibrated(recording, robot), robot)
    if apart is not None and apart > POINT_RATIO_MAX * Scales(robot).length:
        yield (
            "This is a recording of another robot: the exit points measured in it lie up to "
            f"{plain(apart, 3)} m from those of {robot.name}."
        )
