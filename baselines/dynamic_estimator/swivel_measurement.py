"""Measurement model of swivel angles: where cables leave their pulleys to.

Angles are those of straight cables to the platform where it is believed to be, and what sag turns
the pulleys by beside, which hardly changes with an error. A zero that nothing has told yet is what
the first reading makes of it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from baselines.dynamic_estimator.filter_state import DynamicFilterState
from baselines.dynamic_estimator.measurement_models import LinearisedMeasurement
from baselines.dynamic_estimator.settings import DynamicEstimatorSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import wrapped_angle
from carosac_toolkit.physics.cable.swivel import straight_swivel_angle, swivel_slope
from carosac_toolkit.robot.robot import Robot


def measured_swivels(
    robot: Robot, state: DynamicFilterState, angle: Array, settings: DynamicEstimatorSettings
) -> LinearisedMeasurement:
    """Linearise swivel angles that were measured at the time of a state.

    Args:
        robot: The nominal one.
        state: The estimate, which knows the zeros (`with_swivel_zeros`).
        angle: As measured [rad], shape (n,); cables without a pulley are left out.
        settings: Noise of the angles, and of lengths that stretch.
    """
    where, pulleys = state.errors, np.flatnonzero(robot.pulley_radius > 0.0)
    arm = robot.anchor_points @ state.rotation.T
    slope = swivel_slope(robot, (state.position + arm - robot.exit_points)[None])[0]
    by_pose = np.hstack([slope, np.cross(arm, slope)])[pulleys]
    by = by_pose @ state.pose_by()
    by[:, where.swivels] = np.eye(where.n)[pulleys]
    stretched = settings.stretch_deviation * by_pose @ state.sway.slaved
    off = wrapped_angle(angle - _without_zeros(robot, state) - state.swivel_offset)
    return LinearisedMeasurement(
        residual=off[pulleys],
        by=by,
        noise=settings.swivel_noise**2 * np.eye(len(pulleys)) + stretched @ stretched.T,
        by_pose=by_pose,
    )


def with_swivel_zeros(robot: Robot, state: DynamicFilterState, angle: Array) -> DynamicFilterState:
    """Return a state whose unknown zeros are those of a reading (n,) [rad] at its time."""
    zeros = wrapped_angle(angle - _without_zeros(robot, state))
    unknown = np.isnan(state.swivel_offset)
    return replace(state, swivel_offset=np.where(unknown, zeros, state.swivel_offset))


def _without_zeros(robot: Robot, state: DynamicFilterState) -> Array:
    """Return the angles that are expected of encoders with true zeros [rad], shape (n,)."""
    straight = straight_swivel_angle(robot, state.position[None], state.rotation[None])[0]
    return np.asarray(straight + state.swivel_sag)
