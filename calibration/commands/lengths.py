"""Calibrate points, encoders and delay from cable lengths and poses.

The points are exit and anchor points, the poses measured ones, such as by motion capture. Blunders
are left out and named. Set-ups that cannot tell the exit points are refused with the reason, as are
swapped cables and wrong units. A file of motor angles (CSV, columns motor_A_deg and the like) needs
no poses: they are unknowns there, and so are the drums. A few known positions give the frame; with
none it is one of convention, and the scale comes from --distance, the lengths at home and the
drums. Nor does a recording of rests, with load
cells, an AHRS or swivel angles: it gives the zeros of lengths that may be relative, and all poses.

Exit status 1 means that the result should not be used before a warning has been looked into.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from calibration.lengths.calibrate import calibrate_lengths
from calibration.lengths.planning import SUGGESTED_POSES_MAX, SuggestedPoses, suggest_poses
from calibration.lengths.report import (
    CABLE_GROUPS,
    CABLE_HEADER,
    POSE_GROUPS,
    POSE_HEADER,
    cable_rows,
    pose_rows,
    report_content,
)
from calibration.lengths.result import LengthCalibration
from calibration.lengths.settings import LengthSettings
from calibration.observability import Unobservable
from calibration.report import (
    option_words,
    print_parameters,
    print_sentences,
    write_new_robot,
    write_report,
)
from calibration.rests.sensors import SensorCalibration, calibrate_sensors
from calibration.rests.settings import RestSettings
from calibration.robot_update import check_output
from calibration.self_calibration.motor_angle_files import holds_motor_angles
from calibration.self_calibration.settings import SelfCalibrationSettings
from calibration.sensor_errors import print_sensors, sensor_data
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.tables import fit, terminal_width
from carosac_toolkit.cli.common import CommandResult, CommonOptions, OutputFile, OutputFolder
from carosac_toolkit.recordings.bundled import find_recording
from carosac_toolkit.recordings.files import load_recording
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.recordings.robot import find_robot
from carosac_toolkit.reports.page import check_folder
from carosac_toolkit.robot.robot import Robot

MOTOR_ANGLE_OPTIONS = (
    "recording",
    "robot",
    "output",
    "report",
    "json",
    "seed",
    "distance",
    "x_through",
    "accuracy",
    "keeps_rotation",
    "home_length_prior",
    "radius_prior",
)  # options that count
MOTOR_ANGLE_ONLY_OPTIONS = MOTOR_ANGLE_OPTIONS[6:]
REST_OPTIONS = (
    *MOTOR_ANGLE_OPTIONS[:6], "start", "stop", "length_noise", "offset_prior",
    "tension_noise", "attitude_noise", "swivel_noise",
)  # fmt: skip
SENSOR_OPTIONS = {  # channels of which they are, and how to call these
    "tension_noise": (("tension",), "load cells"),
    "attitude_noise": (("attitude", "inclination"), "an AHRS or inclinometer"),
    "swivel_noise": (("swivel_angle",), "swivel angles"),
}
WEAK_SENTENCES_MAX = 8  # on what is hardly known, on the screen; the report has all


@dataclass(frozen=True, kw_only=True)
class Options(CommonOptions):
    """Options of ``carosac calibrate lengths``."""

    recording: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RECORDING")]
    """A bundled recording, a .parquet, .csv or .mat file with measured poses or of rests, or a CSV
    of motor angles."""
    robot: str | None = None
    """A bundled robot or a YAML file; by default the one that the recording names, or else the
    bundled one with the exit points measured in it."""
    output: OutputFile = None
    """The new robot file; never the old one."""
    report: OutputFolder = None
    """Folder for report.html and pictures; an earlier report in it is replaced."""
    start: int = 0
    """First sample to use."""
    stop: int | None = None
    """One past the last sample to use; by default all are used."""
    suggest_poses: int = 0
    """Number of further poses to suggest, those that would teach most about the exit points."""
    distance: Annotated[
        tuple[tuple[str, str, float, float], ...], tyro.conf.arg(metavar="A B LENGTH SIGMA")
    ] = ()
    """Motor angles: measured distances between exit points, by cable, or from one to home, with
    their standard deviations [m], such as a b 2.481 0.001 c home 1.9 0.002."""
    x_through: str | None = None
    """Motor angles without known positions: cable whose exit point is above or below the x axis; by
    default the exit points of the robot file tell the heading."""
    accuracy: float | None = None
    """Motor angles: wanted standard deviation of the exit points [m], by default 1 % of the longest
    cable; a warning says if it is not reached."""
    keeps_rotation: bool = False
    """Motor angles, six cables or fewer: the platform is built to keep its rotation, though its
    cables end apart from each other."""
    home_length_prior: float = SelfCalibrationSettings.length_at_zero_sigma
    """Motor angles: standard deviation of the lengths at home in the robot file [m]."""
    radius_prior: float = SelfCalibrationSettings.drum_radius_sigma
    """Motor angles: standard deviation of the drums' radius in the robot file [m]."""
    length_noise: float | None = None
    """Standard deviation of a reading [m]; by default estimated from what the fit leaves, and
    0.5 mm for rests without poses."""
    tension_noise: float = RestSettings.tension_noise
    """Standard deviation of a load cell at a rest, as a share of its reading."""
    attitude_noise: float = RestSettings.attitude_noise
    """Standard deviation of an AHRS or inclinometer at a rest, per axis [rad]."""
    swivel_noise: float = RestSettings.swivel_noise
    """Standard deviation of a swivel angle at a rest [rad]."""
    position_noise: float = LengthSettings.position_noise
    """Standard deviation of a measured position, per axis [m]."""
    rotation_noise: float = LengthSettings.rotation_noise
    """Standard deviation of a measured orientation, per axis [rad]."""
    exit_prior: float = LengthSettings.exit_prior
    """Prior standard deviation of the exit points, per axis [m]; covariances in the robot file
    come first. 0 holds the value, as with all priors."""
    anchor_prior: float = LengthSettings.anchor_prior
    """Prior standard deviation of the anchor points, per axis [m]."""
    offset_prior: float = LengthSettings.offset_prior
    """Prior standard deviation of the readings' zeros [m]; without effect on relative readings."""
    scale_prior: float = LengthSettings.scale_prior
    """Prior standard deviation of the readings' scales [1]."""
    delay_prior: float = LengthSettings.delay_prior
    """Prior standard deviation of the delay between readings and poses [s]."""
    tilt_prior: float = LengthSettings.tilt_prior
    """Prior standard deviation of the tilt of the poses' frame [rad]."""
    center_prior: float = LengthSettings.center_prior
    """Prior standard deviation of the centre of mass, per axis [m]; fewer than 6 cables only."""


