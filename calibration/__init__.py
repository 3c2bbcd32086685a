"""Calibration and identification: tachymeter, cable lengths, motor angles, dynamics.

The names below are the public face; each is imported when it is first used, so that
``import calibration`` stays light.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from carosac_toolkit.base.lazy import lazy_names

if TYPE_CHECKING:
    from calibration.estimate import ParameterEstimate
    from calibration.identification.frequencies import FrequencyTable, load_frequencies
    from calibration.identification.procedure import identify, identify_runs
    from calibration.identification.result import Identification
    from calibration.identification.settings import IdentificationSettings
    from calibration.identification.synthetic import RunSettings, SyntheticRun, simulate_run
    from calibration.identification.synthetic_oscillations import (
        OscillationSettings,
        simulate_oscillations,
    )
    from calibration.lengths.calibrate import calibrate_lengths
    from calibration.lengths.checks import MixUp
    from calibration.lengths.planning import SuggestedPoses, suggest_poses
    from calibration.lengths.result import LengthCalibration
    from calibration.lengths.settings import LengthSettings
    from calibration.lengths.synthetic import LengthScene, LengthSceneSettings, draw_length_scene
    from calibration.observability import Observability, Unobservable
    from calibration.prior import Prior
    from calibration.rests.calibrate import calibrate_rests
    from calibration.rests.result import RestCalibration
    from calibration.rests.sensors import SensorCalibration, calibrate_sensors
    from calibration.rests.settings import RestSettings
    from calibration.rests.synthetic import RestScene, RestSceneSettings, draw_rest_scene
    from calibration.result import CalibrationResult
    from calibration.robot_update import updated, write_robot
    from calibration.self_calibration.calibrate import calibrate_motor_angles
    from calibration.self_calibration.knowledge import Knowledge
    from calibration.self_calibration.motor_angle_files import (
        holds_motor_angles,
        load_motor_angles,
        write_motor_angles,
    )
    from calibration.self_calibration.motor_angles import MotorAngles
    from calibration.self_calibration.result import LeftOut, SampleBlunder, SelfCalibration
    from calibration.self_calibration.settings import Distance, SelfCalibrationSettings
    from calibration.self_calibration.suggested_positions import (
        Reach,
        SuggestedPositions,
        suggest_positions,
    )
    from calibration.self_calibration.synthetic import (
        MeasurementNoise,
        draw_positions,
        draw_robot,
        measure_motor_angles,
    )
    from calibration.sensor_errors import SensorError
    from calibration.tachymeter.calibrate import calibrate_tachymeter
    from calibration.tachymeter.observations import (
        Instrument,
        ReferencePoint,
        Shot,
        Sighting,
        Survey,
    )
    from calibration.tachymeter.result import ReadingBlunder, TachymeterResult
    from calibration.tachymeter.survey_files import read_survey
    from calibration.tachymeter.synthetic import (
        DrawnSurvey,
        SurveyPlan,
        draw_survey,
        write_gsi,
        write_survey_csv,
        write_targets,
    )

__carosac__ = True  # marks this package as ours: the name is not unique

_MODULES = {
    "CalibrationResult": "result",
    "Distance": "self_calibration.settings",
    "DrawnSurvey": "tachymeter.synthetic",
    "FrequencyTable": "identification.frequencies",
    "Identification": "identification.result",
    "IdentificationSettings": "identification.settings",
    "Instrument": "tachymeter.observations",
    "Knowledge": "self_calibration.knowledge",
    "LeftOut": "self_calibration.result",
    "LengthCalibration": "lengths.result",
    "LengthScene": "lengths.synthetic",
    "LengthSceneSettings": "lengths.synthetic",
    "LengthSettings": "lengths.settings",
    "MeasurementNoise": "self_calibration.synthetic",
    "MixUp": "lengths.checks",
    "MotorAngles": "self_calibration.motor_angles",
    "Observability": "observability",
    "OscillationSettings": "identification.synthetic_oscillations",
    "ParameterEstimate": "estimate",
    "Prior": "prior",
    "Reach": "self_calibration.suggested_positions",
    "ReadingBlunder": "tachymeter.result",
    "ReferencePoint": "tachymeter.observations",
    "RestCalibration": "rests.result",
    "RestScene": "rests.synthetic",
    "RestSceneSettings": "rests.synthetic",
    "RestSettings": "rests.settings",
    "RunSettings": "identification.synthetic",
    "SampleBlunder": "self_calibration.result",
    "SelfCalibration": "self_calibration.result",
    "SelfCalibrationSettings": "self_calibration.settings",
    "SensorCalibration": "rests.sensors",
    "SensorError": "sensor_errors",
    "Shot": "tachymeter.observations",
    "Sighting": "tachymeter.observations",
    "SuggestedPoses": "lengths.planning",
    "SuggestedPositions": "self_calibration.suggested_positions",
    "Survey": "tachymeter.observations",
    "SurveyPlan": "tachymeter.synthetic",
    "SyntheticRun": "identification.synthetic",
    "TachymeterResult": "tachymeter.result",
    "Unobservable": "observability",
    "calibrate_lengths": "lengths.calibrate",
    "calibrate_motor_angles": "self_calibration.calibrate",
    "calibrate_rests": "rests.calibrate",
    "calibrate_sensors": "rests.sensors",
    "calibrate_tachymeter": "tachymeter.calibrate",
    "draw_length_scene": "lengths.synthetic",
    "draw_positions": "self_calibration.synthetic",
    "draw_rest_scene": "rests.synthetic",
    "draw_robot": "self_calibration.synthetic",
    "draw_survey": "tachymeter.synthetic",
    "holds_motor_angles": "self_calibration.motor_angle_files",
    "identify": "identification.procedure",
    "identify_runs": "identification.procedure",
    "load_frequencies": "identification.frequencies",
    "load_motor_angles": "self_calibration.motor_angle_files",
    "measure_motor_angles": "self_calibration.synthetic",
    "read_survey": "tachymeter.survey_files",
    "simulate_oscillations": "identification.synthetic_oscillations",
    "simulate_run": "identification.synthetic",
    "suggest_poses": "lengths.planning",
    "suggest_positions": "self_calibration.suggested_positions",
    "updated": "robot_update",
    "write_gsi": "tachymeter.synthetic",
    "write_motor_angles": "self_calibration.motor_angle_files",
    "write_robot": "robot_update",
    "write_survey_csv": "tachymeter.synthetic",
    "write_targets": "tachymeter.synthetic",
}
__all__ = [
    "CalibrationResult",
    "Distance",
    "DrawnSurvey",
    "FrequencyTable",
    "Identification",
    "IdentificationSettings",
    "Instrument",
    "Knowledge",
    "LeftOut",
    "LengthCalibration",
    "LengthScene",
    "LengthSceneSettings",
    "LengthSettings",
    "MeasurementNoise",
    "MixUp",
    "MotorAngles",
    "Observability",
    "OscillationSettings",
    "ParameterEstimate",
    "Prior",
    "Reach",
    "ReadingBlunder",
    "ReferencePoint",
    "RestCalibration",
    "RestScene",
    "RestSceneSettings",
    "RestSettings",
    "RunSettings",
    "SampleBlunder",
    "SelfCalibration",
    "SelfCalibrationSettings",
    "SensorCalibration",
    "SensorError",
    "Shot",
    "Sighting",
    "SuggestedPoses",
    "SuggestedPositions",
    "Survey",
    "SurveyPlan",
    "SyntheticRun",
    "TachymeterResult",
    "Unobservable",
    "calibrate_lengths",
    "calibrate_motor_angles",
    "calibrate_rests",
    "calibrate_sensors",
    "calibrate_tachymeter",
    "draw_length_scene",
    "draw_positions",
    "draw_rest_scene",
    "draw_robot",
    "draw_survey",
    "holds_motor_angles",
    "identify",
    "identify_runs",
    "load_frequencies",
    "load_motor_angles",
    "measure_motor_angles",
    "read_survey",
    "simulate_oscillations",
    "simulate_run",
    "suggest_poses",
    "suggest_positions",
    "updated",
    "write_gsi",
    "write_motor_angles",
    "write_robot",
    "write_survey_csv",
    "write_targets",
]

__getattr__, __dir__ = lazy_names(__name__, _MODULES)
