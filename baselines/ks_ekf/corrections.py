"""Residual, Jacobian and noise of lengths, rest poses and stillness against a state."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from baselines.ks_ekf.cable_model import expected_lengths
from baselines.ks_ekf.cable_swing import CableSwing
from baselines.ks_ekf.filter_settings import FilterSettings
from baselines.ks_ekf.filter_state import (
    CENTER_ERRORS,
    FORCE_BIAS_ERRORS,
    LENGTH_ERRORS,
    RATE_BIAS_ERRORS,
    ROTATION_ERRORS,
    VELOCITY_ERRORS,
    KsEkfState,
)
from baselines.ks_ekf.platform_motion import origin, pose_map
from baselines.ks_ekf.rest_detection import RestMeans
from baselines.ks_ekf.rest_pose import RestPose
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import cross_matrix
from carosac_toolkit.robot.robot import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasurementResidual:
    """A measurement against a state.

    Attributes:
        residual: Measured minus expected, shape (m,).
        jacobian: Of the measurement per error of the state, shape (m, 18 + n).
        noise: Its covariance, shape (m, m).
        left_out: Channels that could not be used.
        tension: Of the cables [N], shape (n,), as far as it is known here.
        swing: Of the cables, as far as it is known here.
    """

    residual: Array
    jacobian: Array
    noise: Array
    left_out: int = 0
    tension: Array | None = None
    swing: CableSwing | None = None


def of_lengths(
    robot: Robot, state: KsEkfState, lengths: Array, turning: Array, swing: CableSwing,
    settings: FilterSettings,
) -> MeasurementResidual:  # fmt: skip
    """Compare lengths (n,) with a state; `turning` is angular acceleration in P [rad/s^2]."""
    expected = expected_lengths(robot, state, turning, swing, settings)
    use = expected.valid
    residual = (lengths - expected.length - state.length_bias)[use]
    return MeasurementResidual(
        residual=residual,
        jacobian=expected.jacobian[use],
        noise=np.diag(settings.length_noise**2 + expected.spread[use] ** 2),
        left_out=int((~use).sum()),
        tension=expected.tension,
        swing=expected.swing,
    )


def of_rest_pose(
    state: KsEkfState, rest: RestPose, noise: Array, settings: FilterSettings
) -> MeasurementResidual:
    """Compare a pose of rest of noise (6, 6) with a state, whose length errors it depends on."""
    import pinocchio

    turn = pinocchio.log3(rest.rotation @ state.rotation.T)
    shift = rest.position - origin(state, settings.imu_position)
    jacobian = pose_map(state, settings.imu_position)
    jacobian[:, CENTER_ERRORS] = -rest.per_center
    jacobian[:, LENGTH_ERRORS] = rest.per_length
    return MeasurementResidual(
        residual=np.concatenate([shift, turn]),
        jacobian=jacobian,
        noise=noise,
        tension=rest.tension,
    )


def rest_noise(settings: FilterSettings) -> Array:
    """Return the covariance of a pose of rest where the platform rests."""
    errors = settings.rest_position_error, settings.rest_rotation_error
    return np.diag(np.repeat(np.square(errors), 3))


def sway_noise(rest: RestPose, settings: FilterSettings) -> Array:
    """Return the covariance of a pose of rest about which the platform sways."""
    errors = settings.sway_position_error, settings.sway_rotation_error
    least = np.repeat(np.square(errors), 3)
    return rest.energy(settings.sway) * rest.softness + np.diag(least)


def of_stillness(
    state: KsEkfState, quiet: RestMeans, gravity: float, settings: FilterSettings
) -> MeasurementResidual:
    """Compare rest as the IMU sees it: no velocity, no angular rate, only gravity."""
    down = np.array([0.0, 0.0, -gravity])
    jacobian = np.zeros((9, len(state.covariance)))
    jacobian[:3, RATE_BIAS_ERRORS] = np.eye(3)
    jacobian[3:6, ROTATION_ERRORS] = -state.rotation.T @ cross_matrix(down)
    jacobian[3:6, FORCE_BIAS_ERRORS] = np.eye(3)
    jacobian[6:, VELOCITY_ERRORS] = np.eye(3)
    residual = np.concatenate(
        [
            quiet.rate - state.rate_bias,
            quiet.force + state.rotation.T @ down - state.force_bias,
            -state.velocity,
        ]
    )
    speed = settings.rest_lever * settings.rest_rate
    spread = np.repeat([settings.rest_rate, settings.rest_force, speed], 3)
    return MeasurementResidual(residual=residual, jacobian=jacobian, noise=np.diag(spread**2))


def without_worst(state: KsEkfState, evidence: MeasurementResidual) -> MeasurementResidual:
    """Return the residual without the channel that contradicts all others most."""
    spread = evidence.jacobian @ state.covariance @ evidence.jacobian.T + evidence.noise
    inverse = np.linalg.inv(spread)
    # Leaving channel i out lowers the normalised square by (S^-1 r)_i^2 / (S^-1)_ii.
    gain = (inverse @ evidence.residual) ** 2 / np.diag(inverse)
    keep = np.arange(len(gain)) != np.argmax(gain)
    return replace(
        evidence,
        residual=evidence.residual[keep],
        jacobian=evidence.jacobian[keep],
        noise=evidence.noise[np.ix_(keep, keep)],
        left_out=evidence.left_out + 1,
    )