def run(options: Options) -> CommandResult:
    """Calibrate from one recording."""
    path = find_recording(options.recording)
    if holds_motor_angles(path):
        from calibration.self_calibration.command import run_motor_angles

        _check_options(options, MOTOR_ANGLE_OPTIONS, "not with a file of motor angles")
        return run_motor_angles(options, path)
    if not 0 <= options.suggest_poses <= SUGGESTED_POSES_MAX:
        raise InvalidField("--suggest-poses", options.suggest_poses, f"0 to {SUGGESTED_POSES_MAX}")
    recording = load_recording(path)
    _check_sensor_options(options, recording)
    if recording.poses is None:
        from calibration.rests.command import run_rests

        _check_options(options, REST_OPTIONS, "not with a recording without poses")
        return run_rests(options, _rest_settings(options), recording, path)
    others = [name for name in vars(options) if name not in MOTOR_ANGLE_ONLY_OPTIONS]
    _check_options(options, others, "not with a recording with poses")
    settings = _settings(options)
    sensor_settings = RestSettings(**{name: getattr(options, name) for name in SENSOR_OPTIONS})
    robot_source = find_robot(recording, path, options.robot)
    check_output("--output", options.output, robot_source.name)
    if options.report is not None:
        check_folder("--report", options.report)
    try:
        result = calibrate_lengths(
            recording, robot_source.robot, settings=settings, start=options.start, stop=options.stop
        )
    except Unobservable:
        _print_suggested(_suggested(options, settings, robot_source.robot))
        raise
    sensors = calibrate_sensors(
        recording.slice(options.start, options.stop), result.level, settings=sensor_settings,
        rotation_noise=settings.rotation_noise,
    )  # fmt: skip
    suggested = _suggested(options, settings, result)
    print_sentences(
        [
            f"{options.recording}: {len(result.sample)} samples over {np.ptp(result.time):.1f} s; "
            f"robot {robot_source.name}"
        ],
        "",
    )
    _print(result, suggested, sensors)
    _write(options, result, suggested, sensors, robot_source.name)
    data = {
        "robot": robot_source.name,
        **result.data(),
        "sensors": sensor_data(sensors.errors),
        "warnings": [*result.warnings, *sensors.warnings],
        "suggested_poses": suggested.data() if suggested is not None else [],
    }
    return CommandResult(data, status=1 if data["warnings"] else 0)


