"""Calibration from cable lengths with measured poses."""

from calibration.lengths.calibrate import calibrate
from calibration.lengths.checks import MixUp
from calibration.lengths.planning import SuggestedPoses, suggest_poses
from calibration.lengths.result import LengthCalibration
from calibration.lengths.settings import Settings

__all__ = [
    "LengthCalibration",
    "MixUp",
    "Settings",
    "SuggestedPoses",
    "calibrate",
    "suggest_poses",
]
