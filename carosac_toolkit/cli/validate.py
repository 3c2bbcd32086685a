"""Run models open loop on a recording and score them against its measured poses.

Each model is an estimator. It gets the recorded cable lengths in order from the first sample, never
a measured pose. Prints errors with resting and with moving winches and what explains them, and
writes pictures and one self-contained report.html.

Exit status 1 means that a model failed altogether (the others are scored), or that lengths and
poses of the recording do not belong together as they are, as with wrong units.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from carosac_toolkit.base.numbers import plain
from carosac_toolkit.base.tables import fit, terminal_width, wrapped
from carosac_toolkit.cli.common import CommandResult, CommonOptions
from carosac_toolkit.recordings.bundled import find_recording, list_recordings
from carosac_toolkit.recordings.files import load_recording
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.recordings.robot import FoundRobot, find_robot
from carosac_toolkit.reports.page import check_folder
from carosac_toolkit.reports.validation import Context, free_folder, write_report
from carosac_toolkit.validation import DEFAULT_MODELS, ValidationResult, validate
from carosac_toolkit.validation.findings import conclusions
from carosac_toolkit.validation.tables import (
    CAUSE_GROUPS,
    CAUSE_HEADER,
    PART_GROUPS,
    PART_HEADER,
    cause_rows,
    part_rows,
    part_units,
)


@dataclass(frozen=True, kw_only=True)
class Options(CommonOptions):
    """Options of ``carosac validate``."""

    recording: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RECORDING")]
    """A bundled recording such as `synthetic`, or a .parquet, .csv or .mat file."""
    robot: str | None = None
    """A bundled robot or a YAML file; by default the one that the recording names, or else the
    bundled one with the exit points measured in it."""
    models: tuple[str, ...] = DEFAULT_MODELS
    """Estimators by name, or `module:Class`."""
    start: int = 0
    """First sample to score; models still run from sample 0."""
    stop: int | None = None
    """One past the last sample to score; by default all are scored."""
    no_effects: tyro.conf.FlagCreatePairsOff[bool] = False
    """Leave out which physical effects the error of the best model that moves looks like, each with
    its share: this simulates the robot with each effect, which takes some seconds."""
    output: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for pictures and report; an earlier report in it is replaced. By default a folder in
    carosac-results/validate named after recording, robot and range, numbered if it holds another
    report."""


def run(options: Options) -> CommandResult:
    """Validate models on one recording."""
    path = find_recording(options.recording)
    if options.output is not None:
        check_folder("--output", options.output)
    recording = load_recording(path)
    robot_choice = find_robot(recording, path, options.robot)
    context = Context(
        recording=options.recording,
        metadata=recording.metadata,
        words=_words(options, robot_choice.name),
        file=path,
        guess=_guess(robot_choice),
    )
    folder = options.output or free_folder(_default_folder(options, path, robot_choice), context)
    check_folder("--output", folder)
    result = validate(
        recording, robot_choice.robot, options.models,
        start=options.start, stop=options.stop, seed=options.seed, effects=not options.no_effects,
    )  # fmt: skip
    sentences = conclusions(result)
    _print(context, recording, result, sentences)
    files = write_report(folder, result, sentences, context)
    pictures = sum(file.suffix == ".png" for file in files)
    print(f"\nreport: {folder / 'report.html'} and {pictures} pictures beside it")
    data = {"recording": options.recording, "robot_source": robot_choice.source, **result.data()}
    return CommandResult({**data, "conclusions": sentences}, status=_status(result))


def _status(result: ValidationResult) -> int:
    """Return the exit status; failed models are named on standard error."""
    failed = [model for model in result.models.values() if model.scores is None]
    for model in failed:
        print(f"carosac: {model.name} failed: {model.reason}", file=sys.stderr)
    return 1 if failed or result.warnings else 0


def _guess(robot_choice: FoundRobot) -> str:
    """Explain how the robot was guessed; empty if it was not."""
    if robot_choice.source != "exit points":
        return ""
    others = f", and those of {', '.join(robot_choice.others)}" if robot_choice.others else ""
    return f"a guess: the recording names no robot, but its exit points are this one's{others}"


def _default_folder(options: Options, path: Path, robot_choice: FoundRobot) -> Path:
    """Return the default folder of the report."""
    parts = [path.stem]
    if path.suffix and options.recording not in list_recordings():
        parts.append(path.suffix[1:])
    parts.append(robot_choice.robot.name)
    if options.start or options.stop is not None:
        parts += [str(options.start), "end" if options.stop is None else str(options.stop)]
    name = re.sub(r"[^\w.-]+", "_", "-".join(parts))
    return Path("carosac-results") / "validate" / name


def _words(options: Options, robot: str) -> list[str]:
    """Return the command line that repeats this validation."""
    return [
        "carosac", "validate", options.recording, "--robot", robot,
        "--models", *options.models, "--start", str(options.start),
        *(["--stop", str(options.stop)] if options.stop is not None else []),
        "--seed", str(options.seed), *(["--no-effects"] if options.no_effects else []),
    ]  # fmt: skip


def _print(
    context: Context, recording: Recording, result: ValidationResult, sentences: list[str]
) -> None:
    """Print warnings, tables and conclusions within the width of the terminal."""
    width = terminal_width()
    rate = recording.rates["unstrained_length"]
    at = f" at {plain(rate, 3)} Hz" if rate else ""
    lines = [
        f"{context.recording}: {len(recording.time)} samples, {recording.duration:.1f} s{at}; "
        f"scored {result.samples} samples ({result.start}:{result.stop}), "
        f"{int(result.resting.sum())} of them with the winches at rest"
        + (", where the platform moves" if result.sways_at_rest else ""),
        f"robot {result.robot.name}" + (f" ({context.guess})" if context.guess else ""),
        recording.metadata.description.split(". ")[0].rstrip(".") + ".",
    ]
    print("\n".join(wrapped(line, width) for line in lines if line != "."))
    if result.warnings:
        print()
    for line in result.warnings:
        print(wrapped(line, width, "WARNING: "))
    print("\n" + wrapped(part_units(result), width), end="\n\n")
    print(fit(PART_HEADER, part_rows(result), PART_GROUPS, width), end="\n\n")
    print(fit(CAUSE_HEADER, cause_rows(result), CAUSE_GROUPS, width), end="\n\n")
    for line in sentences:
        print(wrapped(line, width, "* "))
