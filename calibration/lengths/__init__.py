"""Calibration from cable lengths with measured poses."""

from calibration.lengths.calibrate import calibrate_lengths
from calibration.lengths.checks import MixUp
from calibration.lengths.planning import SuggestedPoses, suggest_poses
from calibration.lengths.result import LengthCalibration
from calibration.lengths.settings import LengthSettings

__all__ = [
    "LengthCalibration",
    "LengthSettings",
    "MixUp",
    "SuggestedPoses",
    "calibrate_lengths",
    "suggest_poses",
]
