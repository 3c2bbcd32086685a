"""Unstrained lengths by which a robot at a known pose is homed."""

from __future__ import annotations

import numpy as np

from carosac_toolkit.base.arrays import Array, frozen_array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.values import State
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.robot.robot import Robot

DEGREES_OF_FREEDOM = 6  # of the platform; fewer cables leave its rotation to gravity


def homing_lengths(robot: Robot, position: State) -> Array:
    """Return the unstrained lengths at a pose of rest [m], shape (n,).

    Args:
        robot: Robot description, n cables.
        position: A batch of one. Its lengths count if it has some; else those of the statics: with
            six cables or more at its rotation, with fewer at that of rest.

    Raises:
        InvalidField: More than one pose, or no equilibrium there.
    """
    if len(position.position) != 1:
        raise InvalidField("position", f"{len(position.position)} poses", "one pose")
    if position.unstrained_length is not None:
        lengths = frozen_array("unstrained_length", position.unstrained_length, (1, robot.n))
        return np.array(lengths[0])
    rotation = position.rotation if robot.n >= DEGREES_OF_FREEDOM else None
    rest = statics.inverse_kinematics(robot, position.position, rotation)
    if not rest.converged[0]:
        where = np.round(position.position[0], 4).tolist()
        raise InvalidField("position", f"{where} m", "a pose at which the platform can rest")
    return np.array(rest.unstrained_length[0])
