"""Readings of calibrated length sensors: reading = scale * wound length + offset.

Inside the toolkit every length is material. Readings live at its edge: a recording holds them as
they were, and whoever plays or scores it converts them by the robot that it is given. The wound
length is the unstrained length, but for the hysteresis of a winch.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import from_matrix, to_matrix
from carosac_toolkit.loop.values import Stamped
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.robot import Robot


def is_calibrated(robot: Robot) -> bool:
    """Return True if the robot knows more of its lengths than that they are what is read."""
    known = robot.length_offset is not None or robot.length_scale is not None
    return known or bool(robot.length_hysteresis.any())


def unstrained_lengths(robot: Robot, reading: Array) -> Array:
    """Return unstrained lengths [m] of readings [m], hysteresis aside; shapes (..., n)."""
    offset = 0.0 if robot.length_offset is None else robot.length_offset
    scale = 1.0 if robot.length_scale is None else robot.length_scale
    return (reading - offset) / scale


def paid_out_lengths(robot: Robot, reading: Array) -> Array:
    """Return unstrained lengths [m] of readings in time [m], shapes (K, n), hysteresis included.

    The first are in the middle of the hysteresis of their winches.
    """
    from carosac_toolkit.physics.motion.winch import lagging_lengths

    wound = unstrained_lengths(robot, reading)
    return lagging_lengths(wound[:, None], robot.length_hysteresis[None])[:, 0]


def readings(robot: Robot, unstrained_length: Array) -> Array:
    """Return readings [m] of unstrained lengths [m], hysteresis aside; shapes (..., n)."""
    offset = 0.0 if robot.length_offset is None else robot.length_offset
    scale = 1.0 if robot.length_scale is None else robot.length_scale
    return scale * unstrained_length + offset


def calibrated(recording: Recording, robot: Robot) -> Recording:
    """Convert a recording of readings to unstrained lengths, and its poses to W.

    Time stamps stay: the delay of the readings is up to those who use them.

    Args:
        recording: As it was recorded, n cables.
        robot: As calibrated. Without anything on its sensors the recording is returned as it is.

    Returns:
        The same run; lengths, rates and commands are material, poses and exit points are in W.
        Relative lengths stay relative without an offset in the robot.
    """
    if not is_calibrated(robot) and robot.pose_rotation is None:
        return recording
    recording.require_cables(robot)
    scale = 1.0 if robot.length_scale is None else robot.length_scale
    rate, command = recording.length_rate, recording.command
    metadata = recording.metadata
    if robot.length_offset is not None and robot.length_offset.any():  # 0: not calibrated
        metadata = replace(metadata, length_kind="unstrained")
    return replace(
        recording,
        unstrained_length=paid_out_lengths(robot, recording.unstrained_length),
        length_rate=None if rate is None else Stamped(time=rate.time, value=rate.value / scale),
        command=None if command is None else _material(robot, command),
        poses=_turned_poses(robot, recording.poses),
        exit_points=_turned(robot, recording.exit_points),
        metadata=metadata,
    )


def _material(robot: Robot, channel: Stamped) -> Stamped:
    return Stamped(time=channel.time, value=unstrained_lengths(robot, channel.value))


def _turned(robot: Robot, points: Array | None) -> Array | None:
    """Return points of the frame of measured poses in W, shape (n, 3)."""
    if points is None or robot.pose_rotation is None:
        return points
    return np.asarray(points @ robot.pose_rotation.T)


def _turned_poses(robot: Robot, poses: PoseSamples | None) -> PoseSamples | None:
    """Return measured poses in W."""
    if poses is None or robot.pose_rotation is None:
        return poses
    return PoseSamples(
        time=poses.time,
        position=poses.position @ robot.pose_rotation.T,
        quaternion=from_matrix(robot.pose_rotation @ to_matrix(poses.quaternion)),
    )
