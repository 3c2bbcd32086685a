"""``carosac calibrate lengths`` on a file of motor angles."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Protocol

from calibration.report import (
    option_words,
    print_parameters,
    print_sentences,
    write_new_robot,
    write_report,
)
from calibration.robot_update import check_output
from calibration.self_calibration.calibrate import calibrate_motor_angles
from calibration.self_calibration.motor_angle_files import load_motor_angles
from calibration.self_calibration.motor_angles import MotorAngles
from calibration.self_calibration.problem import check_drums
from calibration.self_calibration.report import (
    BLUNDER_HEADER,
    LEFT_OUT_HEADER,
    blunder_rows,
    left_out_rows,
    report_content,
)
from calibration.self_calibration.settings import Distance, SelfCalibrationSettings, positive
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.tables import fit, terminal_width
from carosac_toolkit.cli.common import CommandResult
from carosac_toolkit.reports.page import check_folder
from carosac_toolkit.robot.bundled_names import list_robots
from carosac_toolkit.robot.file import load_robot


class PriorOptions(Protocol):
    """Options that say what was known before."""

    @property
    def distance(self) -> tuple[tuple[str, str, float, float], ...]:
        """Measured distances: two ends, length and standard deviation [m]."""

    @property
    def keeps_rotation(self) -> bool:
        """True if the platform keeps its rotation though its cables end apart."""

    @property
    def home_length_prior(self) -> float:
        """Standard deviation of the lengths at home [m]."""

    @property
    def radius_prior(self) -> float:
        """Standard deviation of the drums' radius [m]."""


class MotorAngleOptions(PriorOptions, Protocol):
    """Options of the command that matter with motor angles."""

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
    def seed(self) -> int:
        """Not used: starts are drawn alike in every run."""

    @property
    def x_through(self) -> str | None:
        """Cable whose exit point tells the x axis."""

    @property
    def accuracy(self) -> float | None:
        """Wanted standard deviation of the exit points [m]."""


def run_motor_angles(options: MotorAngleOptions, path: Path) -> CommandResult:
    """Calibrate a robot from motor angles; print, and write what was asked for.

    Args:
        options: Of the command.
        path: CSV of motor angles.

    Returns:
        Numbers, with exit status 1 where something must not be overlooked.
    """
    angles = load_motor_angles(path)
    name = options.robot or _robot_of(angles)
    check_output("--output", options.output, name)
    if options.report is not None:
        check_folder("--report", options.report)
    robot = load_robot(name)
    check_drums(robot)
    settings = replace(
        prior_settings(options), x_through=options.x_through, accuracy=options.accuracy
    )
    result = calibrate_motor_angles(angles, robot, settings)
    known = int(angles.is_known.sum())
    print(
        f"{path}: {len(angles.samples)} samples of {len(angles.cables)} motors, {known} known "
        f"position{'' if known == 1 else 's'}; robot {robot.name}"
    )
    print_sentences(result.warnings, "WARNING: ")
    print_sentences(result.sentences())
    print_sentences(result.observability.sentences())
    print()
    print_parameters(result.estimate)
    if result.left_out:
        print("\nknown positions left out one at a time, predicted less known:")
        print(fit(LEFT_OUT_HEADER, left_out_rows(result), (1, 5), terminal_width()))
    if result.blunders:
        print("\nleft out as blunders:")
        print(fit(BLUNDER_HEADER, blunder_rows(result), (2, 1), terminal_width()))
    provenance = f"self-calibration from the motor angles in {path.name}"
    write_new_robot(result, name, options.output, provenance=provenance)
    if options.report is not None:
        files = write_report(
            options.report,
            f"Self-calibration of {robot.name} from {path.name}",
            result,
            report_content(result),
            provenance={
                "motor angles": str(path),
                "robot": f"{robot.name}: {robot.description}",
                "robot licence": robot.licence,
            },
            command=[
                "carosac", "calibrate", "lengths", str(path), "--robot", name,
                *option_words(options, ("recording", "robot", "json", "seed")),
            ],
        )  # fmt: skip
        print(f"\nreport: {files[-1]}, pictures beside it")
    return CommandResult(result.data(), status=1 if result.warnings else 0)


def prior_settings(options: PriorOptions) -> SelfCalibrationSettings:
    """Return settings of what was known before.

    Raises:
        InvalidField: A standard deviation that is none.
    """
    for option in ("home_length_prior", "radius_prior"):
        value = getattr(options, option)
        if not positive(value):
            name = f"--{option.replace('_', '-')}"
            raise InvalidField(name, f"{value:g} m", "a standard deviation > 0 m, finite")
    return SelfCalibrationSettings(
        length_at_zero_sigma=options.home_length_prior,
        drum_radius_sigma=options.radius_prior,
        keeps_rotation=options.keeps_rotation,
        distances=tuple(
            Distance(first=first, second=second, length=length, sigma=sigma)
            for first, second, length, sigma in options.distance
        ),
    )


def _robot_of(angles: MotorAngles) -> str:
    """Return the bundled robot with drums whose cables are called like the motors."""
    for name in list_robots():
        robot = load_robot(name)
        if robot.drum_radius is not None and sorted(robot.cable_names) == sorted(angles.cables):
            return name
    allowed = f"a robot file: no bundled robot with drums has cables {list(angles.cables)}"
    raise InvalidField("--robot", "nothing", allowed)
