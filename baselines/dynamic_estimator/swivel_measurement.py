"""Measurement model of swivel angles: where cables leave their pulleys to.

The angle expected is that of the cable as the dynamics have it. Its change with an error is that of
a straight cable: sag is in the plane of an upright axis, and moves with the cable.
"""

from __future__ import annotations

import numpy as np

from baselines.dynamic_estimator.filter_state import DynamicFilterState
from baselines.dynamic_estimator.measurement_models import LinearisedMeasurement
from baselines.dynamic_estimator.settings import DynamicEstimatorSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.rotations import wrapped_angle
from carosac_toolkit.physics.cable.swivel import swivel_angle, swivel_slope
from carosac_toolkit.robot.robot import Robot


def measured_swivels(
    robot: Robot, state: DynamicFilterState, angle: Array, settings: DynamicEstimatorSettings
) -> LinearisedMeasurement:
    """Linearise swivel angles that were measured at the time of a state.

    Args:
        robot: The nominal one.
        state: The estimate.
        angle: As measured [rad], shape (n,); cables without a pulley are left out.
        settings: Noise of the angles, and of lengths that stretch.
    """
    where, pulleys = state.errors, np.flatnonzero(robot.pulley_radius > 0.0)
    arm = robot.anchor_points @ state.rotation.T
    slope = swivel_slope(robot, (state.position + arm - robot.exit_points)[None])[0]
    by_pose = np.hstack([slope, np.cross(arm, slope)])[pulleys]
    by = by_pose @ state.pose_by()
    by[:, where.swivels] = np.eye(where.n)[pulleys]
    expected = swivel_angle(robot, -state.exit_tension[None])[0] + state.swivel_offset
    stretched = settings.stretch_deviation * by_pose @ state.sway.slaved
    return LinearisedMeasurement(
        residual=wrapped_angle(angle - expected)[pulleys],
        by=by,
        noise=settings.swivel_noise**2 * np.eye(len(pulleys)) + stretched @ stretched.T,
        by_pose=by_pose,
    )
