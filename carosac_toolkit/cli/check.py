"""Check a robot file; describe and draw the robot at home.

Prints masses, points, pulleys, cables and limits, and at home the tensions, sag and natural
frequencies. Warns of what looks like a mistake, such as a value in another unit.

Exit status 1 means that the file is right but the robot cannot stay at its home position: no
equilibrium within the tension limits, an unstable one, lengths that its winches cannot wind, or
cables that touch each other.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

from carosac_toolkit.cli.check_tables import describe
from carosac_toolkit.cli.common import CommandResult, OutputFile, RobotOptions
from carosac_toolkit.inspection.report import report_robot
from carosac_toolkit.robot.file import parse_file, robot_text


@dataclass(frozen=True, kw_only=True)
class Options(RobotOptions):
    """Options of ``carosac check``."""

    picture: OutputFile = None
    """Draw the robot at home into this file: .png, .svg or .pdf; without a suffix, all three."""


def run(options: Options) -> CommandResult:
    """Check, describe and draw one robot."""
    from carosac_toolkit.pictures.saving import check_picture, save_picture

    check_picture("--picture", options.picture)
    robot, file = parse_file(robot_text(options.robot), source=options.robot)
    report = report_robot(robot, file)
    print("\n".join(describe(report)))
    if options.picture is not None:
        from carosac_toolkit.pictures.robot import draw_robot

        files = save_picture(draw_robot(report), options.picture)
        print(f"\npicture: {', '.join(map(str, files))}")
    sys.stdout.flush()
    for warning in report.warnings:
        print(f"carosac: warning: {warning}", file=sys.stderr)
    if not report.feasible:
        reasons = "\n  ".join(["", *report.problems])
        print(f"carosac: {robot.name} cannot stay at its home position:{reasons}", file=sys.stderr)
    return CommandResult(report.data(), status=0 if report.feasible else 1)
