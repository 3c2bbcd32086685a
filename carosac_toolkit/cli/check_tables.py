"""The text of ``carosac check``: the robot, its tables and how it hangs at home."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.numbers import plain
from carosac_toolkit.base.tables import format_table
from carosac_toolkit.cli.calibration_tables import describe_calibration
from carosac_toolkit.inspection.report import RobotReport
from carosac_toolkit.physics.motion.cable_drag import cable_drag_of
from carosac_toolkit.robot.robot import DRY_FIELDS, Robot
from carosac_toolkit.robot.sizes import SURFACE_CABLES

if TYPE_CHECKING:
    from carosac_toolkit.robot.schema import Payload, Platform


def describe(report: RobotReport) -> Iterator[str]:
    """Describe the robot, line by line.

    Args:
        report: The robot and how it hangs at home.
    """
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
    yield f"air drag    {_air_drag(robot)}"
    plane = (
        "; two cables let it rest in one vertical plane only" if robot.n == SURFACE_CABLES else ""
    )
    yield (
        f"workspace   {_vector(robot.workspace_min)} to {_vector(robot.workspace_max)} m "
        f"(positions of the platform origin{plane})"
    )
    yield (
        f"winches     speed {_range(robot.speed_max)} m/s, acceleration "
        f"{_range(robot.acceleration_max)} m/s^2, lag {_range(robot.winch_lag)} s, length "
        f"{_range(np.append(robot.length_min, robot.length_max))} m"
    )
    for table in (_payload_table, _point_table, _pulley_table, _cable_table, _friction_table):
        text = table(report)
        if text:
            yield f"\n{text}"
    yield from describe_calibration(report)
    yield ""
    yield from _home(report)
    yield ""
    yield "where the numbers come from:"
    yield from (f"  {field}: {source}" for field, source in robot.provenance.items())


def _air_drag(robot: Robot) -> str:
    """Return the air drag of platform and cables in words."""
    factors = robot.angular_drag_axes
    about = "" if (factors == 1.0).all() else f" times {_vector(factors)} about x, y, z of P"
    usual = "" if robot.cable_drag is not None else ", as is usual for the size"
    return (
        f"{robot.drag:g} N s/m, {robot.angular_drag:g} N m s{about}; cables "
        f"{cable_drag_of(robot):.3g} 1/s{usual}"
    )


def _payload_table(report: RobotReport) -> str:
    """The bodies that make up the platform; empty without payloads."""
    if report.file is None or not report.file.platform.payloads:
        return ""
    platform = report.file.platform
    bodies: list[tuple[str, Platform | Payload]]
    bodies = [("bare platform", platform), *((body.name, body) for body in platform.payloads)]
    rows = [
        (
            name,
            float(body.mass),
            _vector(body.center_of_mass),
            _vector(np.linalg.eigvalsh(np.array(body.inertia))),
        )
        for name, body in bodies
    ]
    return format_table(
        ("body", "mass [kg]", "centre of mass [m]", "principal inertia [kg m^2]"), rows
    )


def _point_table(report: RobotReport) -> str:
    """Tabulate where each cable begins and ends."""
    robot = report.robot
    header = ("cable", "exit point in W [m]", "anchor point in P [m]")
    ends = zip(robot.cable_names, robot.exit_points, robot.anchor_points, strict=True)
    return format_table(header, [(name, _vector(a), _vector(b)) for name, a, b in ends])


def _pulley_table(report: RobotReport) -> str:
    """The pulleys and how the cables go round them; empty without pulleys."""
    robot = report.robot
    header = (
        "cable", "pulley radius [mm]", "swivel axis in W", "cable comes from",
        "straight run begins at [m]", "wrap at home [deg]",
    )  # fmt: skip
    rows = [
        (
            robot.cable_names[i],
            float(robot.pulley_radius[i]) * 1e3,
            _vector(robot.swivel_axis[i]),
            _side(-robot.swivel_axis[i]),
            _vector(robot.exit_points[i] - robot.run_length[i] * robot.swivel_axis[i]),
            f"{np.degrees(report.wrap[i]):.1f}" if report.straight.valid[0, i] else "-",
        )
        for i in np.flatnonzero(robot.pulley_radius > 0.0)
    ]
    return format_table(header, rows) if rows else ""


def _side(direction: Array) -> str:
    """Name a direction in W."""
    axis = int(np.argmax(np.abs(direction)))
    up = direction[axis] > 0.0
    if axis == 2:
        word = "above" if up else "below"
    else:
        word = f"the {'+' if up else '-'}{'xy'[axis]} side"
    return word if abs(direction[axis]) > 0.98 else f"mostly {word}"


def _cable_table(report: RobotReport) -> str:
    """One row per cable; the last three columns at home."""
    robot, home = report.robot, report.equilibrium
    header = (
        "cable", "diameter [mm]", "EA [kN]", "[g/m]", "run [m]", "limits [N]", "unstrained [m]",
        "tension [N]", "sag [mm]",
    )  # fmt: skip
    rows = [
        (
            name,
            float(robot.cable_diameter[i]) * 1e3,
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


def _friction_table(report: RobotReport) -> str:
    """One row per cable; empty without dry friction and hysteresis."""
    robot = report.robot
    columns = [np.broadcast_to(getattr(robot, name), robot.n) for name in DRY_FIELDS]
    if not any(column.any() for column in columns):
        return ""
    header = (
        "cable", "exit friction [N m]", "anchor friction [N m]", "capstan friction",
        "hysteresis [mm]",
    )  # fmt: skip
    units = (1.0, 1.0, 1.0, 1e3)
    rows = [
        (name, *(f"{unit * column[i]:.3g}" for unit, column in zip(units, columns, strict=True)))
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
        f"{'stable' if home.stable[0] else 'NOT STABLE'}, residual {home.residual[0]:.1e} N"
    )
    frequencies = ", ".join(
        f"{plain(value, 3)} {direction}"
        for value, direction in zip(report.frequencies, report.directions, strict=True)
    )
    yield f"natural frequencies at home [Hz]: {frequencies}"
    if (report.frequencies < 0.0).any():
        yield "  negative: this motion grows instead of oscillating, so the robot leaves home"


def _vector(values: Iterable[float]) -> str:
    """Write a vector."""
    return "(" + ", ".join(plain(value, 4) for value in values) + ")"


def _range(values: Array) -> str:
    """Write one number, or the range of several."""
    low, high = float(np.min(values)), float(np.max(values))
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"
