"""The platform's origin, where the state is that of the IMU: maps both ways, and the belief."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from baselines.ks_ekf.filter_settings import FilterSettings
from baselines.ks_ekf.filter_state import (
    POSE_ERRORS,
    POSITION_ERRORS,
    RATE_BIAS_ERRORS,
    ROTATION_ERRORS,
    VELOCITY_ERRORS,
    KsEkfState,
)
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import cross_matrix


def origin(state: KsEkfState, lever: Array) -> Array:
    """Return the platform origin in W [m], shape (3,), for an IMU at `lever` in P [m]."""
    return state.position - state.rotation @ lever


def pose_map(state: KsEkfState, lever: Array) -> Array:
    """Return the pose error [dp; dtheta] per error of the state, shape (6, 18 + n)."""
    matrix = np.zeros((6, len(state.covariance)))
    matrix[:, POSE_ERRORS] = np.eye(6)
    matrix[:3, ROTATION_ERRORS] = cross_matrix(state.rotation @ lever)
    return matrix


def carried(state: KsEkfState, settings: FilterSettings) -> tuple[Array, Array]:
    """Return the twist of the origin, and the covariance of pose and twist, with an IMU.

    Args:
        state: At the time of its newest sample, or after it.
        settings: Where the IMU is, and its noise.

    Returns:
        Linear and angular velocity in W, shape (6,); covariance as in `Belief`, shape (12, 12).
    """
    arm = state.rotation @ settings.imu_position
    rate = state.rotation @ (state.samples.at(state.time)[0] - state.rate_bias)
    twist = np.concatenate([state.velocity - np.cross(rate, arm), rate])
    matrix = np.zeros((12, len(state.covariance)))
    matrix[:6] = pose_map(state, settings.imu_position)
    matrix[9:, ROTATION_ERRORS] = -cross_matrix(rate)
    matrix[9:, RATE_BIAS_ERRORS] = -state.rotation
    matrix[6:9] = cross_matrix(arm) @ matrix[9:]
    matrix[6:9, VELOCITY_ERRORS] += np.eye(3)
    matrix[6:9, ROTATION_ERRORS] += cross_matrix(rate) @ cross_matrix(arm)
    held = max(state.time - float(state.samples.time[-1]), 0.0)
    noise = np.zeros((12, 3))
    noise[9:] = np.hypot(settings.angular_rate_noise, held * settings.rate_change) * np.eye(3)
    noise[6:9] = cross_matrix(arm) @ noise[9:]
    covariance = matrix @ state.covariance @ matrix.T + noise @ noise.T
    return twist, 0.5 * (covariance + covariance.T)


def at_rest(state: KsEkfState) -> tuple[Array, Array]:
    """Return twist and covariance of a state at the origin that no inertial samples carry."""
    covariance = np.zeros((12, 12))
    covariance[:6, :6] = state.covariance[POSE_ERRORS, POSE_ERRORS]
    covariance[6:, 6:] = state.twist_covariance
    return state.twist, covariance


def moved_to_imu(state: KsEkfState, rate: Array, lever: Array) -> KsEkfState:
    """Move a state from the platform's origin to the IMU, turning at `rate` in W [rad/s]."""
    arm = state.rotation @ lever
    matrix = np.eye(len(state.covariance))
    matrix[POSITION_ERRORS, ROTATION_ERRORS] = -cross_matrix(arm)
    matrix[VELOCITY_ERRORS, ROTATION_ERRORS] = -cross_matrix(rate) @ cross_matrix(arm)
    return replace(
        state,
        position=state.position + arm,
        velocity=state.velocity + np.cross(rate, arm),
        covariance=matrix @ state.covariance @ matrix.T,
    )
