"""Fit the simulated dynamics to recordings with poses: a robot that moves as measured.

The simulator runs open loop through the recorded lengths; centre of mass, inertia, damping,
stiffness, delay, and geometry within what the robot file knows of it, are fitted to the poses of
the samples of --train. The recording may begin in motion, as a free oscillation with locked winches
does: the first pose and speed of a platform on fewer than six cables are fitted too. Samples of
--test are scored only. Several recordings of one robot are fitted together, each with a start of
its own; those of --held-out are scored only. Prints what was learnt and what the data cannot tell,
and writes a report and, with --output, a new robot file.

Exit status 1 means that the search did not settle, that it had to leave out recordings, or that the
new robot is worse than the old one on the samples kept back. No robot file is written if a platform
that stands still would predict these samples as well.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from calibration.identification.effects import remaining_effects
from calibration.identification.frequencies import load_frequencies
from calibration.identification.procedure import identify, identify_runs
from calibration.identification.report import IDENTIFIED, report_content
from calibration.identification.result import Identification
from calibration.identification.settings import CANDIDATE_SIGMAS, IdentificationSettings
from calibration.report import (
    option_words,
    print_parameters,
    print_sentences,
    write_new_robot,
    write_report,
)
from calibration.robot_update import check_output
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.cli.common import CommandResult, CommonOptions, OutputFile
from carosac_toolkit.recordings.bundled import find_recording
from carosac_toolkit.recordings.files import load_recording
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.recordings.robot import FoundRobot, find_robot
from carosac_toolkit.reports.page import check_folder
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.validation.residual_effects import ResidualEffects, effects_sentence

Range = tuple[int, int]
COMMAND_OPTIONS = (
    "recordings",
    "held_out",
    "robot",
    "train",
    "test",
    "frequencies",
    "candidates",
    "free",
    "report",
    "json",
    "seed",
)  # as resolved
_TRAIN_SHARE_DEFAULT = 2.0 / 3.0  # of the samples that are fitted, where nothing else is asked for


@dataclass(frozen=True, kw_only=True)
class Options(CommonOptions):
    """Options of ``carosac identify``."""

    recordings: Annotated[
        tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RECORDING [RECORDING ...]")
    ]
    """Bundled recordings such as `synthetic`, or .parquet, .csv or .mat files, with poses."""
    held_out: Annotated[tuple[str, ...], tyro.conf.arg(metavar="RECORDING [RECORDING ...]")] = ()
    """Recordings that are scored only; nothing but their first motion is fitted to them."""
    robot: str | None = None
    """Robot at the start of the search, bundled or a YAML file, best a calibrated one; by default
    the one that the first recording names, or else the bundled one with its exit points."""
    train: Annotated[str | None, tyro.conf.arg(metavar="START:STOP")] = None
    """Of one recording: length samples START <= i < STOP whose poses are fitted; by default the
    first two thirds, or all of them with --held-out. The simulation always begins at sample 0, at
    rest or in motion. Several recordings are fitted as a whole."""
    test: Annotated[str | None, tyro.conf.arg(metavar="START:STOP")] = None
    """Of one recording: samples that are scored only; by default all after those of --train."""
    frequencies: Annotated[str | None, tyro.conf.arg(metavar="FILE")] = None
    """CSV table of natural frequencies that were measured at rest, fitted beside the recordings:
    columns unstrained_length_01_m ..., frequency_Hz, sigma_Hz, and mode or shape_x_m ..."""
    candidates: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="[NAME ...]")] = None
    """Parameters that are kept only where cross-validation wants them, and else stay as in the
    robot file; without names inertia_products, angular_drag_axes, cable_drag and capstan_friction.
    Takes twice as long."""
    free: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME [NAME ...]")] = None
    """Those of these four that are fitted without such a judgement, as the robot surely has them:
    capstan_friction of rough pulleys."""
    output: OutputFile = None
    """Write the identified robot to this YAML file; over another one, but not over --robot."""
    report: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for pictures and report.html; by default one in carosac-results/identify."""


def run(options: Options) -> CommandResult:
    """Identify a robot."""
    if not options.recordings:
        raise InvalidField("RECORDING", "none", "at least one recording")
    given = (*options.recordings, *options.held_out)
    paths = [find_recording(name) for name in given]
    _check_given(paths)
    recordings = [load_recording(path) for path in paths]
    robot_source = find_robot(recordings[0], paths[0], options.robot)
    check_output("--output", options.output, robot_source.name)
    folder = options.report or _default_folder(paths, robot_source)
    check_folder("--report", folder)
    names = [path.name for path in paths]
    measured = None
    if options.frequencies is not None:
        measured = load_frequencies(options.frequencies, robot_source.robot)
    steps = _Steps(robot_source.robot)
    settings, candidates = _freed(options)
    if len(given) == 1:
        train, test = _ranges(options, recordings[0])
        result = identify(
            recordings[0], robot_source.robot, settings, train=train, test=test, name=names[0],
            frequencies=measured, candidates=candidates, report=steps,
        )  # fmt: skip
        ranges = ["--train", f"{train[0]}:{train[1]}"]
        ranges += [] if test is None else ["--test", f"{test[0]}:{test[1]}"]
        fitted = f"samples {train[0]}:{train[1]} of {names[0]}"
    else:
        _refuse_ranges(options)
        count = len(options.recordings)
        result = identify_runs(
            recordings[:count], robot_source.robot, settings, held_out=recordings[count:],
            names=names, frequencies=measured, candidates=candidates, report=steps,
        )  # fmt: skip
        ranges = ["--held-out", *options.held_out] if options.held_out else []
        fitted = names[0] if count == 1 else f"{count} recordings, {names[0]} to {names[count - 1]}"
    beside = f" and {Path(options.frequencies).name}" if options.frequencies else ""
    found = remaining_effects(recordings, result)
    effects = found if isinstance(found, ResidualEffects) else None
    print()
    _print(result, found)
    ranges += ["--frequencies", options.frequencies] if options.frequencies else []
    ranges += ["--candidates", *candidates] if candidates else []
    ranges += ["--free", *options.free] if options.free else []
    command = [
        "carosac", "identify", *options.recordings, "--robot", robot_source.name, *ranges,
        *option_words(options, COMMAND_OPTIONS),
    ]  # fmt: skip
    files = write_report(
        folder,
        f"Identification of {result.robot.name}",
        result,
        report_content(result, recordings, found),
        provenance=_provenance(options, recordings, robot_source),
        command=command,
    )
    print(f"\nreport: {files[-1]}, pictures beside it")
    output = None if result.against_mean.useless else options.output
    write_new_robot(
        result, robot_source.name, output,
        name=output.stem if output else None, model_error=result.model_error,
        provenance=f"carosac identify, {fitted}{beside}",
    )  # fmt: skip
    if output != options.output:
        print(f"\nno robot file was written: {options.output} would be of no use")
    sys.stdout.flush()
    for line in result.warnings:
        print(f"carosac: warning: {line}", file=sys.stderr)
    data = {
        "recording": list(given) if len(given) > 1 else given[0],
        "robot": robot_source.name,
        **result.data(),
        "effects": None if effects is None else effects.data(),
        "effects_reason": "" if isinstance(found, ResidualEffects) else found,
    }
    return CommandResult(data, status=1 if result.warnings else 0)


