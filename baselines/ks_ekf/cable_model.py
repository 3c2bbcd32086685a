r"""Lengths at a pose in motion: sagging cables whose tension follows from the specific force.

The platform's inertia and weight are what its cables exert,
:math:`\sum_i f_i [u_i; R b_i \times u_i] + d_i = w`, with w from the accelerometer and the
gyroscope at the centre of mass and :math:`d_i` the half of each cable's own weight, across its
chord, that hangs on the platform. Least squares over the six equations give the tensions, these
the sag and stretch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from baselines.ks_ekf.cable_swing import CableStrings, CableSwing
from baselines.ks_ekf.filter_settings import FilterSettings
from baselines.ks_ekf.filter_state import KsEkfState
from baselines.ks_ekf.platform_motion import origin, pose_map
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import cross_matrix
from carosac_toolkit.physics.cable.lengths import length_at_tension
from carosac_toolkit.physics.cable.straight_line import StraightCables, straight_length
from carosac_toolkit.physics.rest.structure import structure_matrix
from carosac_toolkit.robot.robot import Robot

TAUT_TENSION_DEVIATIONS = 2.0  # a smaller tension does not tell how much the cable sags
TENSION_ERROR_RATIO = 0.05  # of the tensions behind sag and stretch: mass and inertia are so good


@dataclass(frozen=True, kw_only=True, eq=False)
class ExpectedLengths:
    """Expected lengths of one robot in a state, without their biases.

    Attributes:
        length: Unstrained [m], shape (n,); only where `valid`.
        jacobian: Per error of the state, shape (n, 18 + n), bias included.
        tension: At the platform [N], shape (n,); not positive where the cable would have to push.
        valid: Whether the cable is taut, so that its length says something, shape (n,).
        spread: Standard deviation of the length, as the tension is not known well, the cable may
            swing, and the pose may be too far off for lengths to be linear in it [m], shape (n,).
        swing: Of the cables, at the time of the state.
    """

    length: Array
    jacobian: Array
    tension: Array
    valid: NDArray[np.bool_]
    spread: Array
    swing: CableSwing


def expected_lengths(
    robot: Robot, state: KsEkfState, turning: Array, swing: CableSwing, settings: FilterSettings
) -> ExpectedLengths:
    """Expect the lengths of a state.

    Args:
        robot: Nominal robot, n cables.
        state: Of the filter, with samples.
        turning: Angular acceleration in P [rad/s^2], shape (3,).
        swing: Of the cables, when lengths were used last.
        settings: Where the IMU is.

    Returns:
        Lengths, Jacobian, tensions, and where they count.
    """
    where = origin(state, settings.imu_position)[None]
    straight = straight_length(robot, where, state.rotation[None])
    matrix = structure_matrix(robot, where, state.rotation[None])[0]
    loads = np.stack([_wrench(robot, state, turning, settings), _weight(robot, state)], axis=1)
    loads -= _hanging(robot, state.rotation, straight)[:, None]
    weight = np.repeat([1.0, 1.0 / settings.moment_lever], 3)[:, None]
    tension, still = np.asarray(np.linalg.lstsq(weight * matrix, weight * loads, rcond=None)[0]).T
    cables = length_at_tension(robot, where, state.rotation[None], tension[None])
    jacobian = -matrix.T @ pose_map(state, settings.imu_position)
    jacobian[:, len(jacobian.T) - robot.n :] = np.eye(robot.n)
    # By the sag, which goes with the inverse square of the tension, and the stretch. A tension is
    # not known better than to the weight of its cable, nor a length to what its swing takes.
    doubt = (
        TENSION_ERROR_RATIO * np.abs(tension)
        + settings.tension_change * np.abs(tension - still)
        + robot.weight_per_length * straight.length[0]
    )
    taut = tension > TAUT_TENSION_DEVIATIONS * doubt
    less = np.where(taut, tension - doubt, 1.0)
    bend = _curvature(robot, state, straight, settings)
    strings = _strings(robot, straight, tension)
    swing = swing.later(state.time, strings, settings.swing_fade_time)
    spread = (2.0 * cables.sag[0] + cables.stretch[0]) * doubt / less + bend + swing.taken(strings)
    return ExpectedLengths(
        length=cables.unstrained_length[0],
        jacobian=jacobian,
        tension=tension,
        spread=spread,
        swing=swing,
        valid=cables.valid[0] & taut & straight.valid[0],
    )


def _strings(robot: Robot, straight: StraightCables, tension: Array) -> CableStrings:
    """Return the cables as strings; loose ones as if under their own weight."""
    length, unit = straight.length[0], straight.direction[0]
    weight = robot.weight_per_length
    across = np.sqrt(np.maximum(1.0 - unit[:, 2] ** 2, 0.0))
    return CableStrings(
        length=length, tension=np.maximum(tension, weight * length), density=robot.linear_density,
        weight=weight * across,
    )  # fmt: skip


def _curvature(
    robot: Robot, state: KsEkfState, straight: StraightCables, settings: FilterSettings
) -> Array:
    """Return the second-order length error of the present pose covariance [m], (n,)."""
    mapping = pose_map(state, settings.imu_position)
    variance = np.diag(mapping @ state.covariance @ mapping.T)
    arm = np.linalg.norm(robot.anchor_points, axis=1)
    return np.asarray(0.5 * (variance[3:].sum() * arm + variance[:3].sum() / straight.length[0]))


def _hanging(robot: Robot, rotation: Array, straight: StraightCables) -> Array:
    """Return the wrench of the cables' own weight on the platform, across their chords, (6,)."""
    unit = -straight.direction[0]
    down = np.array([0.0, 0.0, -1.0])
    across = down - unit * (unit @ down)[:, None]
    force = 0.5 * (robot.weight_per_length * straight.length[0])[:, None] * across
    arm = robot.anchor_points @ rotation.T
    return np.concatenate([force.sum(axis=0), np.cross(arm, force).sum(axis=0)])


def _weight(robot: Robot, state: KsEkfState) -> Array:
    """Return the wrench of the cables about the origin at rest, in W, shape (6,)."""
    force = np.array([0.0, 0.0, robot.weight])
    arm = state.rotation @ (robot.center_of_mass + state.center)
    return np.concatenate([force, np.cross(arm, force)])


def _wrench(robot: Robot, state: KsEkfState, turning: Array, settings: FilterSettings) -> Array:
    """Return the wrench of the cables about the origin in motion, in W, shape (6,)."""
    rate, force = state.samples.at(state.time)
    spin = rate - state.rate_bias
    center = robot.center_of_mass + state.center
    arm = center - settings.imu_position
    around = cross_matrix(spin)
    at_center = force - state.force_bias + cross_matrix(turning) @ arm + around @ around @ arm
    push = robot.mass * at_center
    moment = robot.inertia @ turning + around @ robot.inertia @ spin + cross_matrix(center) @ push
    return np.concatenate([state.rotation @ push, state.rotation @ moment])
