"""Measure exit points with a total station, from GSI or CSV files.

The robot file that comes of it has their covariances. Levelled set-ups of unknown place and heading
are joined through the points they share and placed in the robot's frame by reference points with
known coordinates. Blunders are left out and named.

Exit status 1 means that the residuals are larger than the stated accuracy explains.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from calibration.report import option_words, print_sentences, write_new_robot, write_report
from calibration.robot_update import check_output
from calibration.tachymeter.calibrate import calibrate_tachymeter
from calibration.tachymeter.report import report_content
from calibration.tachymeter.result import TachymeterResult
from calibration.tachymeter.survey_files import read_survey
from calibration.tachymeter.tables import (
    EXIT_GROUPS,
    EXIT_HEADER,
    SETUP_GROUPS,
    SETUP_HEADER,
    exit_rows,
    setup_rows,
)
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.tables import fit, terminal_width
from carosac_toolkit.cli.common import CommandResult, CommonOptions, OutputFile, OutputFolder
from carosac_toolkit.reports.page import check_folder
from carosac_toolkit.robot.file import load_robot


@dataclass(frozen=True, kw_only=True)
class Options(CommonOptions):
    """Options of ``carosac calibrate tachymeter``."""

    files: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="FILE ...")]
    """Observations: Leica GSI-8 or GSI-16, or CSV where the name ends in .csv."""
    robot: str
    """A bundled robot or a YAML file."""
    targets: str
    """YAML file with the meaning of each surveyed point, known coordinates, and the instrument."""
    output: OutputFile = None
    """The new robot file; never the old one."""
    report: OutputFolder = None
    """Folder for report.html and pictures; an earlier report in it is replaced."""
    name: str | None = None
    """Name of the new robot; by default that of the old one."""
    frame_tilt_deg: float = 0.0
    """Standard deviation of the tilt of the known points' frame against gravity, about x and y;
    above 0 the tilt is estimated and written to the robot. By default that frame is level."""
    use_prior: bool = False
    """Take the exit points' covariances in the robot file as prior knowledge."""


def run(options: Options) -> CommandResult:
    """Calibrate exit points from a survey."""
    if not options.files:
        raise InvalidField("FILE", "none", "at least one file of observations")
    if not 0.0 <= options.frame_tilt_deg < 45.0:
        raise InvalidField("--frame-tilt-deg", options.frame_tilt_deg, "0 to 45 degrees")
    check_output("--output", options.output, options.robot)
    if options.report is not None:
        check_folder("--report", options.report)
    robot = load_robot(options.robot)
    survey = read_survey(options.files, options.targets, robot)
    result = calibrate_tachymeter(
        robot,
        survey,
        frame_tilt=float(np.deg2rad(options.frame_tilt_deg)),
        use_prior=options.use_prior,
    )
    _print(result)
    write_new_robot(
        result, options.robot, options.output, name=options.name,
        provenance=_provenance(options, result),
    )  # fmt: skip
    if options.report is not None:
        write_report(
            options.report,
            f"Tachymeter survey of {robot.name}",
            result,
            report_content(result),
            provenance={
                "robot": options.robot,
                "observations": ", ".join(options.files),
                "targets": options.targets,
            },
            command=[
                "carosac", "calibrate", "tachymeter", *options.files,
                *option_words(options, ("files", "json", "seed")),
            ],
        )  # fmt: skip
        print(f"report: {options.report / 'report.html'}")
    sound = result.fits and result.converged and not result.misplaced()
    return CommandResult({"robot": robot.name, **result.data()}, status=0 if sound else 1)


def _print(result: TachymeterResult) -> None:
    """Print tables and sentences."""
    width = terminal_width()
    print_sentences(result.warnings, "WARNING: ")
    print("\n" + fit(EXIT_HEADER, exit_rows(result), EXIT_GROUPS, width), end="\n\n")
    print(fit(SETUP_HEADER, setup_rows(result), SETUP_GROUPS, width), end="\n\n")
    print_sentences([*result.sentences(), *result.observability.sentences()])


def _provenance(options: Options, result: TachymeterResult) -> str:
    """Return one line for the robot file."""
    names = ", ".join(Path(path).name for path in options.files)
    left = f", {len(result.blunders)} readings left out" if result.blunders else ""
    return (
        f"tachymeter survey {names} ({len(result.survey.shots)} shots, "
        f"{len(result.survey.setups)} set-ups{left}; chi2 {result.chi2:.0f} of {result.freedom})"
    )
