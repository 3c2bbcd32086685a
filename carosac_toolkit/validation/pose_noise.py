"""Noise of measured poses: as identified, or that of usual motion capture."""

from __future__ import annotations

from carosac_toolkit.base.scaled import resolved
from carosac_toolkit.drivers.sensors import SensorSettings
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot


def measured_pose_noise(robot: Robot) -> tuple[float, float]:
    """Return one standard deviation per axis of positions [m] and of rotations [rad]."""
    if robot.model_error is not None:
        return robot.model_error.position, robot.model_error.rotation
    usual = resolved(SensorSettings(), Scales(robot).ratios)
    return usual.position_noise, usual.rotation_noise
