"""Calibration part of ``carosac check``: every number with one standard deviation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from carosac_toolkit.base.tables import format_table
from carosac_toolkit.inspection.report import CalibratedParameter, RobotReport

_POINT_TITLES = {"exit_points": "exit point in W", "anchor_points": "anchor point in P"}
_CABLE_COLUMNS = {
    "length_offset": "offset", "length_scale": "scale", "drum_radius": "drum radius",
    "drum_buildup": "build-up", "axial_stiffness": "EA", "linear_density": "density",
    "axial_damping": "damping", "run_length": "run", "exit_friction": "exit friction",
    "anchor_friction": "anchor friction", "capstan_friction": "capstan friction",
    "length_hysteresis": "hysteresis",
}  # fmt: skip
_UNITS_SHOWN = {
    "m": ("mm", 1e3), "s": ("ms", 1e3), "rad": ("mrad", 1e3), "N": ("kN", 1e-3),
    "kg/m": ("g/m", 1e3),
}  # fmt: skip
_EXACT_DIGITS = 6  # significant digits of a number without sigma


def describe_calibration(report: RobotReport) -> Iterator[str]:
    """Describe the sensors and the accuracy of a robot file; empty if it has neither.

    Args:
        report: The robot.
    """
    known = {parameter.name: parameter for parameter in report.calibration}
    if not known and report.sensors is None:
        return
    words = f"{len(known)} parameters, below with one standard deviation" if known else "no"
    yield f"\ncalibrated  {words}"
    for field, title in _POINT_TITLES.items():
        columns = {f"{field}[{{}}].{axis}": axis for axis in "xyz"}
        yield from _table(report, known, columns, title)
    columns = {f"{field}[{{}}]": title for field, title in _CABLE_COLUMNS.items()}
    yield from _table(report, known, columns, "cable")
    alone = [parameter for name, parameter in known.items() if "[" not in name]
    width = max((len(parameter.name) for parameter in alone), default=0)
    start = "\n"
    for parameter in alone:
        unit = _UNITS_SHOWN.get(parameter.unit, (parameter.unit, 1.0))[0]
        yield f"{start}{parameter.name:<{width}}  {_number(parameter)} {unit}"
        start = ""
    yield from _sensors(report, with_table="length_offset" not in _fields(known))


def _fields(known: dict[str, CalibratedParameter]) -> set[str]:
    return {name.partition("[")[0] for name in known}


def _table(
    report: RobotReport, known: dict[str, CalibratedParameter], columns: dict[str, str], title: str
) -> Iterator[str]:
    """Yield a row for each cable; columns of which nothing is known are left out.

    Args:
        report: The robot.
        known: Calibrated parameters by name.
        columns: Titles by the pattern of the parameter's name.
        title: Title of the first column.
    """
    cables = report.robot.cable_names
    header, cells = [title], [list(cables)]
    for pattern, word in columns.items():
        column = [known.get(pattern.format(name)) for name in cables]
        units = {each.unit for each in column if each is not None}
        if units:
            unit = _UNITS_SHOWN.get(units.pop(), ("", 1.0))[0]
            header.append(f"{word} [{unit}]" if unit else word)
            cells.append(["-" if each is None else _number(each) for each in column])
    if len(header) > 1:
        yield "\n" + format_table(header, list(zip(*cells, strict=True)))


def _sensors(report: RobotReport, *, with_table: bool) -> Iterator[str]:
    """Describe how lengths and poses are read."""
    sensors, robot = report.sensors, report.robot
    if sensors is None:
        return
    if sensors.offset is not None and sensors.scale is not None and with_table:
        rows = list(zip(robot.cable_names, 1e3 * sensors.offset, sensors.scale, strict=True))
        yield "\n" + format_table(("cable", "offset [mm]", "scale"), rows)
    yield ""
    if sensors.offset is not None:
        delay = 1e3 * (sensors.delay or 0.0)
        lead = f", {'before' if delay > 0.0 else 'after'} poses by {abs(delay):.3g} ms"
        yield f"lengths     read as scale * unstrained length + offset{lead if delay else ''}"
    if sensors.tilt is not None:
        x, y = 1e3 * sensors.tilt
        turn = f"{np.degrees(sensors.turn):.4g} deg about z" if abs(sensors.turn) > 1e-9 else ""
        tilt = f"{x:.2f} mrad about x and {y:.2f} mrad about y"
        yield f"poses       in a frame turned by {', '.join(filter(None, (turn, tilt)))}"


def _number(parameter: CalibratedParameter) -> str:
    """Format a value with its sigma, to two digits of the sigma."""
    factor = _UNITS_SHOWN.get(parameter.unit, ("", 1.0))[1]
    value, sigma = parameter.value * factor, parameter.sigma * factor
    if not np.isfinite(value):
        return f"one number for cables that differ, +- {sigma:.2g}"
    if not sigma > 0.0:
        return f"{value:.{_EXACT_DIGITS}g} +- 0"
    digits = int(np.clip(1 - np.floor(np.log10(sigma)), 0, 9))
    return f"{value:.{digits}f} +- {sigma:.{digits}f}"