def _check_given(paths: Sequence[Path]) -> None:
    """Refuse a recording that is given twice."""
    seen: set[Path] = set()
    for path in paths:
        if path.resolve() in seen:
            raise InvalidField("RECORDING", str(path), "each recording once")
        seen.add(path.resolve())


def _freed(options: Options) -> tuple[IdentificationSettings, tuple[str, ...]]:
    """Return settings with all that is to be fitted, and the parameters that are to be tried."""
    free = options.free or ()
    unknown = [name for name in free if name not in CANDIDATE_SIGMAS]
    if unknown or options.free == ():
        allowed = f"one or more of {', '.join(CANDIDATE_SIGMAS)}; others are fitted anyway"
        raise InvalidField("--free", repr(unknown[0]) if unknown else "nothing", allowed)
    candidates = options.candidates or ()
    if options.candidates == ():
        candidates = tuple(name for name in CANDIDATE_SIGMAS if name not in free)
    both = sorted({*candidates} & {*free})
    if both:
        raise InvalidField("--free", repr(both[0]), "what is not among --candidates")
    return IdentificationSettings().with_candidates(free), candidates


def _refuse_ranges(options: Options) -> None:
    """Refuse ranges of samples beside several recordings."""
    for name in ("train", "test"):
        if (value := getattr(options, name)) is not None:
            allowed = "only with one recording; several are fitted as a whole, see --held-out"
            raise InvalidField(f"--{name}", repr(value), allowed)


class _Steps:
    """Says how far the search is."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._count = 0

    def __call__(self, poses: int, position: float, rotation: float) -> None:
        """Print the errors before a step."""
        if self._count == 0:
            print(f"fitting robot {self._robot.name}, RMS errors before each step:")
        self._count += 1
        print(
            f"  {self._count:2d}, first {poses} poses: {position * 1e3:7.2f} mm, "
            f"{rotation * 1e3:7.2f} mrad",
            flush=True,
        )


def _print(result: Identification, effects: ResidualEffects | str) -> None:
    """Print what was found, and what the error looks like, or why that cannot be told."""
    print_parameters(result.estimate)
    print()
    left = effects_sentence(effects, IDENTIFIED)
    print_sentences([*result.sentences(), left, *result.observability.sentences()])


def _ranges(options: Options, recording: Recording) -> tuple[Range, Range | None]:
    """Return the range of samples to fit and the range to score."""
    count = len(recording.time)
    train = (0, round(_TRAIN_SHARE_DEFAULT * count))
    if options.train is not None:
        train = _range("train", options.train, count)
    if options.test is not None:
        return train, _range("test", options.test, count)
    return train, (train[1], count) if train[1] < count else None


def _range(name: str, text: str, count: int) -> Range:
    """Read START:STOP, either of which may be left out."""
    match = re.fullmatch(r"\s*(\d*)\s*:\s*(\d*)\s*", text)
    if match is None:
        raise InvalidField(f"--{name}", repr(text), "START:STOP, such as 0:400")
    return int(match[1] or 0), int(match[2] or count)


def _default_folder(paths: Sequence[Path], robot_source: FoundRobot) -> Path:
    """Return the folder of a report for which none was given."""
    more = f"-and-{len(paths) - 1}-more" if len(paths) > 1 else ""
    name = re.sub(r"[^\w.-]+", "_", f"{paths[0].stem}{more}-{robot_source.robot.name}")
    return Path("carosac-results") / "identify" / name


def _provenance(
    options: Options, recordings: Sequence[Recording], robot_source: FoundRobot
) -> dict[str, str]:
    """Return the inputs by name."""
    metadata = recordings[0].metadata
    given = (*options.recordings, *options.held_out)
    return {
        "recording" if len(given) == 1 else "recordings": ", ".join(given),
        **({"frequencies": options.frequencies} if options.frequencies else {}),
        "description": metadata.description,
        "source": metadata.source,
        "licence": metadata.licence,
        "cite": metadata.citation,
        "robot before": f"{robot_source.name}: {robot_source.robot.description}",
    }
