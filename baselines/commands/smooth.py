"""Smooth a recording: the best estimate of pose and twist, afterwards.

The platform's dynamics are driven by the recorded lengths; measurements count both before and after
their time. Inertial samples are used where there are any. Measured poses are withheld, and the
estimate is scored on them, unless --poses says otherwise. Writes a recording with the smoothed
poses, a table with all estimates, and two pictures.

Exit status 1 means that the passes did not converge (the estimate is the last one), or that the
robot does not belong to the recording.
"""

from __future__ import annotations

import os
import re
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro

from baselines.smoother import Smoothed, SmootherSettings, smooth
from baselines.smoother.output import REPORT_FILES, recording_of, write
from baselines.smoother.report import sentences, warnings
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.files import check_writable
from carosac_toolkit.base.tables import terminal_width, wrapped
from carosac_toolkit.cli.common import CommandResult, CommonOptions, OutputFile
from carosac_toolkit.cli.outputs import same_file
from carosac_toolkit.recordings.bundled import find_recording
from carosac_toolkit.recordings.files import load_recording, save_recording
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.recordings.robot import FoundRobot, find_robot
from carosac_toolkit.reports.page import check_folder
from carosac_toolkit.robot.bundled_names import list_robots

RECORDING_SUFFIXES = (".parquet", ".csv")
SMOOTHED_FILE = "smoothed.parquet"
DYNAMICS_OPTIONS = (  # as options
    "mass", "center_of_mass", "length_bias", "length_bias_walk", "delay", "wind_force",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Options(CommonOptions):
    """Options of ``carosac smooth``."""

    recording: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RECORDING")]
    """A bundled recording such as `synthetic`, or a .parquet, .csv or .mat file."""
    robot: str | None = None
    """A bundled robot or a YAML file, best one that was calibrated; by default the one that the
    recording names, or else the bundled one with the exit points measured in it."""
    poses: Literal["withheld", "half", "used"] = "withheld"
    """Use of the measured poses: `withheld` scores the estimate on all of them, `half` uses every
    second one and scores on the others, each at its own time, `used` uses all."""
    imu: bool = True
    """Use inertial samples, where the recording has them."""
    angles: bool = True
    """Use swivel angles, and with --mounting an AHRS or inclinometer, where the recording has
    them."""
    mounting: tuple[float, float, float] | None = None
    """Rotation vector from the axes of the AHRS or inclinometer to those of the platform [rad], to
    2 degrees; without it neither is used."""
    lag: float | None = None
    """Use only measurements up to so many seconds later; by default the whole recording."""
    start: int = 0
    """First sample to score; the estimate still uses all."""
    stop: int | None = None
    """One past the last sample to score; by default all are scored."""
    mass: float | None = None
    """Standard deviation of the mass, relative to the mass. By default this and the next options
    are those of the condition nominal-1, which are far too wide for an identified robot."""
    center_of_mass: float | None = None
    """Standard deviation of the centre of mass, per axis [m]."""
    length_bias: float | None = None
    """Standard deviation of the error of a cable's length readings at the start [m]."""
    length_bias_walk: float | None = None
    """Standard deviation of the change of that error in a second [m]."""
    delay: float | None = None
    """Time by which lengths lead poses and inertial samples [s]; by default that of the robot file;
    without one it is estimated."""
    wind_force: float | None = None
    """Standard deviation of the wind, or of any other unknown push, per horizontal axis [N]."""
    output: OutputFile = None
    """Write the smoothed recording to this .parquet or .csv file; never over the old one. By
    default it goes beside the pictures."""
    report: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for table and pictures; by default one in carosac-results/smooth. Nothing there may
    be the recording itself."""


def run(options: Options) -> CommandResult:
    """Smooth one recording."""
    settings = _settings(options)
    path = find_recording(options.recording)
    check_writable("--output", options.output, RECORDING_SUFFIXES)
    recording = load_recording(path)
    _check_mounting(options, recording)
    origin = find_robot(recording, path, options.robot)
    folder = options.report or _default_folder(path, origin, options.poses)
    check_folder("--report", folder)
    output = options.output or folder / SMOOTHED_FILE
    _check_targets(options, folder, {"RECORDING": path, "--robot": Path(origin.name)})
    result = smooth(
        recording, origin.robot, settings,
        start=options.start, stop=options.stop, report=_progress,
    )  # fmt: skip
    print()
    for line in [*_head(options, origin, result), *sentences(result)]:
        print(wrapped(line, terminal_width(), "* "))
    source = f"carosac smooth, poses {options.poses}, of {Path(options.recording).name}"
    named = _named(origin, output.parent)
    smoothed = recording_of(result, recording, origin.robot, source, named)
    files = write(folder, result)
    save_recording(smoothed, output)
    print(f"\nsmoothed recording: {output}\ntable and pictures: {files[0].parent}")
    sys.stdout.flush()
    for line in warnings(result):
        print(f"carosac: warning: {line}", file=sys.stderr)
    data = {"recording": options.recording, "robot": origin.name, "robot_source": origin.source}
    return CommandResult(
        data | result.data() | {"output": output},
        status=0 if result.converged and not result.misfits else 1,
    )


def _named(origin: FoundRobot, folder: Path) -> str | None:
    """Return the name or path by which a recording in a folder finds its robot, or None."""
    if origin.source == "exit points":
        return None
    if origin.name in list_robots():
        return origin.name
    return Path(os.path.relpath(Path(origin.name).resolve(), folder.resolve())).as_posix()


def _check_targets(options: Options, folder: Path, inputs: dict[str, Path]) -> None:
    """Refuse to write over what is read, or two things to one path.

    Args:
        options: What was asked for.
        folder: Of table and pictures, and of the recording unless it goes elsewhere.
        inputs: Paths by the option that gave them; a name of something bundled is no file.

    Raises:
        InvalidField: A target is an input or another target, maybe through a link.
    """
    in_folder = [*REPORT_FILES, *([SMOOTHED_FILE] if options.output is None else [])]
    targets = [("--report", folder / name) for name in in_folder]
    options_with_paths = (("--output", options.output), ("--json", options.json))
    targets += [(option, path) for option, path in options_with_paths if path is not None]
    for k, (option, target) in enumerate(targets):
        for other, path in inputs.items():
            if path.exists() and same_file(target, path):
                allowed = f"another place; {other} is read from this file"
                raise InvalidField(option, f"'{target}'", allowed)
        for other, path in targets[:k]:
            if same_file(target, path):
                allowed = f"another path; {other} writes '{path}'"
                raise InvalidField(option, f"'{target}'", allowed)


def _check_mounting(options: Options, recording: Recording) -> None:
    """Refuse a mounting of a sensor that is not there, or not to be used."""
    if options.mounting is None:
        return
    stated = " ".join(f"{value:g}" for value in options.mounting)
    if not options.angles:
        raise InvalidField("--mounting", stated, "nothing with --no-angles")
    if recording.attitude is None and recording.inclination is None:
        allowed = "nothing: the recording has no attitude or inclination"
        raise InvalidField("--mounting", stated, allowed)


def _settings(options: Options) -> SmootherSettings:
    """Return the default settings with the changes that were asked for."""
    usual = SmootherSettings()
    asked = {name: getattr(options, name) for name in DYNAMICS_OPTIONS}
    dynamics = replace(
        usual.dynamics, attitude_rotation=options.mounting,
        **{name: value for name, value in asked.items() if value is not None},
    )  # fmt: skip
    return replace(
        usual, poses=options.poses, imu=options.imu, angles=options.angles, lag=options.lag,
        dynamics=dynamics,
    )  # fmt: skip


def _progress(passes: int, change: float) -> None:
    """Print the largest change of a pass."""
    if passes == 1:
        print("largest change of a position after each pass:")
    print(f"  {passes:2d}: {change * 1e3:8.2f} mm", flush=True)


def _head(options: Options, origin: FoundRobot, result: Smoothed) -> list[str]:
    """Return lines that name the recording and its robot."""
    recording = result.recording
    guess = " (a guess from the exit points)" if origin.source == "exit points" else ""
    return [
        f"{options.recording}: {len(recording.time)} samples, {recording.duration:.1f} s; "
        f"robot {origin.robot.name}{guess}"
    ]


def _default_folder(path: Path, origin: FoundRobot, poses: str) -> Path:
    """Return the folder for output that was not sent anywhere."""
    parts = [path.stem, origin.robot.name, *([] if poses == "withheld" else [poses])]
    name = re.sub(r"[^\w.-]+", "_", "-".join(parts))
    return Path("carosac-results") / "smooth" / name
