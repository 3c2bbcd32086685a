"""Self-calibration without motion capture: motor angles, and a few positions that are known."""

from calibration.self_calibration.calibrate import calibrate_motor_angles
from calibration.self_calibration.motor_angle_files import (
    holds_motor_angles,
    load_motor_angles,
    write_motor_angles,
)
from calibration.self_calibration.motor_angles import MotorAngles
from calibration.self_calibration.result import LeftOut, SampleBlunder, SelfCalibration
from calibration.self_calibration.settings import SelfCalibrationSettings

__all__ = [
    "LeftOut",
    "MotorAngles",
    "SampleBlunder",
    "SelfCalibration",
    "SelfCalibrationSettings",
    "calibrate_motor_angles",
    "holds_motor_angles",
    "load_motor_angles",
    "write_motor_angles",
]
