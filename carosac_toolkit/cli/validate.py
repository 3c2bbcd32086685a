"""Run models open loop on a recording and score them against its measured poses.

Each model is an estimator. It gets the recorded cable lengths in order from the first sample, never
a measured pose. Prints errors at rest and in motion and what explains them, and writes pictures
and one self-contained report.html.

Exit status 1 means that a model failed altogether; the others are scored.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from carosac_toolkit.cli.common import CommandResult, CommonOptions
from carosac_toolkit.errors import InvalidField
from carosac_toolkit.recording import Recording, load_recording
from carosac_toolkit.recordings.bundled import find_recording
from carosac_toolkit.robot_file import list_robots, load_robot
from carosac_toolkit.validation import DEFAULT_MODELS, ValidationResult, validate
from carosac_toolkit.validation.findings import conclusions
from carosac_toolkit.validation.report import Context, check_folder, write_report
from carosac_toolkit.validation.tables import (
    CAUSE_HEADER,
    PART_HEADER,
    PART_UNITS,
    align,
    cause_rows,
    part_rows,
)

SCAMPI_NEAR = 0.01  # [m]: exit points nearer than this are those of scampi


@dataclass(frozen=True, kw_only=True)
class Options(CommonOptions):
    """Options of ``carosac validate``."""

    recording: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RECORDING")]
    """A bundled recording such as `synthetic_carosac`, or a .parquet, .csv or .mat file."""
    robot: str | None = None
    """A bundled robot or a YAML file; by default the one that the recording names."""
    models: tuple[str, ...] = DEFAULT_MODELS
    """Estimators by name, or `module:Class`."""
    start: int = 0
    """First sample to score; models still run from sample 0."""
    stop: int | None = None
    """One past the last sample to score; by default all are scored."""
    output: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for pictures and report; by default carosac-results/validate/RECORDING."""


def run(options: Options) -> CommandResult:
    """Validate models on one recording."""
    path = find_recording(options.recording)
    folder = options.output or Path("carosac-results") / "validate" / path.stem
    check_folder("--output", folder)
    recording = load_recording(path)
    robot_name = _robot_name(options.robot, recording)
    robot = load_robot(robot_name)
    start, stop = options.start, options.stop
    result = validate(recording, robot, options.models, start=start, stop=stop, seed=options.seed)
    said = conclusions(result)
    _print(options.recording, recording, result, said)
    context = Context(
        recording=options.recording, metadata=recording.metadata, words=_words(options, robot_name)
    )
    files = write_report(folder, result, said, context)
    print(f"\nreport: {folder / 'report.html'} and {len(files) - 1} pictures beside it")
    failed = [model for model in result.models.values() if model.scores is None]
    for model in failed:
        print(f"carosac: {model.name} failed: {model.reason}", file=sys.stderr)
    data = {"recording": options.recording, **result.data(), "conclusions": said}
    return CommandResult(data, status=1 if failed else 0)


def _robot_name(asked: str | None, recording: Recording) -> str:
    """Name or path of the robot: asked for, named by the recording, or known by its exit points."""
    if asked is not None:
        return asked
    if recording.metadata.robot:
        return recording.metadata.robot
    if recording.exit_points is not None:
        points = load_robot("scampi").exit_points
        same = recording.exit_points.shape == points.shape
        if same and np.linalg.norm(recording.exit_points - points, axis=1).max() < SCAMPI_NEAR:
            return "scampi"
    allowed = f"the recording names no robot, so say one of {list(list_robots())} or a YAML file"
    raise InvalidField("--robot", "nothing", allowed)


def _words(options: Options, robot: str) -> list[str]:
    """The command that repeats this."""
    words = ["carosac", "validate", options.recording, "--robot", robot]
    words += ["--models", *options.models, "--start", str(options.start)]
    words += ["--stop", str(options.stop)] if options.stop is not None else []
    return [*words, "--seed", str(options.seed)]


def _print(name: str, recording: Recording, result: ValidationResult, said: list[str]) -> None:
    """Print the tables and what they say."""
    rate = recording.rates["unstrained_length"]
    print(
        f"{name}: {len(recording.time)} samples, {recording.duration:.1f} s"
        + (f" at {rate:.3g} Hz" if rate else "")
        + f"; robot {result.robot.name}; scored {result.samples} samples "
        f"({result.start}:{result.stop}), {int(result.resting.sum())} of them at rest"
    )
    if recording.metadata.description:
        print(recording.metadata.description.split(". ")[0].rstrip(".") + ".")
    print(f"\n{PART_UNITS}\n")
    print(align(PART_HEADER, part_rows(result), left=2))
    print()
    print(align(CAUSE_HEADER, cause_rows(result), left=1))
    print()
    print("\n".join(f"* {line}" for line in said))
