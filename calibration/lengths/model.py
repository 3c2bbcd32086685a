"""Predicted encoder readings at measured poses, with derivatives by all parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.lengths.platform_balance import PlatformBalance, balance
from calibration.lengths.pose_path import PosesAt
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.cable.lengths import length_at_tension
from carosac_toolkit.physics.cable.straight_line import StraightCables, straight_length
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.recordings.encoders import readings
from carosac_toolkit.robot.robot import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class PredictedReadings:
    """Predicted readings of S samples; m = n, or 6 with the balance of a robot of n < 6 cables.

    Attributes:
        value: Readings [m], and residuals of the balance, shape (S, m).
        by_all: Derivative by all parameters (`unknowns.all_names`), shape (S, m, K).
        by_pose: Derivative by an error of the measured pose, translation and rotation vector,
            shape (S, m, 6).
    """

    value: Array
    by_all: Array
    by_pose: Array


def in_world(robot: Robot, poses: PosesAt, *, anchored: bool) -> PosesAt:
    """Return poses in W, which is their own frame F unless the exit points are `anchored`."""
    turn = robot.pose_rotation
    if turn is None or not anchored:
        return poses
    twist = np.hstack([poses.twist[:, :3] @ turn.T, poses.twist[:, 3:] @ turn.T])
    return PosesAt(
        position=poses.position @ turn.T,
        rotation=turn @ poses.rotation,
        twist=twist,
        valid=poses.valid,
    )


def upwards(robot: Robot, *, anchored: bool) -> Array:
    """Return the unit vector against gravity in W, shape (3,)."""
    level = anchored or robot.pose_rotation is None
    return np.array([0.0, 0.0, 1.0]) if level else np.asarray(robot.pose_rotation)[2]


def tensions(robot: Robot, poses: PosesAt, up: Array) -> Array:
    """Return the tensions at poses in W [N], (S, n); NaN where the platform cannot rest.

    Those of the least squared tensions within the limits for n >= 6 cables, and those of least
    acceleration for fewer.
    """
    if robot.n >= 6:
        rest = statics.inverse_kinematics(robot, poses.position, poses.rotation)
        return np.asarray(np.where(rest.converged[:, None], rest.tension, np.nan))
    cables = straight_length(robot, poses.position, poses.rotation)
    tension = balance(robot, poses.rotation, cables, up).tension
    return np.asarray(np.where((tension > 0.0).all(axis=1, keepdims=True), tension, np.nan))


@dataclass(frozen=True, kw_only=True, eq=False)
class SagCorrection:
    """Effect of sag and stretch on lengths; NaN where there is no such cable.

    Attributes:
        value: Unstrained length of the hanging cable less the length of a straight one [m], (S, n).
        by_tension: Its change per relative change of the tension [m], (S, n).
    """

    value: Array
    by_tension: Array


def correction(robot: Robot, poses: PosesAt, tension: Array) -> SagCorrection:
    """Return the effect of sag and stretch at poses in W.

    Args:
        robot: With n cables.
        poses: S poses in W.
        tension: At the platform [N], shape (S, n).
    """
    cables = length_at_tension(robot, poses.position, poses.rotation, tension)
    straight = straight_length(robot, poses.position, poses.rotation)
    value = np.where(straight.valid, cables.unstrained_length - straight.length, np.nan)
    return SagCorrection(value=value, by_tension=-2.0 * cables.sag - cables.stretch)


def predict(
    robot: Robot, poses: PosesAt, correction: Array, *, with_balance: bool, anchored: bool
) -> PredictedReadings:
    """Predict readings at measured poses.

    Args:
        robot: With the parameters to judge.
        poses: In W.
        correction: As of a robot nearby [m], shape (S, n).
        with_balance: True if the balance of the platform is compared as well; n < 6.
        anchored: True if a tilt turns the poses, or gravity alone.
    """
    cables = straight_length(robot, poses.position, poses.rotation)
    length = cables.length + correction
    arm = robot.anchor_points @ poses.rotation.swapaxes(1, 2)  # (S, n, 3) [m], in W
    by_pose = np.concatenate([cables.direction, np.cross(arm, cables.direction)], axis=2)
    scale = np.ones(robot.n) if robot.length_scale is None else robot.length_scale
    size, n = length.shape
    value, by_pose = readings(robot, length), by_pose * scale[:, None]
    ones = np.broadcast_to(np.eye(n), (size, n, n))
    by_cable = np.concatenate(
        [_by_geometry(cables, poses) * scale[:, None], ones, length[:, :, None] * np.eye(n)], axis=2
    )
    by_center, by_gravity = np.zeros((size, n, 3)), np.zeros((size, n, 2))
    if with_balance:
        held = balance(robot, poses.rotation, cables, upwards(robot, anchored=anchored))
        value = np.concatenate([value, held.residual], axis=1)
        by_pose = np.concatenate([by_pose, held.by_pose], axis=1)
        by_cable = np.concatenate([by_cable, _balance_by_cable(held)], axis=1)
        by_center = np.concatenate([by_center, held.by_center], axis=1)
        by_gravity = np.concatenate([by_gravity, held.by_gravity], axis=1)
    by_tilt = _by_tilt(by_pose, poses) if anchored else -by_gravity
    blocks = (by_cable, by_pose @ poses.twist[..., None], by_tilt, *([by_center] if n < 6 else []))
    return PredictedReadings(value=value, by_all=np.concatenate(blocks, axis=2), by_pose=by_pose)


def _by_geometry(cables: StraightCables, poses: PosesAt) -> Array:
    """Return the lengths by exit points and anchor points, shape (S, n, 6 n)."""
    size, n = cables.length.shape
    derivative = np.zeros((size, n, 2, n, 3))
    own = np.arange(n)
    derivative[:, own, 0, own] = -cables.direction
    derivative[:, own, 1, own] = cables.direction @ poses.rotation
    return derivative.reshape(size, n, 6 * n)


def _balance_by_cable(held: PlatformBalance) -> Array:
    """Return the balance by exit points, anchor points, offsets, scales, (S, 6 - n, 8 n)."""
    size, rows, n, _ = held.by_exit.shape
    flat = [block.reshape(size, rows, 3 * n) for block in (held.by_exit, held.by_anchor)]
    return np.concatenate([*flat, np.zeros((size, rows, 2 * n))], axis=2)


def _by_tilt(by_pose: Array, poses: PosesAt) -> Array:
    """Return the derivative by a tilt of the poses' frame about x and y of W, (S, m, 2)."""
    motion = np.zeros((len(poses.position), 6, 2))
    for k, axis in enumerate(np.eye(3)[:2]):
        motion[:, :3, k] = np.cross(axis, poses.position)
        motion[:, 3:, k] = axis
    return np.asarray(by_pose @ motion)
