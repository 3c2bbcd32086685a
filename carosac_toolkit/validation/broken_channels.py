"""Channels that stop measuring or change their meaning midway: no calibration explains that.

A tracker that lost its body may repeat the last pose, a cable may slip on its drum, and the columns
of an orientation that nobody measured are filled with one. What follows from such a recording looks
like a robot, and is none.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.numbers import plain
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.robot import Robot

FROZEN_TIME_MIN_S = 1.0  # [s]: the slowest of trackers give another pose in that time
WOUND_MIN = Scaled(0.1, "m", most=0.1)  # by a cable, while a pose stays the same
SLIP_MIN = Scaled(0.05, "m", most=0.05)  # a smaller jump may be a matter of noise and calibration
SLIP_OVER_STEPS_MIN = 20.0  # times the median change between two samples
SLIP_LEFT_MIN = 0.7  # of a jump, still there between the medians of the samples beside it
SLIP_SAMPLES = 25  # on each side of a jump
STEADY_SHARE_MAX = 0.5  # of a jump, in cables that did not slip
RATIO_RANGE = (0.8, 1.25)  # of changes of a length over those of the distance: drums err by less
RATIO_CORRELATION_MIN = 0.95
RATIO_MOTION_MIN = 0.03  # standard deviation of the distance over its mean, that tells a ratio
LIKELY_RATIOS = {3.281: "feet", 39.37: "inches", 100.0: "cm", 1000.0: "mm"}
LIKELY_WITHIN = 0.05  # of such a ratio


def find_repeated_pose(recording: Recording, robot: Robot) -> Iterator[str]:
    """Return that a pose is repeated while cables are wound, if one is.

    Args:
        recording: As calibrated.
        robot: With as many cables, n.
    """
    poses = recording.poses
    if poses is None:
        return
    both = np.hstack([poses.position, poses.quaternion])
    starts = np.flatnonzero(np.r_[True, (np.diff(both, axis=0) != 0.0).any(axis=1)])
    ends = np.r_[starts[1:], len(both)] - 1
    least = WOUND_MIN.of(Scales(robot).ratios)
    for start, end in zip(starts, ends, strict=True):
        begin, until = poses.time[start], poses.time[end]
        if until - begin < FROZEN_TIME_MIN_S:
            continue
        meanwhile = (recording.time >= begin) & (recording.time <= until)
        if not meanwhile.any():
            continue
        way = np.ptp(recording.unstrained_length[meanwhile], axis=0)
        if way.max() > least:
            yield (
                f"Pose {start + 1} is repeated from {begin:.2f} s to {until:.2f} s, while length "
                f"{int(way.argmax()) + 1} changes by {way.max():.2g} m: did the tracker lose the "
                "platform? Leave the repeated poses out."
            )
            return


def find_wrong_ratios(robot: Robot, length: Array, pose: Pose) -> Iterator[str]:
    """Return that some lengths change by another factor than the distances, where others fit.

    Args:
        robot: Robot description, n cables.
        length: Measured [m], shape (S, n).
        pose: Measured at the same times.
    """
    length, distance = _with_distances(robot, length, pose)
    if len(length) <= 2:
        return
    moving = distance.std(axis=0) > RATIO_MOTION_MIN * distance.mean(axis=0)
    apart = [(column - column.mean(axis=0)) for column in (length, distance)]
    spread = [np.sqrt((column**2).mean(axis=0)) for column in apart]
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = (apart[0] * apart[1]).mean(axis=0) / (spread[0] * spread[1])
        ratio = spread[0] / spread[1]
    known = moving & (correlation > RATIO_CORRELATION_MIN)
    other = known & ((ratio < RATIO_RANGE[0]) | (ratio > RATIO_RANGE[1]))
    if not other.any() or not (known & ~other).any():
        return
    which = ", ".join(f"{i + 1} ({_named(ratio[i])})" for i in np.flatnonzero(other))
    yield (
        f"Some lengths change by another factor than their distances at the measured poses, others "
        f"fit: {which}. Check their units, encoders and drums."
    )


def _named(ratio: float) -> str:
    """Say a ratio, and the unit that it looks like."""
    unit = next(
        (name for per, name in LIKELY_RATIOS.items() if abs(ratio / per - 1.0) < LIKELY_WITHIN), ""
    )
    return f"{plain(ratio, 3)} times{f', as in {unit}' if unit else ''}"


def find_slip(robot: Robot, length: Array, pose: Pose) -> Iterator[str]:
    """Return that one length jumps against its distance, and stays apart, while the others fit.

    Args:
        robot: Robot description, n cables.
        length: Measured, one after the other [m], shape (S, n).
        pose: Measured at the same times.
    """
    length, distance = _with_distances(robot, length, pose)
    if len(length) <= 2:
        return
    excess = length - distance
    steps = np.abs(np.diff(excess, axis=0))
    least = max(SLIP_MIN.of(Scales(robot).ratios), SLIP_OVER_STEPS_MIN * float(np.median(steps)))
    for row, cable in zip(*np.nonzero(steps > least), strict=True):
        before = excess[max(row + 1 - SLIP_SAMPLES, 0) : row + 1]
        after = excess[row + 1 : row + 1 + SLIP_SAMPLES]
        jump = np.abs(np.median(after, axis=0) - np.median(before, axis=0))
        lasts = jump[cable] > SLIP_LEFT_MIN * steps[row, cable]
        others = np.delete(steps[row], cable)
        if lasts and (others < STEADY_SHARE_MAX * steps[row, cable]).all():
            yield (
                f"Length {cable + 1} jumps by {steps[row, cable]:.2g} m against the measured poses "
                f"at sample {row + 1} of those that have one, and stays apart: did the cable slip, "
                "or its encoder lose counts? Use the samples before or those after."
            )
            return


def _with_distances(robot: Robot, length: Array, pose: Pose) -> tuple[Array, Array]:
    """Return lengths and straight distances [m], (K, n), where there are such."""
    straight = straight_length(robot, pose.position, pose.rotation)
    good = straight.valid.all(axis=1)
    return length[good], straight.length[good]
