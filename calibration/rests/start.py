"""Start of the search: poses and zeros of the readings, by straight cables.

Lengths, the balance of a platform on fewer than six cables, swivel angles and orientations are
fitted by least squares, several times: each time the first rest begins at another place of the
workspace box.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.lengths.model import correction, predict, tensions
from calibration.lengths.pose_path import PosesAt
from calibration.linear_samples import LinearSamples
from calibration.normal_equations import solve
from calibration.rest_readings import RestReadings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.physics.cable.swivel import swivel_angle
from carosac_toolkit.robot.robot import Robot

CORNER_SHARE = 0.5  # of the half sides of the workspace box, where the first rest may begin
STARTS_AGREEING = 4  # starts that end at the same best cost: no others are tried
SAME_COST = 1.01
ROUNDS_ALONE, ROUNDS_TOGETHER = 12, 25
LENGTH_NOISE_SHARE = 2e-3  # of the size of the frame: what straight cables miss
BALANCE_NOISE_RAD = 5e-3
SWIVEL_NOISE_RAD, ATTITUDE_NOISE_RAD = 0.01, 0.05  # with zeros and mountings that are not known
TURN_SIGMA_RAD = 0.3  # of a platform from its home rotation
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, kw_only=True, eq=False)
class RestStart:
    """Where to begin.

    Attributes:
        position: Platform origin at each rest in W [m], shape (K, 3).
        rotation: From P to W, shape (K, 3, 3).
        offset: Readings of length at unstrained length 0 [m], shape (n,).
        cost: Of the fit; the smaller, the likelier.
    """

    position: Array
    rotation: Array
    offset: Array
    cost: float


def find_starts(robot: Robot, readings: RestReadings) -> list[RestStart]:
    """Return starts, the likeliest first.

    Args:
        robot: Before the calibration.
        readings: Of K rests.
    """
    half = 0.5 * (robot.workspace_max - robot.workspace_min)
    middle = robot.workspace_min + half
    corners = [middle + CORNER_SHARE * half * c for c in itertools.product((-1.0, 1.0), repeat=3)]
    problem = _StraightProblem(robot, readings)
    starts: list[RestStart] = []
    for place in (robot.home_position, middle, *corners):
        starts.append(problem.fit(place))
        costs = np.sort([start.cost for start in starts])
        if len(starts) >= STARTS_AGREEING and costs[STARTS_AGREEING - 1] < SAME_COST * costs[0]:
            break
    return sorted(starts, key=lambda start: start.cost)


def heading(rotation: Array, attitude: Array) -> float:
    """Return the turn about z that leads best from some rotations to measured ones [rad].

    Args:
        rotation: From P to W, shape (K, 3, 3).
        attitude: From the AHRS to its level frame, shape (K, 3, 3).
    """
    turn = (attitude @ rotation.swapaxes(1, 2)).sum(axis=0)
    return float(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]))


class _StraightProblem:
    """Readings of K rests by straight cables."""

    def __init__(self, robot: Robot, readings: RestReadings) -> None:
        self._robot, self._readings = robot, readings
        size = float(np.ptp(robot.exit_points, axis=0).max())
        self._length_noise = LENGTH_NOISE_SHARE * size
        half = 0.5 * (robot.workspace_max - robot.workspace_min)
        self._place_sigma = half + self._length_noise
        self._pulleys = np.flatnonzero(robot.pulley_radius > 0.0)
        self._scale = np.ones(robot.n) if robot.length_scale is None else robot.length_scale
        self._length = readings.length / self._scale

    def fit(self, first: Array) -> RestStart:
        """Fit poses and zeros, the first rest at some place to begin with."""
        robot, count = self._robot, len(self._length)
        position = np.tile(first, (count, 1))
        rotation = np.tile(robot.home_rotation, (count, 1, 1))
        offset = self._length[0] - straight_length(robot, position[:1], rotation[:1]).length[0]
        sag = np.zeros_like(self._length)
        cost = np.inf
        shared_sigma = np.full(robot.n, 1e-6)  # zeros are held at first
        for round_ in range(ROUNDS_ALONE + ROUNDS_TOGETHER):
            if round_ == ROUNDS_ALONE:
                shared_sigma[:] = 1e3
            linear = self._linear(position, rotation, offset, sag)
            step = solve(linear, np.diag(shared_sigma**-2.0), np.zeros(robot.n), damping=1e-9)
            before, cost = cost, float((linear.residual**2).sum())
            offset = offset + step.shared
            move = np.clip(step.own, -self._step_max, self._step_max)
            position = position + move[:, :3]
            rotation = Rotation.from_rotvec(move[:, 3:]).as_matrix() @ rotation
            if round_ in (ROUNDS_ALONE - 1, ROUNDS_ALONE + 5, ROUNDS_ALONE + 10):
                sag = self._sag(position, rotation)
            elif round_ > ROUNDS_ALONE + 11 and abs(before - cost) < 1e-6 * cost:
                break
        return RestStart(
            position=position, rotation=rotation, offset=self._scale * offset, cost=cost
        )

    @property
    def _step_max(self) -> Array:
        return np.concatenate([self._place_sigma, np.full(3, TURN_SIGMA_RAD)])

    def _sag(self, position: Array, rotation: Array) -> Array:
        """Return what sag and stretch add to the lengths [m], (K, n); 0 where it is unknown."""
        poses = _poses(position, rotation)
        pull = self._readings.tension
        if pull is None:
            pull = tensions(self._robot, poses, UP)
        return np.nan_to_num(correction(self._robot, poses, pull).value)

    def _linear(self, position: Array, rotation: Array, offset: Array, sag: Array) -> LinearSamples:
        """Return residuals in standard deviations; a sample's own unknowns are its pose."""
        robot, read, n = self._robot, self._readings, self._robot.n
        poses = _poses(position, rotation)
        predicted = predict(robot, poses, sag, with_balance=n < 6, anchored=True)
        scale = np.ones(n) if robot.length_scale is None else robot.length_scale
        known = np.zeros(n) if robot.length_offset is None else robot.length_offset
        value = predicted.value.copy()
        value[:, :n] = (value[:, :n] - known) / scale + offset
        by_pose = predicted.by_pose.copy()
        by_pose[:, :n] /= scale[:, None]
        noise = np.full(value.shape[1], BALANCE_NOISE_RAD)
        noise[:n] = self._length_noise
        residual = -value
        residual[:, :n] += self._length
        by_shared = np.zeros((*value.shape, n))
        by_shared[:, :n] = -np.eye(n)
        blocks = [(residual / noise, -by_pose / noise[:, None], by_shared / noise[:, None])]
        middle = 0.5 * (robot.workspace_min + robot.workspace_max)
        turn = Rotation.from_matrix(rotation @ robot.home_rotation.T).as_rotvec()
        wide = np.concatenate([(middle - position) / self._place_sigma, -turn / TURN_SIGMA_RAD], 1)
        blocks.append(_own(wide, -np.diag(1.0 / self._step_max), n))
        if read.swivel_angle is not None and len(self._pulleys):
            blocks.append(self._swivels(position, rotation))
        if read.attitude is not None:
            turn = Rotation.from_rotvec([0.0, 0.0, -heading(rotation, read.attitude)])
            level = turn.as_matrix() @ read.attitude  # in W
            off = Rotation.from_matrix(level @ rotation.swapaxes(1, 2))
            by_turn = np.concatenate([np.zeros((3, 3)), -np.eye(3)], axis=1) / ATTITUDE_NOISE_RAD
            blocks.append(_own(off.as_rotvec() / ATTITUDE_NOISE_RAD, by_turn, n))
        parts = [np.concatenate(part, axis=1) for part in zip(*blocks, strict=True)]
        return LinearSamples(residual=parts[0], by_own=parts[1], by_shared=parts[2])

    def _swivels(self, position: Array, rotation: Array) -> tuple[Array, Array, Array]:
        """Return residuals of the swivel angles and their derivatives."""
        robot = self._robot
        arm = robot.anchor_points @ rotation.swapaxes(1, 2)
        towards = position[:, None] + arm - robot.exit_points
        off = np.asarray(self._readings.swivel_angle) - swivel_angle(robot, towards)
        off = (off + np.pi) % (2.0 * np.pi) - np.pi
        axis = np.broadcast_to(robot.swivel_axis, towards.shape)
        across = towards - (towards * axis).sum(-1, keepdims=True) * axis
        by_anchor = np.cross(axis, across) / (across**2).sum(-1, keepdims=True)
        by_pose = np.concatenate([by_anchor, np.cross(arm, by_anchor)], axis=2)
        noise = SWIVEL_NOISE_RAD
        residual, by_own = off[:, self._pulleys] / noise, -by_pose[:, self._pulleys] / noise
        return residual, by_own, np.zeros((*residual.shape, robot.n))


def _poses(position: Array, rotation: Array) -> PosesAt:
    """Return poses that do not move."""
    count = len(position)
    return PosesAt(
        position=position, rotation=rotation, twist=np.zeros((count, 6)),
        valid=np.ones(count, dtype=np.bool_),
    )  # fmt: skip


def _own(residual: Array, by_own: Array, shared: int) -> tuple[Array, Array, Array]:
    """Return rows that depend on a sample's own unknowns alone."""
    by_all = np.broadcast_to(by_own, (len(residual), *by_own.shape))
    return residual, by_all, np.zeros((*residual.shape, shared))
