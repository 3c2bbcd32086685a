"""Poses of rest on recorded lengths, and how far off they may be by what is to be identified."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.identification.unknowns import Coordinates
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.values import Pose
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
    position, rotation = rests_on(robot, calibrated(recording, robot).unstrained_length[rows])
    guess = Pose(
        position=np.where(np.isnan(position), robot.home_position, position), rotation=rotation
    )
    slopes = []
    for step in steps:
        other = unknowns.robot_at(np.maximum(step, unknowns.lower))
        lengths = calibrated(recording, other).unstrained_length[rows]
        there, turned = rests_on(other, lengths, guess)
        back = turn_between(other, robot)
        moved = there @ back.T - position
        turn = Rotation.from_matrix(rotation.swapaxes(1, 2) @ back @ turned)
        slope = np.hstack([moved, turn.as_rotvec()]) / DOUBT_STEP
        slopes.append(np.where(np.isnan(moved).any(axis=1, keepdims=True), 0.0, slope))
    return np.stack(slopes, axis=2)


def rests_on(robot: Robot, lengths: Array, guess: Pose | None = None) -> tuple[Array, Array]:
    """Return poses of rest on lengths, (K, 3) and (K, 3, 3); positions are NaN where is none.

    Args:
        robot: Robot description.
        lengths: Unstrained [m], shape (K, n).
        guess: Poses nearby; None: none are known.
    """
    position = np.full((len(lengths), 3), np.nan)
    rotation = np.tile(np.eye(3), (len(lengths), 1, 1))
    if (lengths > 0.0).all():
        rest = statics.forward_kinematics(robot, lengths, guess=guess)
        good = rest.converged
        position[good], rotation[good] = rest.position[good], rest.rotation[good]
    return position, rotation
