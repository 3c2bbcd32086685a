"""Checks that refuse mix-ups and set-ups that tell too little."""

from __future__ import annotations

import numpy as np

from calibration.lengths.unknowns import LengthUnknowns
from calibration.observability import Unobservable
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.base.numbers import plain
from carosac_toolkit.loop.values import Pose
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.recordings.encoders import calibrated
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.validation.broken_channels import find_repeated_pose
from carosac_toolkit.validation.clocks import clock_warnings
from carosac_toolkit.validation.plausibility import find_mix_ups
from carosac_toolkit.validation.pose_frames import find_frames

SWAP_MISFIT_SHARE = (
    0.5  # a mix-up is named where putting it right leaves less than this of the misfit
)
LENGTH_CHANGE_MIN_M = 0.1  # [m]: cables that move less tell no order
UNIT_FACTOR_MIN = 3.0  # times as much change as the distances have: other units
LEARNT_SIGMA_SHARE = (
    0.7  # of the prior sigma of an exit point: more than that left is nothing learnt
)
EXIT_SIGMA_MAX_M = 0.02  # [m]: exit points that are known better than this need not be learnt
DELAY_MAX_S = 0.5  # [s]: a longer one is no delay of a sensor, but another clock
POSE_EXTENT_SHARE = 0.02  # of the size of the frame: extent of the poses that counts as none


class MixUp(CarosacError):
    """Readings and poses do not belong together as they are."""


def check_order(robot: Robot, reading: Array, pose: Pose, *, relative: bool) -> None:
    """Refuse readings of swapped cables, in other units, and quaternions in another order.

    Args:
        robot: Before the calibration.
        reading: [m], shape (S, n).
        pose: Measured at the same times.
        relative: True if the readings have an unknown constant each.

    Raises:
        MixUp: Names what is mixed up.
    """
    mix_ups = _changes(robot, reading, pose)
    if not mix_ups and not relative and robot.length_offset is None:
        mix_ups = list(find_mix_ups(robot, reading, pose, zeros_known=False))
    _refuse(mix_ups)


def check_clock_and_frames(recording: Recording, robot: Robot) -> None:
    """Refuse poses that are repeated, of another clock than the readings, or in turned frames.

    Args:
        recording: As it was recorded.
        robot: Before the calibration.

    Raises:
        MixUp: Names the pose, the clock or the frame.
    """
    material = calibrated(recording, robot)
    _refuse(list(find_repeated_pose(material, robot)))
    _refuse(list(clock_warnings(material, robot, ("poses",), delay_max=DELAY_MAX_S)))
    if material.metadata.length_kind != "unstrained":
        return
    measured = material.pose_at(material.time)
    pose = Pose(
        position=measured.pose.position[measured.valid],
        rotation=measured.pose.rotation[measured.valid],
    )
    length = material.unstrained_length[measured.valid]
    if find_mix_ups(robot, length, pose, zeros_known=False):
        return  # `check_order` names these
    frames = find_frames(robot, length, pose, zeros_known=False)
    if frames is not None and frames.turned:
        _refuse(list(frames.sentences(robot)))


def _refuse(sentences: list[str]) -> None:
    """Refuse a recording that contradicts the robot."""
    if sentences:
        advice = "put that right in the recording or in the robot file, then calibrate again"
        raise MixUp("\n  ".join(["recording and robot do not fit:", *sentences, advice]))


def _changes(robot: Robot, reading: Array, pose: Pose) -> list[str]:
    """Return the mix-ups that changes of the readings show, whatever their zeros are."""
    from scipy.optimize import linear_sum_assignment

    cables = straight_length(robot, pose.position, pose.rotation)
    good = cables.valid.all(axis=1)
    read = reading[good] - np.median(reading[good], axis=0)
    far = cables.length[good] - np.median(cables.length[good], axis=0)
    spread = np.median(np.abs(far), axis=0)
    if len(far) < 3 or spread.min() < LENGTH_CHANGE_MIN_M:
        return []
    times = float(np.median(np.median(np.abs(read), axis=0) / spread))
    if times > UNIT_FACTOR_MIN or times < 1.0 / UNIT_FACTOR_MIN:
        change = f"Readings change {plain(times, 3)} times as much as the distances at the poses"
        units = {1000.0: "mm", 100.0: "cm"}
        near = [word for factor, word in units.items() if 0.8 < times / factor < 1.25]
        return [f"{change}: are they in {near[0]}?" if near else f"{change}: wrong units?"]
    misfit = np.median(np.abs(read[:, :, None] - far[:, None, :]), axis=0)  # (n, n)
    order = linear_sum_assignment(misfit)[1]
    same = np.arange(robot.n)
    if (order == same).all() or misfit[same, order].sum() > SWAP_MISFIT_SHARE * misfit[
        same, same
    ].sum():
        return []
    names = robot.cable_names
    swaps = [f"reading {i + 1} moves as cable '{names[j]}'" for i, j in enumerate(order) if i != j]
    return [f"Cables seem swapped: {', '.join(swaps)}."]


