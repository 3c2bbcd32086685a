"""Start of the filter at a pose of rest, with what is not known about it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from baselines.ks_ekf.corrections import rest_noise
from baselines.ks_ekf.filter_settings import FilterSettings
from baselines.ks_ekf.filter_state import (
    CENTER_ERRORS,
    FIXED_ERROR_COUNT,
    FORCE_BIAS_ERRORS,
    LENGTH_ERRORS,
    NO_SAMPLES,
    POSE_ERRORS,
    RATE_BIAS_ERRORS,
    VELOCITY_ERRORS,
    KsEkfState,
)
from baselines.ks_ekf.platform_motion import moved_to_imu
from baselines.ks_ekf.rest_pose import RestPose
from baselines.ks_ekf.timed_lengths import TimedLengths
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot


def prior(robot: Robot, settings: FilterSettings) -> Array:
    """Return the variances of the errors before any measurement; pose and velocity unknown."""
    n = robot.n
    spread = np.zeros(FIXED_ERROR_COUNT + n)
    lost = settings.lost_position, settings.lost_rotation, settings.lost_speed
    spread[:9] = np.repeat(lost, 3)
    spread[RATE_BIAS_ERRORS] = settings.angular_rate_bias
    spread[FORCE_BIAS_ERRORS] = settings.specific_force_bias
    spread[CENTER_ERRORS] = settings.center_of_mass_prior
    spread[LENGTH_ERRORS] = settings.length_bias
    return np.asarray(spread**2)


def blank(robot: Robot, settings: FilterSettings, time: float) -> KsEkfState:
    """Return a state at home of which only the priors are known."""
    lost = np.repeat((settings.lost_speed, settings.lost_spin), 3)
    return KsEkfState(
        time=time,
        position=robot.home_position,
        rotation=robot.home_rotation,
        velocity=np.zeros(3),
        rate_bias=np.zeros(3),
        force_bias=np.zeros(3),
        center=np.zeros(3),
        length_bias=np.zeros(robot.n),
        covariance=np.diag(prior(robot, settings)),
        inertial=False,
        twist=np.zeros(6),
        twist_covariance=np.diag(lost**2),
        samples=NO_SAMPLES,
    )


def forgotten(robot: Robot, settings: FilterSettings, state: KsEkfState) -> KsEkfState:
    """Return an unknown state at the pose and with the samples of another one."""
    nothing, kept = blank(robot, settings, state.time), released(state, settings)
    return replace(nothing, position=kept.position, rotation=kept.rotation, samples=state.samples)


def doubted(robot: Robot, settings: FilterSettings, state: KsEkfState, factor: float) -> KsEkfState:
    """Return the state with larger deviations; constants are never worse than their priors."""
    first = prior(robot, settings)
    growth = np.full(len(first), factor)
    constant = slice(9, None)
    now = np.maximum(np.diag(state.covariance)[constant], 1e-300)
    growth[constant] = np.clip(np.sqrt(first[constant] / now), 1.0, factor)
    return replace(state, covariance=growth[:, None] * state.covariance * growth)


def placed(
    state: KsEkfState, rest: RestPose, reading: TimedLengths, sway: float, settings: FilterSettings
) -> KsEkfState:
    """Put a state at a pose of rest; biases and what is known of them stay.

    Args:
        state: Whatever it was.
        rest: At the lengths measured, without the biases that the state knows.
        reading: The lengths, at whose rates the pose moves from rest to rest.
        sway: About it, root mean square of the position [m].
        settings: Noise of the lengths.

    Returns:
        A state at the platform's origin, not inertial.
    """
    unknown = slice(9, None)
    known = state.covariance[unknown, unknown]
    size = len(state.covariance)
    effect = np.zeros((6, size - 9))
    effect[:, CENTER_ERRORS.start - 9 : CENTER_ERRORS.stop - 9] = rest.per_center
    effect[:, LENGTH_ERRORS.start - 9 :] = -rest.per_length
    energy = rest.energy(sway)
    least = rest_noise(settings)
    slow = np.repeat(np.square((settings.rest_speed_error, settings.rest_spin_error)), 3)
    noise = settings.length_noise**2 * rest.per_length @ rest.per_length.T
    covariance = np.zeros((size, size))
    covariance[unknown, unknown] = known
    covariance[POSE_ERRORS, unknown] = effect @ known
    covariance[unknown, POSE_ERRORS] = covariance[POSE_ERRORS, unknown].T
    covariance[POSE_ERRORS, POSE_ERRORS] = (
        effect @ known @ effect.T + energy * rest.softness + noise + least
    )
    twist_covariance = energy * rest.lightness + np.diag(slow)
    covariance[VELOCITY_ERRORS, VELOCITY_ERRORS] = twist_covariance[:3, :3]
    twist = rest.per_length @ reading.rates
    return replace(
        state,
        time=reading.time,
        position=rest.position,
        rotation=rest.rotation,
        velocity=twist[:3],
        covariance=0.5 * (covariance + covariance.T),
        inertial=False,
        twist=twist,
        twist_covariance=twist_covariance,
        solution=rest.solution,
    )


def lost(robot: Robot, settings: FilterSettings, state: KsEkfState, time: float) -> KsEkfState:
    """Return the state at the platform's origin, with pose and motion unknown."""
    nothing, state = blank(robot, settings, time), released(state, settings)
    covariance = nothing.covariance.copy()
    covariance[9:, 9:] = state.covariance[9:, 9:]
    return replace(
        state,
        time=time,
        velocity=nothing.velocity,
        covariance=covariance,
        twist=nothing.twist,
        twist_covariance=nothing.twist_covariance,
        samples=NO_SAMPLES,
        solution=None,
    )


def inertial(state: KsEkfState, settings: FilterSettings) -> KsEkfState:
    """Let inertial samples carry a state that sits at the platform's origin."""
    rate = state.rotation @ (state.samples.at(state.time)[0] - state.rate_bias)
    moved = moved_to_imu(state, rate, settings.imu_position)
    return replace(moved, inertial=True, samples=state.samples.after(state.time))


def released(state: KsEkfState, settings: FilterSettings) -> KsEkfState:
    """Return the state at the platform's origin, no longer carried by inertial samples."""
    if not state.inertial:
        return state
    rate = state.rotation @ (state.samples.at(state.time)[0] - state.rate_bias)
    return replace(moved_to_imu(state, rate, -settings.imu_position), inertial=False)
