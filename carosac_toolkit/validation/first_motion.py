"""Motion of the platform at the first samples of a recording, from measured poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.values import Belief
from carosac_toolkit.physics.rest.held_lengths import moved_pose
from carosac_toolkit.physics.rest.modes import mass_matrix, natural_modes
from carosac_toolkit.physics.rest.statics import Equilibrium, forward_kinematics
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.validation.phases import (
    PLATFORM_REST_SPEED_MAX,
    REST_DURATION_MIN_S,
    anchor_speed,
    find_phases,
)

STATE_PERIODS = 0.4  # of a mode, over which a polynomial is fitted to its motion
STATE_DEGREE_MAX = 4
STATE_POSES_MIN = 4  # poses, from which a speed can be told
SIX_CABLES = 6  # so many cables leave a platform no free direction


@dataclass(frozen=True, kw_only=True)
class FirstSpeed:
    """Speed of the platform at the first samples.

    Attributes:
        speed: Of the fastest anchor point, RMS [m/s].
        moves: True if that is no rest.
    """

    speed: float
    moves: bool


def first_speed(
    robot: Robot,
    time: Array,
    length: Array,
    pose_time: Array,
    position: Array,
    rotation: Array,
) -> FirstSpeed:
    """Judge whether the platform moves at first, by its speed where poses are measured.

    Over the first rest of the winches, or one slowest sway period of it; where they do not rest at
    first, over the shortest rest.

    Args:
        robot: Robot description, n cables.
        time: Of the lengths [s], shape (N,).
        length: [m], shape (N, n).
        pose_time: Of the poses [s], shape (K,).
        position: Platform origin in W [m], shape (K, 3).
        rotation: From P to W, shape (K, 3, 3).
    """
    scales = Scales(robot)
    span = REST_DURATION_MIN_S
    rests = find_phases(time, length).rests
    if rests and rests[0][0] == 0:
        rest = float(time[rests[0][1] - 1] - pose_time[0])
        span = max(span, min(rest, 2.0 * np.pi * scales.time))
    rows = pose_time <= max(pose_time[0] + span, pose_time[min(1, len(pose_time) - 1)])
    speeds = anchor_speed(robot, pose_time, position, rotation)[rows]
    speed = float(np.sqrt((speeds**2).mean()))
    return FirstSpeed(speed=speed, moves=speed > PLATFORM_REST_SPEED_MAX.of(scales.ratios))


def first_motion(recording: Recording, robot: Robot) -> Belief | None:
    """Return pose and twist at the first sample, or None where the platform rests or is unseen.

    Args:
        recording: Material, with poses in W (`carosac_toolkit.recordings.encoders.calibrated`).
        robot: Robot description, n cables.

    Returns:
        B = 1; None with six cables or more, which leave no motion without one of the winches.
    """
    if recording.poses is None:
        return None
    matched = recording.pose_at(recording.time)
    rows = np.flatnonzero(matched.valid)
    if len(rows) < STATE_POSES_MIN or rows[0] > 0 or robot.n >= SIX_CABLES:
        return None
    time, length = recording.time, recording.unstrained_length
    position, rotation = matched.pose.position[rows], matched.pose.rotation[rows]
    moves = first_speed(robot, time, length, time[rows], position, rotation).moves
    if not moves or (length[0] <= 0.0).any():
        return None
    rest = forward_kinematics(robot, length[:1])
    if not (rest.converged & rest.stable).all():
        return None
    return first_state(robot, rest, time[rows], position, rotation)


def first_state(
    robot: Robot, rest: Equilibrium, time: Array, position: Array, rotation: Array
) -> Belief:
    """Return pose and twist at the first measured pose, B = 1.

    A polynomial in time is fitted to the motion along each mode of the platform, over a share of
    its period, as a fast mode needs a short span and a slow one can do with less noise.

    Args:
        robot: Robot description, n cables.
        rest: Its equilibrium on the first lengths, B = 1, whose modes are taken.
        time: Of the poses [s], shape (K,), two at least.
        position: Platform origin in W [m], shape (K, 3).
        rotation: From P to W, shape (K, 3, 3).
    """
    modes = natural_modes(robot, rest)
    shape = modes.shape[0]
    frequency = np.abs(modes.frequency[0])
    free = max(len(frequency) - robot.n, 1)
    span = STATE_PERIODS / np.minimum(frequency, frequency[free - 1])  # stiff modes hardly move
    turned = Rotation.from_matrix(rotation @ rotation[0].T).as_rotvec()
    motion = np.hstack([position - position[0], turned])
    mass = mass_matrix(robot, rest.rotation, rest.unstrained_length)[0]
    modal = motion @ mass @ shape  # (K, 6)
    start = np.array([_at_first(time, modal[:, j], span[j]) for j in range(len(frequency))])
    place, turn = moved_pose(position[0], rotation[0], shape @ start[:, 0])
    twist = shape @ start[:, 1]
    return Belief(time=time[:1], position=place[None], rotation=turn[None], twist=twist[None])


def _at_first(time: Array, value: Array, span: float) -> tuple[float, float]:
    """Return a smooth value (K,) and its rate at the first time, by a polynomial over a span."""
    count = max(int(np.searchsorted(time, time[0] + span)), STATE_POSES_MIN)
    since = time[:count] - time[0]
    degree = min(STATE_DEGREE_MAX, len(since) // 2)
    fit = np.polynomial.polynomial.polyfit(since / since[-1], value[:count], degree)
    return float(fit[0]), float(fit[1] / since[-1])
