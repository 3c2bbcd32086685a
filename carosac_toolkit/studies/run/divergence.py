"""Divergence: a robot no longer held, or no longer known, so that its errors are no score.

All sizes come from the robot: its mean cable length, the weight per cable, its slowest sway.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.numbers import plain
from carosac_toolkit.loop.loop import Log
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.modes import natural_frequencies
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.studies.run.limit_scores import outside

DIVERGED = "diverged"  # key of the reason among the values that a case function returns
BOX_MARGIN_RATIO = 0.1  # of the mean cable length: sway and overshoot stay within it
LOST_RATIO = 0.1  # of the mean cable length: of an estimate or a reference that is farther off
LOOSE_RATIO = 0.02  # of the weight per cable: a cable with less does not hold the platform
LOOSE_CABLE_RATIO = 0.1  # of a cable's own weight, with which it pulls even where it hangs loose
PIECE_RATIO = 0.5  # of the period of the slowest sway: a state that lasts longer is no swing


def divergence(log: Log, robot: Robot, *, replayed: bool = False) -> str | None:
    """Return why a run diverged, or None if it did not.

    Args:
        log: Log of the run.
        robot: The nominal robot, n cables.
        replayed: True if the driver played a recording, on which nothing can diverge.

    Returns:
        One sentence without a full stop: the platform left the workspace box by more than a tenth
        of the mean cable length; or, for over half a period of the slowest sway in one piece, more
        cables hung loose than the robot can spare, or the estimate or the reference was off by
        more than a tenth of the mean cable length.
    """
    if replayed or log.position is None:
        return None
    return next(_reasons(log, log.position, robot), None)


def _reasons(log: Log, position: Array, robot: Robot) -> Iterator[str]:
    """Yield the reasons; the first in time is not known, the most telling one comes first."""
    size, piece = Scales(robot).length, PIECE_RATIO * sway_period(robot)
    beyond = outside(robot, position).max(axis=1)  # (T,) of the worst world
    margin = BOX_MARGIN_RATIO * size
    if (beyond > margin).any():
        k = int(np.argmax(beyond > margin))
        yield (
            f"the platform left the workspace box by up to {plain(beyond.max(), 3)} m, over "
            f"{plain(margin, 3)} m from {plain(log.time[k], 3)} s on"
        )
    if log.tension is not None:
        loose = log.tension < loose_tension(robot)  # (T, B, n)
        unheld = (loose.sum(axis=2) > max(0, robot.n - 6)).any(axis=1)
        lasted, first = _longest(log.time, unheld)
        if lasted > piece:
            worst = int(np.argmax(loose[first].sum(axis=0)))
            yield (
                f"{_cables(robot, worst, loose[first].any(axis=0))} loose for {plain(lasted, 3)} s "
                f"from {plain(log.time[first], 3)} s on, over half a period of the slowest sway "
                f"({plain(2.0 * piece, 3)} s)"
            )
    for what, other in (
        ("the estimator was lost: its position was off", log.belief_position),
        ("the platform no longer followed: it was off its reference", log.reference),
    ):
        error = np.linalg.norm(other - position, axis=2).max(axis=1)
        lasted, first = _longest(log.time, error > LOST_RATIO * size)
        if lasted > piece:
            yield (
                f"{what} by over {plain(LOST_RATIO * size, 3)} m for {plain(lasted, 3)} s from "
                f"{plain(log.time[first], 3)} s on, up to {plain(error.max(), 3)} m"
            )


def _cables(robot: Robot, worst: int, loose: NDArray[np.bool_]) -> str:
    """Name the cables that hung loose."""
    names = [robot.cable_names[i] for i in np.flatnonzero(loose)] or [robot.cable_names[worst]]
    return f"cable {names[0]} hung" if len(names) == 1 else f"cables {', '.join(names)} hung"


def loose_tension(robot: Robot) -> Array:
    """Return the tensions below which cables hang loose [N], shape (n,): never over the limit."""
    scales = Scales(robot)
    own = LOOSE_CABLE_RATIO * robot.weight_per_length * scales.length
    return np.minimum(robot.tension_min, np.maximum(LOOSE_RATIO * scales.tension, own))


@lru_cache(maxsize=8)  # a robot is the same object for all cases of a process
def sway_period(robot: Robot) -> float:
    """Return the period of the slowest sway at home [s], no shorter than a fall takes."""
    rest = statics.inverse_kinematics(robot, robot.home_position[None])
    slowest = float(natural_frequencies(robot, rest)[0, 0])
    shortest = Scales(robot).time
    return max(shortest, 1.0 / slowest) if slowest > 0.0 else 2.0 * np.pi * shortest


def _longest(time: Array, state: NDArray[np.bool_]) -> tuple[float, int]:
    """Return the longest time that a state lasted in one piece [s], and its first cycle."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], state, [False]]).astype(int)))
    starts, ends = edges[::2], edges[1::2]
    if not len(starts):
        return 0.0, 0
    period = float(time[1] - time[0]) if len(time) > 1 else 0.0
    lasted = time[ends - 1] - time[starts] + period
    k = int(np.argmax(lasted))
    return float(lasted[k]), int(starts[k])
