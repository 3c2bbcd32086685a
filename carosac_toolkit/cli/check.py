"""Check a robot file; describe and draw the robot at home.

Prints masses, cables and limits, and at home the tensions, sag and natural frequencies.

Exit status 1 means that the file is right but the robot cannot hang at its home position within its
tension limits.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import tyro

from carosac_toolkit.cli.common import (
    CommandResult,
    CommonOptions,
    OutputFile,
    check_writable,
    format_table,
    replacing,
)
from carosac_toolkit.robot_file import load_robot
from carosac_toolkit.robot_report import RobotReport, report_robot


@dataclass(frozen=True, kw_only=True)
class Options(CommonOptions):
    """Options of ``carosac check``."""

    robot: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="ROBOT")]
    """A bundled robot (`carosac robots` lists them) or a path to a YAML file."""
    picture: OutputFile = None
    """Draw the robot at home into this PNG file."""


def run(options: Options) -> CommandResult:
    """Check, describe and draw one robot."""
    check_writable("--picture", options.picture, (".png",))
    report = report_robot(load_robot(options.robot))
    print("\n".join(_lines(report)))
    if not report.feasible:
        print(_infeasible(report), file=sys.stderr)
    if options.picture is not None:
        from carosac_toolkit.pictures.robot import draw_robot

        with replacing(options.picture) as temporary:
            draw_robot(report).savefig(temporary, dpi=150)
        print(f"\npicture: {options.picture}")
    return CommandResult(report.data(), status=0 if report.feasible else 1)


def _lines(report: RobotReport) -> Iterator[str]:
    """Describe the robot in text."""
    robot = report.robot
    suspended = "suspended" if report.suspended else "not suspended: cables pull down as well"
    moments = np.linalg.eigvalsh(robot.inertia)
    yield f"{robot.name}: {robot.description}"
    yield f"licence: {robot.licence}"
    yield ""
    yield f"cables      {robot.n}, {report.constraint}, {suspended}"
    yield (
        f"platform    {robot.mass:g} kg ({robot.weight:.1f} N), centre of mass "
        f"{_vector(robot.center_of_mass)} m, principal inertia {_vector(moments)} kg m^2"
    )
    yield (
        f"workspace   {_vector(robot.workspace_min)} to {_vector(robot.workspace_max)} m "
        "(positions of the platform origin)"
    )
    yield (
        f"winches     speed {_range(robot.speed_max)} m/s, acceleration "
        f"{_range(robot.acceleration_max)} m/s^2, lag {_range(robot.winch_lag)} s, length "
        f"{_range(np.append(robot.length_min, robot.length_max))} m"
    )
    yield ""
    yield _cable_table(report)
    yield ""
    yield from _home(report)
    yield ""
    yield "where the numbers come from:"
    yield from (f"  {field}: {source}" for field, source in robot.provenance.items())


def _cable_table(report: RobotReport) -> str:
    """One row per cable; the last three columns at home."""
    robot, home = report.robot, report.equilibrium
    header = (
        "cable", "EA [kN]", "[g/m]", "run [m]", "limits [N]", "unstrained [m]", "tension [N]",
        "sag [mm]",
    )  # fmt: skip
    rows = [
        (
            name,
            float(robot.axial_stiffness[i]) / 1e3,
            float(robot.linear_density[i]) * 1e3,
            float(robot.run_length[i]),
            f"{robot.tension_min[i]:g} to {robot.tension_max[i]:g}",
            f"{home.unstrained_length[0, i]:.4f}" if home.converged[0] else "-",
            f"{home.tension[0, i]:.2f}" if home.converged[0] else "-",
            f"{report.sag[i] * 1e3:.2f}" if home.converged[0] else "-",
        )
        for i, name in enumerate(robot.cable_names)
    ]
    return format_table(header, rows)


def _home(report: RobotReport) -> Iterator[str]:
    """Describe the equilibrium at home."""
    home = report.equilibrium
    if not home.converged[0]:
        yield f"at home     {_vector(report.robot.home_position)} m: no equilibrium"
        return
    yield (
        f"at home     {_vector(home.position[0])} m, tilt {np.degrees(report.tilt):.2f} deg, "
        f"{'stable' if home.stable[0] else 'not stable'}, residual {home.residual[0]:.1e} N"
    )
    frequencies = ", ".join(f"{value:.3g}" for value in report.frequencies)
    yield f"natural frequencies at home [Hz]: {frequencies}"


def _infeasible(report: RobotReport) -> str:
    """Say why the robot cannot be at home."""
    robot, home = report.robot, report.equilibrium
    reasons = []
    if not home.converged[0]:
        from carosac_toolkit.physics.statics import REASONS

        reasons.append(REASONS[home.status[0]])
    elif not home.stable[0]:
        reasons.append("the equilibrium is not stable")
    for i, name in enumerate(robot.cable_names):
        low, high, tension = robot.tension_min[i], robot.tension_max[i], home.tension[0, i]
        if home.converged[0] and not low - 1e-6 <= tension <= high + 1e-6:
            reasons.append(f"{name} at {tension:.1f} N, allowed {low:g} to {high:g} N")
    return f"carosac: {robot.name} cannot be at its home position: {'; '.join(reasons)}"


def _vector(values: Sequence[float] | np.ndarray) -> str:
    """Write a vector."""
    return "(" + ", ".join(f"{value:.4g}" for value in values) + ")"


def _range(values: np.ndarray) -> str:
    """Write one number, or the range of several."""
    low, high = float(np.min(values)), float(np.max(values))
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"
