"""Second search where the first one found no rest, or barely one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.physics.rest.hold import WidestRest
from carosac_toolkit.physics.rest.statics import Equilibrium, inverse_kinematics
from carosac_toolkit.robot.robot import Robot

NEAR_MARGIN_RATIO = (
    0.05  # of the weight: a margin not more negative than this may be one of a poor search
)


def second_search(robot: Robot, found: WidestRest, asked: NDArray[np.bool_]) -> WidestRest:
    """Ask `statics.inverse_kinematics`, which searches in another way, for a free rotation.

    Args:
        robot: Robot description, n < 6.
        found: Rests of the largest margin, under the weight alone.
        asked: Rows that may be asked for, shape (B,).

    Returns:
        The same; where the first search did not converge, missed by little or found an unstable
        rest, and the other one found a stable rest within the limits, that rest, with its own
        margin.
    """
    near = (found.margin < 0.0) & (found.margin > -NEAR_MARGIN_RATIO * robot.weight)
    shaky = found.rest.converged & ~found.rest.stable
    doubtful = np.isnan(found.margin) | near | shaky
    rows = np.flatnonzero(doubtful & asked)
    if len(rows) == 0:
        return found
    other = inverse_kinematics(robot, found.rest.position[rows])
    kept = np.flatnonzero(other.converged & other.stable)
    rows = rows[kept]
    above = other.tension[kept] - robot.tension_min
    below = robot.tension_max - other.tension[kept]
    nearest = np.minimum(above, below).min(axis=1)
    values = {
        "margin": np.maximum(nearest, 0.0),  # a limit that binds is met to rounding
        "gap": np.full(len(rows), np.nan),
        "low": (above == nearest[:, None]).astype(float),
        "high": (below == nearest[:, None]).astype(float),
        "lowest": np.broadcast_to(robot.tension_min, above.shape),
        "solved": np.ones(len(rows), dtype=bool),
    }
    changed = {}
    for name, value in values.items():
        changed[name] = getattr(found, name).copy()
        changed[name][rows] = value
    rest = {name: value.copy() for name, value in vars(found.rest).items()}
    for name, array in rest.items():
        array[rows] = getattr(other, name)[kept]
    return replace(found, rest=Equilibrium(**rest), **changed)
