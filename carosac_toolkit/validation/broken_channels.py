"""Channels that stop measuring or change their meaning midway: no calibration explains that.

A tracker that lost its body may repeat the last pose, a cable may slip on its drum, and the columns
of an orientation that nobody measured are filled with one. What follows from such a recording looks
like a robot, and is none.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array, evenly
from carosac_toolkit.base.numbers import plain
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.physics.rest.statics import forward_kinematics
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.robot import Robot

FROZEN_TIME_MIN_S = 1.0  # [s]: most trackers give another pose in that time
FROZEN_OVER_USUAL_MIN = 3.0  # times as long as poses usually stay the same
MOVED_MIN = Scaled(0.1, "m", most=0.1)  # by the lengths, while a pose stays the same
RESTS = 10  # poses of rest that are solved for a time
SLIP_MIN = Scaled(0.05, "m", most=0.05)  # a smaller jump may be a matter of noise and calibration
SLIP_OVER_STEPS_MIN = 20.0  # times the median change between two samples
SLIP_OVER_WAY_MIN = 0.25  # of what the distance changes meanwhile, as over a gap
SLIP_LEFT_RANGE = (0.7, 1.4)  # of a jump, between the medians of the samples beside it
SLIP_UNEXPLAINED_MAX = 0.5  # of how much farther the platform is from rest, without the jump
SLIP_SAMPLES = 25  # on each side of a jump
STEADY_SHARE_MAX = 0.5  # of a jump, in cables that did not slip
RATIO_RANGE = (0.5, 2.0)  # of changes of a length over those of the distance: slack adds some
RATIO_CORRELATION_MIN = 0.95
RATIO_MOTION_MIN = 0.03  # standard deviation of the distance over its mean, that tells a ratio
LIKELY_RATIOS = {3.281: "feet", 39.37: "inches", 100.0: "cm", 1000.0: "mm"}
LIKELY_WITHIN = 0.05  # of such a ratio


def find_repeated_pose(recording: Recording, robot: Robot) -> Iterator[str]:
    """Return that a pose is repeated while the lengths move the platform, if one is.

    A slack cable may be wound without moving it, and a slow tracker holds each pose for a while.

    Args:
        recording: As calibrated; nothing is told where its lengths are relative.
        robot: With as many cables, n.
    """
    poses = recording.poses
    if poses is None or recording.metadata.length_kind != "unstrained":
        return
    both = np.hstack([poses.position, poses.quaternion])
    starts = np.flatnonzero(np.r_[True, (np.diff(both, axis=0) != 0.0).any(axis=1)])
    ends = np.r_[starts[1:], len(both)] - 1
    held = poses.time[ends] - poses.time[starts]
    usual = float(np.median(held)) if len(held) > 1 else 0.0
    for k in np.flatnonzero(held > max(FROZEN_TIME_MIN_S, FROZEN_OVER_USUAL_MIN * usual)):
        begin, until = poses.time[starts[k]], poses.time[ends[k]]
        way = _way(recording, robot, begin, until)
        if way > MOVED_MIN.of(Scales(robot).ratios):
            yield (
                f"Pose {starts[k] + 1} is repeated from {begin:.2f} s to {until:.2f} s, while the "
                f"lengths move the platform by {way:.2g} m: did the tracker lose it? Leave the "
                "repeated poses out."
            )
            return


def _way(recording: Recording, robot: Robot, begin: float, until: float) -> float:
    """Return how far from the first pose of rest the lengths of some time move a platform [m]."""
    rows = np.flatnonzero((recording.time >= begin) & (recording.time <= until))
    if len(rows) < 2:
        return 0.0
    rest = forward_kinematics(robot, recording.unstrained_length[rows[evenly(len(rows), RESTS)]])
    good = rest.position[rest.converged & rest.stable]
    return float(np.linalg.norm(good - good[:1], axis=1).max(initial=0.0))


def find_wrong_ratios(robot: Robot, length: Array, pose: Pose) -> Iterator[str]:
    """Return that some lengths change by another factor than the distances, where others fit.

    Args:
        robot: Robot description, n cables.
        length: Measured [m], shape (S, n).
        pose: Measured at the same times.
    """
    good, distance = _distances(robot, pose)
    if len(good) <= 2:
        return
    length = length[good]
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

    A slack cable may be wound without moving the platform: without the jump, the platform is to
    rest nearer to where it is.

    Args:
        robot: Robot description, n cables.
        length: Measured, one after the other [m], shape (S, n).
        pose: Measured at the same times.
    """
    good, distance = _distances(robot, pose)
    if len(good) <= 2:
        return
    length, position = length[good], pose.position[good]
    excess = length - distance
    steps = np.abs(np.diff(excess, axis=0))
    wound = np.abs(np.diff(distance, axis=0))  # a drum's error shows more the further it turns
    least = max(SLIP_MIN.of(Scales(robot).ratios), SLIP_OVER_STEPS_MIN * float(np.median(steps)))
    for row, cable in zip(*np.nonzero(steps > least + SLIP_OVER_WAY_MIN * wound), strict=True):
        before = np.arange(max(row + 1 - SLIP_SAMPLES, 0), row + 1)
        after = np.arange(row + 1, min(row + 1 + SLIP_SAMPLES, len(excess)))
        jumps = np.median(excess[after], axis=0) - np.median(excess[before], axis=0)
        share = abs(jumps[cable]) / steps[row, cable]
        others = np.delete(steps[row], cable)
        if (
            not SLIP_LEFT_RANGE[0] < share < SLIP_LEFT_RANGE[1]
            or (others > STEADY_SHARE_MAX * steps[row, cable]).any()
        ):
            continue
        jump = np.where(np.arange(robot.n) == cable, jumps, 0.0)
        if _moves(robot, length, position, (before, after), jump):
            yield (
                f"Length {cable + 1} jumps by {steps[row, cable]:.2g} m against the measured poses "
                f"at sample {row + 1} of those that have one, and stays apart: did the cable slip, "
                "or its encoder lose counts? Use the samples before or those after."
            )
            return


def _moves(
    robot: Robot, length: Array, position: Array, sides: Sequence[NDArray[np.intp]], jump: Array
) -> bool:
    """Return whether a jump of lengths (n,) explains how much farther platforms are from rest."""
    before, after = (rows[evenly(len(rows), RESTS)] for rows in sides)
    missed = []
    for rows, change in ((before, 0.0 * jump), (after, 0.0 * jump), (after, jump)):
        rest = forward_kinematics(robot, np.maximum(length[rows] - change, np.finfo(float).tiny))
        good = rest.converged & rest.stable
        if not good.any():
            return False
        missed.append((rest.position - position[rows])[good].mean(axis=0))
    apart, left = (float(np.linalg.norm(each - missed[0])) for each in missed[1:])
    return left < SLIP_UNEXPLAINED_MAX * apart


def _distances(robot: Robot, pose: Pose) -> tuple[NDArray[np.intp], Array]:
    """Return the samples at which all cables can be straight, and their lengths then (K, n) [m]."""
    straight = straight_length(robot, pose.position, pose.rotation)
    good = np.flatnonzero(straight.valid.all(axis=1))
    return good, straight.length[good]