def check_observable(unknowns: LengthUnknowns, data: Array, position: Array) -> None:
    """Refuse a set-up that leaves exit points as unknown as they were.

    Args:
        unknowns: The parameters; exit points that are known apart, as by a tachymeter, pass.
        data: Fisher information of the readings alone, shape (k, k).
        position: Of the platform at the samples [m], shape (S, 3).

    Raises:
        Unobservable: With the reason.
    """
    exits = unknowns.exits
    if unknowns.anchored or not len(exits):
        return
    after = np.linalg.inv(data + unknowns.prior.information)
    lines = []
    for cable, rows in zip(unknowns.robot.cable_names, exits.reshape(-1, 3), strict=True):
        values, vectors = np.linalg.eigh(after[np.ix_(rows, rows)])
        sigma, before = (
            float(np.sqrt(values[-1])),
            unknowns.prior.covariance[rows[0], rows[0]] ** 0.5,
        )
        if sigma > max(LEARNT_SIGMA_SHARE * before, EXIT_SIGMA_MAX_M):
            along = np.array2string(np.abs(vectors[:, -1]), precision=2, separator=", ")
            lines.append(
                f"exit point '{cable}' would stay unknown by {sigma * 1e3:.0f} mm along {along} "
                f"(it was {before * 1e3:.0f} mm)"
            )
    if lines:
        advice = (
            "record more poses, spread over the whole workspace (--suggest-poses says which), or "
            "give the robot file covariances of its exit points, as from a tachymeter"
        )
        raise Unobservable("\n  ".join([f"{_spread(unknowns.robot, position)}:", *lines, advice]))


def _spread(robot: Robot, position: Array) -> str:
    """Return what is wrong with the poses, in words."""
    count = len(position)
    extent = np.zeros(3)
    if count > 1:
        values = np.linalg.svd(position - position.mean(axis=0), compute_uv=False)
        extent[: len(values)] = 3.5 * values / np.sqrt(count)  # the length of a uniform line
    thin = POSE_EXTENT_SHARE * float(np.ptp(robot.exit_points, axis=0).max())
    wide = int((extent > thin).sum())
    size = f"its {count} poses are" if count != 1 else "its only pose is"
    shape = ("in one point", "on one line", "in one plane", "too few, or too close together")[wide]
    spans = " x ".join(f"{value:.2f}" for value in extent)
    return f"the recording cannot calibrate the exit points: {size} {shape} ({spans} m)"


def radial_sentences(unknowns: LengthUnknowns, covariance: Array, direction: Array) -> list[str]:
    """Say where the exit point along its cable and the offset are almost one unknown.

    Args:
        unknowns: The parameters.
        covariance: Of the estimate, shape (k, k).
        direction: Mean unit vector from exit to anchor points, shape (n, 3).
    """
    offsets, lines = unknowns.prior.rows("length_offset"), list[str]()
    if len(offsets) != unknowns.robot.n or not len(unknowns.exits):
        return lines
    for i, name in enumerate(unknowns.robot.cable_names):
        radial = np.zeros(len(covariance))
        radial[unknowns.exits[3 * i : 3 * i + 3]] = direction[i] / np.linalg.norm(direction[i])
        apart, offset = radial @ covariance @ radial, covariance[offsets[i], offsets[i]]
        shared = radial @ covariance[:, offsets[i]] / np.sqrt(apart * offset)
        both = np.sqrt(max(apart + offset - 2.0 * radial @ covariance[:, offsets[i]], 0.0))
        if abs(shared) > 0.8:
            lines.append(
                f"exit point of '{name}' along its cable and its length offset are almost one "
                f"unknown (correlation {shared:.2f}): {np.sqrt(apart) * 1e3:.1f} mm and "
                f"{np.sqrt(offset) * 1e3:.1f} mm each, {both * 1e3:.2f} mm together"
            )
    return lines