def _check_options(options: Options, allowed: Sequence[str], where: str) -> None:
    """Refuse options that are without effect with such a file."""
    for name, default in vars(Options(recording="")).items():
        value = getattr(options, name)
        if name not in allowed and value != default:
            raise InvalidField(
                f"--{name.replace('_', '-')}", value, f"{where}, where it has no effect"
            )


def _check_sensor_options(options: Options, recording: Recording) -> None:
    """Refuse the noise of a sensor that a recording does not have."""
    for option, (channels, label) in SENSOR_OPTIONS.items():
        if all(getattr(recording, channel) is None for channel in channels):
            value = getattr(options, option)
            if value != getattr(RestSettings, option):
                allowed = f"only with {label}, and the recording has none"
                raise InvalidField(f"--{option.replace('_', '-')}", value, allowed)


def _rest_settings(options: Options) -> RestSettings:
    """Return the noise and priors for a recording without poses."""
    chosen = {name: getattr(options, name) for name in (*SENSOR_OPTIONS, "offset_prior")}
    if options.length_noise is not None:
        chosen["length_noise"] = options.length_noise
    return RestSettings(**chosen)


def _settings(options: Options) -> LengthSettings:
    """Return the noise and priors of the options."""
    return LengthSettings(**{name: getattr(options, name) for name in vars(LengthSettings())})


def _suggested(
    options: Options, settings: LengthSettings, result: LengthCalibration | Robot
) -> SuggestedPoses | None:
    """Return the further poses, if they were asked for."""
    if options.suggest_poses == 0:
        return None
    return suggest_poses(
        result, options.suggest_poses, settings=settings, rng=np.random.default_rng(options.seed)
    )


def _print(
    result: LengthCalibration, suggested: SuggestedPoses | None, sensors: SensorCalibration
) -> None:
    """Print warnings, tables and sentences within the width of the terminal."""
    width = max(80, shutil.get_terminal_size().columns)
    print_sentences([*result.warnings, *sensors.warnings], "WARNING: ")
    print("\n" + fit(CABLE_HEADER, cable_rows(result), CABLE_GROUPS, width), end="\n\n")
    print_sentences([*result.sentences(), *sensors.sentences])
    weak = [*result.observability.sentences(), *result.notes]
    print_sentences(weak[:WEAK_SENTENCES_MAX])
    if len(weak) > WEAK_SENTENCES_MAX:
        print_sentences(
            [f"and {len(weak) - WEAK_SENTENCES_MAX} more such sentences, in the report"]
        )
    print()
    print_parameters(result.estimate)
    print_sensors(sensors.errors)
    _print_suggested(suggested)


def _print_suggested(suggested: SuggestedPoses | None) -> None:
    """Print the table of further poses, if there are any."""
    if suggested is not None:
        print("\nposes to measure next, each the best one together with those above it:")
        print(fit(POSE_HEADER, pose_rows(suggested), POSE_GROUPS, terminal_width()))


def _write(
    options: Options, result: LengthCalibration, suggested: SuggestedPoses | None,
    sensors: SensorCalibration, robot: str,
) -> None:  # fmt: skip
    """Write robot file and report."""
    write_new_robot(
        result, robot, options.output, name=options.output.stem if options.output else None,
        provenance=(
            f"cable lengths and poses of {Path(options.recording).name} "
            f"({len(result.sample)} samples, residual {1e3 * result.residual_rms:.2f} mm RMS)"
        ),
    )  # fmt: skip
    if options.report is not None:
        write_report(
            options.report,
            f"Calibration of {result.robot.name} from {Path(options.recording).name}",
            result,
            report_content(result, suggested, sensors.errors),
            provenance={"recording": options.recording, "robot": robot},
            command=[
                "carosac", "calibrate", "lengths", options.recording, "--robot", robot,
                *option_words(options, ("recording", "robot", "json")),
            ],
        )  # fmt: skip
        print(f"report: {options.report / 'report.html'}")
