"""Cables whose exit or anchor points seem to be swapped."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from carosac_toolkit.inspection.home import HOME_TILT_MAX_DEG, RobotAtHome
from carosac_toolkit.robot.robot import Robot

TURN_TOLERANCE_DEG = 5.0  # [deg]: by symmetry, several pairs turn the platform equally far
PAIRS_SHOWN = 3


def swapped(report: RobotAtHome) -> Iterator[str]:
    """Name two cables that hold the platform at home once their ends are exchanged.

    Of several such pairs those count that turn the platform least from its nominal rotation. None
    counts that tilts it by more than `HOME_TILT_MAX_DEG`: an exchange can also hold the platform of
    a correctly wired robot upside down.

    Args:
        report: A robot that cannot stay at home.
    """
    robot = report.robot
    turns = {
        pair: turn
        for pair in combinations(range(robot.n), 2)
        if (turn := _turn(_exchanged(robot, *pair))) is not None
    }
    least = min(turns.values(), default=0.0)
    likely = [pair for pair, turn in turns.items() if turn <= least + TURN_TOLERANCE_DEG]
    if likely:
        shown = likely[:PAIRS_SHOWN]
        names = [f"{robot.cable_names[i]} and {robot.cable_names[j]}" for i, j in shown]
        yield (
            "are the exit points, or the anchor points, of two cables swapped? With those of "
            f"{', or of '.join(names)} exchanged, the platform rests stably at home, its cables "
            "clear of each other"
        )


def _exchanged(robot: Robot, i: int, j: int) -> Robot:
    """Return the robot with the anchor points of two cables exchanged."""
    order = list(range(robot.n))
    order[i], order[j] = j, i
    return replace(robot, anchor_points=robot.anchor_points[order])


def _turn(robot: Robot) -> float | None:
    """Return how far the platform turns at home [deg]; None where it cannot stay there upright."""
    from carosac_toolkit.physics.rest import distance, statics

    home = statics.inverse_kinematics(robot, robot.home_position[None])
    if not home.converged[0] or not home.stable[0]:
        return None
    apart, _ = distance.cable_distances(robot, home)
    rotation = robot.home_rotation.T @ home.rotation[0]
    if (apart < 0.0).any() or _angle(rotation[2, 2]) > HOME_TILT_MAX_DEG:
        return None
    return _angle(0.5 * (np.trace(rotation) - 1.0))


def _angle(cosine: float) -> float:
    """Return the angle of a cosine [deg]."""
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
