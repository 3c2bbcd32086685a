"""Motion of the platform at the first samples of a recording, from measured poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.values import Belief
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.validation.phases import (
    PLATFORM_REST_SPEED_MAX,
    REST_DURATION_MIN_S,
    anchor_speed,
    find_phases,
)

STATE_PERIODS = 0.4  # of the fastest sway, over which a polynomial is fitted
STATE_DEGREE_MAX = 3
STATE_POSES_MIN = 4  # poses, from which a speed can be told


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


def first_state(time: Array, position: Array, rotation: Array, frequency: float) -> Belief:
    """Return pose and twist at the first measured pose, B = 1, by a polynomial in time.

    Args:
        time: Of the poses [s], shape (K,), two at least.
        position: Platform origin in W [m], shape (K, 3).
        rotation: From P to W, shape (K, 3, 3).
        frequency: Of the fastest sway [Hz].
    """
    span = STATE_PERIODS / frequency
    count = max(int(np.searchsorted(time, time[0] + span)), STATE_POSES_MIN)
    turned = Rotation.from_matrix(rotation[:count] @ rotation[0].T).as_rotvec()
    motion = np.hstack([position[:count], turned])
    scale = max(span, float(np.ptp(time[:count])))
    degree = min(STATE_DEGREE_MAX, len(motion) // 2)
    fit = np.polynomial.polynomial.polyfit((time[:count] - time[0]) / scale, motion, degree)
    start = Rotation.from_rotvec(fit[0, 3:]).as_matrix() @ rotation[0]
    return Belief(time=time[:1], position=fit[:1, :3], rotation=start[None], twist=fit[1:2] / scale)
