"""``carosac calibrate lengths`` on a recording without poses."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from calibration.report import (
    option_words,
    print_parameters,
    print_sentences,
    write_new_robot,
    write_report,
)
from calibration.rests.calibrate import calibrate_rests
from calibration.rests.report import (
    BLUNDER_GROUPS,
    BLUNDER_HEADER,
    blunder_rows,
    report_content,
)
from calibration.rests.result import RestCalibration
from calibration.rests.settings import RestSettings
from calibration.robot_update import check_output
from calibration.sensor_errors import print_sensors
from carosac_toolkit.base.tables import fit, terminal_width
from carosac_toolkit.cli.common import CommandResult
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.recordings.robot import find_robot
from carosac_toolkit.reports.page import check_folder


class RestOptions(Protocol):
    """Options of the command that matter without poses."""

    @property
    def recording(self) -> str:
        """The recording, as it was named."""

    @property
    def robot(self) -> str | None:
        """Bundled robot or YAML file."""

    @property
    def output(self) -> Path | None:
        """The new robot file."""

    @property
    def report(self) -> Path | None:
        """Folder of the report."""

    @property
    def start(self) -> int:
        """First sample to use."""

    @property
    def stop(self) -> int | None:
        """One past the last sample to use."""


def run_rests(
    options: RestOptions, settings: RestSettings, recording: Recording, path: Path
) -> CommandResult:
    """Calibrate a robot from rests that nobody measured; print, and write what was asked for.

    Args:
        options: Of the command.
        settings: Noise and priors.
        recording: Without poses.
        path: Its file.

    Returns:
        Numbers, with exit status 1 where something must not be overlooked.
    """
    source = find_robot(recording, path, options.robot)
    check_output("--output", options.output, source.name)
    if options.report is not None:
        check_folder("--report", options.report)
    result = calibrate_rests(
        recording, source.robot, settings=settings, start=options.start, stop=options.stop
    )
    print_sentences(
        [f"{options.recording}: {len(result.time)} rests, no poses; robot {source.name}"], ""
    )
    _print(result)
    output = None if result.useless else options.output
    write_new_robot(
        result, source.name, output, name=output.stem if output else None,
        provenance=(
            f"cable lengths at {len(result.time)} rests of {path.name}, no poses "
            f"(residual {1e3 * result.residual_rms:.2f} mm RMS)"
        ),
    )  # fmt: skip
    if output != options.output:
        print(f"\nno robot file was written: {options.output} would be of no use")
    if options.report is not None:
        write_report(
            options.report,
            f"Calibration of {result.robot.name} from rests of {path.name}",
            result,
            report_content(result),
            provenance={"recording": options.recording, "robot": source.name},
            command=[
                "carosac", "calibrate", "lengths", options.recording, "--robot", source.name,
                *option_words(options, ("recording", "robot", "json")),
            ],
        )  # fmt: skip
        print(f"report: {options.report / 'report.html'}")
    return CommandResult(
        {"robot": source.name, **result.data()}, status=1 if result.warnings else 0
    )


def _print(result: RestCalibration) -> None:
    """Print warnings, sentences and tables within the width of the terminal."""
    print_sentences(result.warnings, "WARNING: ")
    print_sentences(result.sentences())
    print_sentences(result.observability.sentences())
    print()
    print_parameters(result.estimate)
    print_sensors(result.sensors)
    if result.blunders:
        print("\nleft out as blunders:")
        print(fit(BLUNDER_HEADER, blunder_rows(result), BLUNDER_GROUPS, terminal_width()))
