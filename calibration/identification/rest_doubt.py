"""How far a platform may rest from where the robot file hangs it, by what is to be identified."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.identification.unknowns import Coordinates
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.recordings.encoders import calibrated
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.parameters import turn_between
from carosac_toolkit.robot.robot import Robot

DOUBT_STEP = 0.1  # of the coordinates, for differences: a soft platform moves far by one sigma


def rest_doubt(recording: Recording, unknowns: Coordinates, rows: NDArray[np.intp]) -> Array:
    """Return by how much poses of rest may be off, by what is known before of the robot.

    Args:
        recording: As recorded.
        unknowns: k coordinates of the robot, with their prior.
        rows: Length samples, shape (K,).

    Returns:
        Changes of poses in the frame that they are measured in, [m] and [rad] in the axes of the
        platform, by one sigma of k independent unknowns, shape (K, 6, k); 0 by what leaves a robot
        that cannot rest on the lengths.
    """
    steps = DOUBT_STEP * np.linalg.cholesky(unknowns.prior.covariance).T
    robot = unknowns.robot
    position, rotation = _rests(recording, robot, robot, rows)
    slopes = []
    for step in steps:
        other = unknowns.robot_at(np.maximum(step, unknowns.lower))
        moved, turned = _rests(recording, other, robot, rows)
        turn = Rotation.from_matrix(rotation.swapaxes(1, 2) @ turned).as_rotvec()
        slopes.append(np.hstack([moved - position, turn]) / DOUBT_STEP)
    return np.nan_to_num(np.stack(slopes, axis=2))


def _rests(
    recording: Recording, robot: Robot, seen_by: Robot, rows: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Return poses of rest in W of another robot's poses; positions NaN where there are none."""
    length = calibrated(recording, robot).unstrained_length[rows]
    back = turn_between(robot, seen_by)
    position, rotation = rests_on(robot, length)
    return position @ back.T, back @ rotation


def rests_on(robot: Robot, lengths: Array) -> tuple[Array, Array]:
    """Return poses of rest on lengths (K, n), (K, 3) and (K, 3, 3); NaN and 1 where there is none.

    Args:
        robot: Robot description.
        lengths: Unstrained [m].
    """
    position, rotation = (
        np.full((len(lengths), 3), np.nan),
        np.tile(np.eye(3), (len(lengths), 1, 1)),
    )
    if (lengths > 0.0).all():
        rest = statics.forward_kinematics(robot, lengths)
        good = rest.converged
        position[good], rotation[good] = rest.position[good], rest.rotation[good]
    return position, rotation
