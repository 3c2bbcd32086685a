"""How far sag turns pulleys beyond what straight cables would: not at all about upright axes."""

from __future__ import annotations

import numpy as np

from baselines.dynamic_estimator.settings import DynamicEstimatorSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import wrapped_angle
from carosac_toolkit.physics.cable.swivel import straight_swivel_angle, swivel_angle
from carosac_toolkit.robot.robot import Robot


def swivel_sag(
    settings: DynamicEstimatorSettings,
    robot: Robot,
    position: Array,
    rotation: Array,
    exit_tension: Array,
) -> Array:
    """Return how far sag turns each pulley [rad], shape (n,), or (0,) if that is not used.

    Args:
        settings: Say whether it is.
        robot: n cables.
        position: Platform origin in W [m], shape (3,).
        rotation: From P to W, shape (3, 3).
        exit_tension: Tension vectors at the exits there [N], shape (n, 3).
    """
    if not settings.swivels:
        return np.zeros(0)
    hanging = swivel_angle(robot, -exit_tension[None])
    straight = straight_swivel_angle(robot, position[None], rotation[None])
    return np.asarray(wrapped_angle(hanging - straight)[0])
