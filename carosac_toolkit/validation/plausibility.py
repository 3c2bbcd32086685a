"""Checks that lengths and poses of a recording belong together, and the likely mix-up if not.

The straight distances from exit to anchor points at the measured poses are compared with the
measured lengths. They differ by sag, stretch and calibration, that is by a few per cent at most;
wrong units, cables in another order and quaternions in another order differ by far more.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base import rotations
from carosac_toolkit.base.arrays import Array, evenly
from carosac_toolkit.base.numbers import plain
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.validation.broken_channels import (
    find_repeated_pose,
    find_slip,
    find_wrong_ratios,
)
from carosac_toolkit.validation.clocks import CHECKED_CHANNELS, clock_warnings
from carosac_toolkit.validation.pose_frames import RestDoubt, find_frames
from carosac_toolkit.validation.scores import rotation_angle

Order = NDArray[np.intp]
DISTANCE_MISFIT_MAX = 0.1  # of the distance: a larger median difference is no matter of calibration
EXPLAINED_MISFIT_MIN = 0.005  # of the distance: a smaller misfit needs no explanation
REMAINING_MISFIT_MAX = (
    0.5  # a mix-up is named where putting it right leaves less than this of the misfit
)
FRAME_DISTANCE_RATIO_MAX = (
    3.0  # times the size of the frame: positions farther from it are in other units
)
COMPARED_SAMPLES_MAX = 500  # compared, evenly spread
METRES_PER_UNIT = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
EXIT_POINT_DISTANCE_MAX_M = 0.01  # [m] from the measured ones
STATIC_MISFIT_MIN = (
    0.03  # of the distance: misfit from which lengths that hardly change tell an order
)
MISFIT_HINT = "the robot, and the frame of the poses"
QUATERNION_ORDER_HINT = "The orientation fits if the quaternion is x y z w: the format is w x y z."


@dataclass(frozen=True, kw_only=True, eq=False)
class _MixUpTrial:
    """Lengths (S, n) [m] and poses, as measured or with a mix-up corrected."""

    robot: Robot
    length: Array
    position: Array
    rotation: Array

    @property
    def distance(self) -> Array:
        """Straight-cable lengths at the poses [m], shape (S, n), NaN where there is none."""
        straight = straight_length(self.robot, self.position, self.rotation)
        return np.where(straight.valid, straight.length, np.nan)


def find_mix_ups(
    robot: Robot, length: Array, pose: Pose, *, zeros_known: bool = True
) -> tuple[str, ...]:
    """List evidence that lengths and poses do not belong together as they are.

    Args:
        robot: Robot description, n cables.
        length: Measured [m], shape (S, n), S >= 1.
        pose: Measured at the same times.
        zeros_known: True if lengths far from the distance are wrong. If not, their zeros may be
            anywhere, and only other units and other orders are looked for.

    Returns:
        Sentences; none for a recording that is plausible.
    """
    some = evenly(len(length), COMPARED_SAMPLES_MAX)
    trial = _MixUpTrial(
        robot=robot,
        length=length[some],
        position=pose.position[some],
        rotation=pose.rotation[some],
    )
    sentences, trial = _units(trial)
    more, trial = _orders(trial)
    sentences += more
    if not zeros_known:
        return tuple(sentences)
    sentences += _differences(trial)
    return tuple(sentences or _winch_range(trial))


def find_misfits(
    recording: Recording, robot: Robot, *, angles: Sequence[str] = ()
) -> tuple[str, ...]:
    """List evidence that a robot does not match a recording; all samples are compared.

    Args:
        recording: N length samples, as calibrated.
        robot: With as many cables.
        angles: As of `find_contradictions`.

    Returns:
        Sentences; none without poses, or where nothing contradicts the robot.
    """
    if recording.poses is None:
        return ()
    measured = recording.pose_at(recording.time)
    if not measured.valid.any():
        return ()
    pose = Pose(
        position=measured.pose.position[measured.valid],
        rotation=measured.pose.rotation[measured.valid],
    )
    lengths = recording.unstrained_length[measured.valid]
    return find_contradictions(recording, robot, lengths, pose, angles=angles)


def find_contradictions(
    recording: Recording,
    robot: Robot,
    length: Array,
    pose: Pose,
    *,
    zeros_known: bool = True,
    channels: Sequence[str] = CHECKED_CHANNELS,
    angles: Sequence[str] = (),
    doubt: RestDoubt | None = None,
) -> tuple[str, ...]:
    """List evidence that a channel is broken, clocks are apart, or lengths and poses do not fit.

    Only the first kind that is found is named, as each of them hides the next.

    Args:
        recording: As calibrated, for its clocks.
        robot: With as many cables, n.
        length: Some of its lengths [m], shape (S, n), S >= 1.
        pose: Measured at the same times.
        zeros_known: See `find_mix_ups`.
        channels: Whose clocks matter.
        angles: Channels of angles whose clocks matter too, and hide nothing.
        doubt: Of where the platform rests on some of the lengths; see `find_frames`.

    Returns:
        Sentences; none where nothing contradicts the robot.
    """
    first = tuple(find_repeated_pose(recording, robot)) or tuple(
        clock_warnings(recording, robot, channels)
    )
    apart = tuple(clock_warnings(recording, robot, angles)) if angles else ()
    return (*(first or _mixed_up(recording, robot, length, pose, zeros_known, doubt)), *apart)


def _mixed_up(
    recording: Recording,
    robot: Robot,
    length: Array,
    pose: Pose,
    zeros_known: bool,
    doubt: RestDoubt | None,
) -> tuple[str, ...]:
    """List evidence that lengths and poses do not fit, as `find_contradictions`."""
    mixed = find_mix_ups(robot, length, pose, zeros_known=zeros_known)
    mixed = mixed or tuple(find_wrong_ratios(robot, length, pose))
    if recording.metadata.length_kind != "unstrained":
        return mixed
    found = find_frames(robot, length, pose, zeros_known=zeros_known, doubt=doubt)
    frames = () if found is None else tuple(found.sentences(robot))
    if mixed == (QUATERNION_ORDER_HINT,) and frames:  # half a turn about z looks alike
        return (*mixed, f"Otherwise: {frames[-1]}")
    named = frames if _only_far(mixed) and frames else mixed
    if not named or (found is not None and found.only_moved and _only_far(mixed)):
        return tuple(find_slip(robot, length, pose)) or named
    return named


def _only_far(sentences: tuple[str, ...]) -> bool:
    """Return whether sentences name no more than lengths that are far from the distances."""
    return all(MISFIT_HINT in sentence for sentence in sentences)


def exit_point_distance(recording: Recording, robot: Robot) -> float | None:
    """Return the largest distance of a measured exit point from the robot's [m], or None.

    The recording is in W of the robot; see `calibrated`.
    """
    if recording.exit_points is None:
        return None
    return float(np.linalg.norm(recording.exit_points - robot.exit_points, axis=1).max())


def doubt_exit_points(distance: float | None) -> Iterator[str]:
    """Warn that exit points differ from those of the robot."""
    if distance is not None and distance > EXIT_POINT_DISTANCE_MAX_M:
        yield (
            f"Check the robot: its exit points lie up to {distance * 1e3:.0f} mm from those "
            "measured in the recording."
        )


def _units(trial: _MixUpTrial) -> tuple[list[str], _MixUpTrial]:
    """Return findings on lengths or positions in other units than metres."""
    if not abs(_median(trial.length / trial.distance) - 1.0) > DISTANCE_MISFIT_MAX:
        return [], trial
    best, repaired, chosen = DISTANCE_MISFIT_MAX, trial, ("m", "m")
    for units in product(METRES_PER_UNIT, METRES_PER_UNIT if _outside(trial) else ("m",)):
        scales = [METRES_PER_UNIT[unit] for unit in units]
        other = replace(trial, length=trial.length * scales[0], position=trial.position * scales[1])
        misfit = abs(_median(other.length / other.distance) - 1.0)
        if misfit < best:
            best, repaired, chosen = misfit, other, units
    sentences = []
    if chosen[0] != "m":
        times = f"{1.0 / METRES_PER_UNIT[chosen[0]]:.0f} times the distance at the measured poses"
        sentences.append(f"Lengths are {times}: are they in {chosen[0]}?")
    if chosen[1] != "m":
        sentences.append(f"Lengths and poses fit if the positions are in {chosen[1]}: are they?")
    return sentences, repaired


def _outside(trial: _MixUpTrial) -> bool:
    """Tell whether the platform is farther from the frame than any robot could hold it."""
    points = trial.robot.exit_points
    away = np.linalg.norm(trial.position - points.mean(axis=0), axis=1)
    return bool(np.median(away) > FRAME_DISTANCE_RATIO_MAX * np.ptp(points, axis=0).max())


def _orders(trial: _MixUpTrial) -> tuple[list[str], _MixUpTrial]:
    """Return findings on cables or quaternions in another order, if that explains over half."""
    trials = {False: trial, True: _turned(trial)}
    orders = {turn: _assignment(_pairs(each)) for turn, each in trials.items()}
    same = np.arange(trial.robot.n)
    left, turn, order = _misfit(trial, same), False, same
    if not left >= EXPLAINED_MISFIT_MIN:  # also where there is no distance
        return [], trial
    simple, double = [(False, orders[False])], []
    if _nearer_home(trial.rotation, trials[True].rotation, trial.robot):
        simple, double = [*simple, (True, same)], [(True, orders[True])]
    for group in (simple, double):
        candidates = [
            (_misfit(trials[turn], order), turn, order)
            for turn, order in group
            if _tells_order(trials[turn], order)
        ]
        best = min(candidates, key=lambda entry: entry[0], default=(np.inf, False, same))
        if best[0] < REMAINING_MISFIT_MAX * left:
            left, turn, order = best
    sentences = [QUATERNION_ORDER_HINT] if turn else []
    swaps = [f"{i + 1} fits exit point {j + 1}" for i, j in enumerate(order) if i != j]
    if swaps:
        sentences.append(f"Cables seem swapped: measured length {', '.join(swaps)}.")
    return sentences, replace(trials[turn], length=trial.length[:, np.argsort(order)])


def _turned(trial: _MixUpTrial) -> _MixUpTrial:
    """Return the orientations that were meant if the quaternions were written x y z w."""
    swapped = rotations.from_matrix(trial.rotation)[:, [3, 0, 1, 2]]
    return replace(trial, rotation=rotations.to_matrix(swapped))


def _nearer_home(measured: Array, other: Array, robot: Robot) -> bool:
    """Return whether only the other orientations resemble a platform that hangs as at home."""
    home = robot.home_rotation[None]
    angles = [float(np.median(rotation_angle(home, each))) for each in (measured, other)]
    return angles[1] < REMAINING_MISFIT_MAX * angles[0]


def _misfit(trial: _MixUpTrial, order: Order) -> float:
    """Return the mean over the cables of the median relative difference to the distance."""
    difference = np.abs(trial.length - trial.distance[:, order])
    return float(np.mean([_median(column) for column in difference.T])) / _median(trial.distance)


def _tells_order(trial: _MixUpTrial, order: Order) -> bool:
    """Return whether lengths also change in this order, or are too far off for wrong zeros."""
    same = np.arange(trial.robot.n)
    if (order == same).all() or _misfit(trial, same) >= STATIC_MISFIT_MIN:
        return True
    distance = trial.distance
    ok = np.isfinite(distance).all(axis=1)
    length, distance = trial.length[ok], distance[ok]
    length = length - np.median(length, axis=0)
    distance = distance - np.median(distance, axis=0)
    as_is, swapped = (np.abs(length - distance[:, each]).mean() for each in (same, order))
    return bool(swapped < REMAINING_MISFIT_MAX * as_is)


def _pairs(trial: _MixUpTrial) -> Array:
    """Return the median difference of each length to the distance of each cable [m], (n, n)."""
    distance = trial.distance
    distance = distance[np.isfinite(distance).all(axis=1)]
    if not len(distance):
        return np.full((trial.robot.n, trial.robot.n), np.nan)
    known = trial.length[np.isfinite(trial.distance).all(axis=1)]
    return np.array([np.median(np.abs(row[:, None] - distance), axis=0) for row in known.T])


def _assignment(pairs: Array) -> Order:
    """Return the cable of each length that minimises the sum of differences, shape (n,)."""
    from scipy.optimize import linear_sum_assignment

    if not np.isfinite(pairs).all():
        return np.arange(len(pairs))
    return np.asarray(linear_sum_assignment(pairs)[1], dtype=np.intp)


def _differences(trial: _MixUpTrial) -> Iterator[str]:
    """Return findings on lengths that are far from the distance for no known reason."""
    ratio = trial.length / trial.distance
    each = np.array([_median(column) for column in ratio.T])
    far = np.abs(each - 1.0) > DISTANCE_MISFIT_MAX
    if far.all():
        yield (
            f"Lengths are {plain(_median(ratio), 3)} times the distance at the measured poses: "
            f"check units and zero of the lengths, {MISFIT_HINT}."
        )
        return
    if far.any():
        which = ", ".join(f"{i + 1} ({plain(each[i], 3)} times)" for i in np.flatnonzero(far))
        yield (
            f"Some lengths are far from the distance at the measured poses, others fit: {which}. "
            f"Check their encoders and exit points, {MISFIT_HINT}."
        )


def _winch_range(trial: _MixUpTrial) -> Iterator[str]:
    """Return findings on lengths that the winches of this robot cannot wind."""
    robot, typical = trial.robot, np.median(trial.length, axis=0)
    for i in np.flatnonzero((typical < robot.length_min) | (typical > robot.length_max)):
        yield (
            f"Measured length {i + 1} is {plain(typical[i], 3)} m in the median; the winch of "
            f"robot {robot.name} has {robot.length_min[i]:g} to {robot.length_max[i]:g} m: is it "
            "this robot?"
        )


def _median(values: Array) -> float:
    """Return the median of finite values, NaN if there are none."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else np.nan
