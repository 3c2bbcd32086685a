"""Forces on a point-like platform, and the tensions that are used on purpose."""

from __future__ import annotations

import numpy as np

from calibration.self_calibration.problem import MotorAngleProblem
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.rest import tension_distribution
from carosac_toolkit.robot.robot import Robot

HOLD_WEIGHTS = 0.5  # of the weight: tension above its lower limit that keeps a cable taut
CEILING_WEIGHTS = 5.0  # of the weight: tension above its lower limit beyond which stretch is large
RESERVE_SHARE = 0.25  # of the range of tensions: kept between those used on purpose and the limit


def operating_tensions(robot: Robot) -> tuple[Array, Array]:
    """Return the lowest and highest tensions that are used on purpose [N], each shape (n,).

    Raises:
        InvalidField: The tension limits leave nothing between them.
    """
    low = robot.tension_min + HOLD_WEIGHTS * robot.weight
    most = robot.tension_max - RESERVE_SHARE * (robot.tension_max - robot.tension_min)
    high = np.minimum(most, robot.tension_min + CEILING_WEIGHTS * robot.weight)
    if (low >= high).any():
        i = int(np.argmax(low - high))
        allowed = f"> {low[i] + RESERVE_SHARE * (robot.tension_max - robot.tension_min)[i]:.3g} N"
        raise InvalidField(f"tension_limits.max[{i}]", f"{robot.tension_max[i]:g} N", allowed)
    return low, high


def force_balance(
    problem: MotorAngleProblem, shared: Array, position: Array
) -> tuple[Array, Array]:
    """Return structure matrices (C, 6, n) and weights (C, 6) of a point-like platform.

    Moments are left out: they are zero, as all cables of a point-like platform meet.
    """
    _, direction = problem.straight(shared, position)
    force = -direction.swapaxes(1, 2)
    matrix = np.concatenate([force, np.zeros_like(force)], axis=1)
    weight = np.zeros((len(position), 6))
    weight[:, 2] = -problem.robot.weight
    return matrix, weight


def expected_tension(problem: MotorAngleProblem, shared: Array, position: Array) -> Array:
    """Return the least tensions used on purpose that balance the weight [N], shape (C, n).

    Where there are none, the nearest ones that were found.

    Args:
        problem: Of a point-like platform.
        shared: Shape (m,).
        position: Platform origin in W [m], shape (C, 3).
    """
    matrix, weight = force_balance(problem, shared, position)
    low, high = operating_tensions(problem.robot)
    return tension_distribution.solve(matrix, weight, low, high, arm=1.0).tension
