"""Names of a robot's parameters: their units, and where in a `Robot` they stand.

`carosac_toolkit.robot.parameters` lists them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

from carosac_toolkit.base.errors import InvalidField

_FIELD_UNITS = {
    "exit_points": "m", "anchor_points": "m", "length_offset": "m", "length_scale": "1",
    "drum_radius": "m", "drum_buildup": "m", "axial_stiffness": "N", "linear_density": "kg/m",
    "axial_damping": "N*s", "run_length": "m", "length_delay": "s", "pose_tilt": "rad",
    "mass": "kg", "drag": "N*s/m", "angular_drag": "N*m*s/rad", "center_of_mass": "m",
    "inertia": "kg*m^2", "exit_friction": "N*m", "anchor_friction": "N*m",
    "capstan_friction": "1", "length_hysteresis": "m", "angular_drag_axes": "1",
    "cable_drag": "1/s",
}  # fmt: skip
_POINT_FIELDS = ("exit_points", "anchor_points")  # of each cable
_CABLE_FIELDS = ("length_offset", "length_scale", "drum_radius", "drum_buildup")  # a number of each
_SHARED_FIELDS = (
    "axial_stiffness",
    "linear_density",
    "axial_damping",
    "run_length",
    "exit_friction",
    "anchor_friction",
    "capstan_friction",
    "length_hysteresis",
)  # of each, or of all
SCALAR_FIELDS = ("length_delay", "mass", "drag", "angular_drag", "cable_drag")
_AXIS_FIELDS = ("center_of_mass", "angular_drag_axes", "pose_tilt")  # the last one has no z
_PARAMETER_PATTERN = re.compile(r"(?P<field>\w+)(?:\[(?P<cable>.+)\])?(?:\.(?P<axis>[xyz]{1,2}))?")


def unit_of(name: str) -> str:
    """Return the SI unit of a parameter, as in robot files.

    Raises:
        InvalidField: The name is of no parameter.
    """
    return _FIELD_UNITS[_field(name)["field"]]


def field_of(name: str) -> str:
    """Return the field of a parameter: ``exit_points`` for ``exit_points[C].x``."""
    return name.split("[")[0].split(".")[0]


def point_names(field: str, cables: Sequence[str]) -> list[str]:
    """Return the coordinate names of a point of each cable, x, y, z of the first one first."""
    return [f"{field}[{cable}].{axis}" for cable in cables for axis in "xyz"]


def check_names(cable_names: Sequence[str], names: Sequence[str]) -> None:
    """Refuse what names no parameter of a robot with these cables, and names that come twice.

    Raises:
        InvalidField: Names the first one.
    """
    for k, name in enumerate(names):
        if name in names[:k]:
            raise InvalidField(f"parameters[{k}]", repr(name), "each parameter once")
        locate(tuple(cable_names), name)


@lru_cache(maxsize=1024)  # identification asks for the same names over and over
def locate(cable_names: tuple[str, ...], name: str) -> tuple[str, tuple[Any, ...]]:
    """Return the field of a parameter, and its index there (empty for a single number)."""
    match = _field(name)
    field, cable, axis = match["field"], match["cable"], match["axis"]
    if cable is not None and cable not in cable_names:
        raise InvalidField("parameter", repr(name), f"a cable of {list(cable_names)}")
    number = None if cable is None else list(cable_names).index(cable)
    index: tuple[Any, ...] | None = None
    if field in _POINT_FIELDS and number is not None and axis in ("x", "y", "z"):
        index = (number, "xyz".index(axis))
    elif field in _CABLE_FIELDS + _SHARED_FIELDS and number is not None and axis is None:
        index = (number,)
    elif field in _SHARED_FIELDS and number is None and axis is None:
        index = (slice(None),)
    elif field in SCALAR_FIELDS and number is None and axis is None:
        index = ()
    elif field in _AXIS_FIELDS and number is None and axis in ("x", "y", "z"):
        index = ("xyz".index(axis),)
    elif field == "inertia" and number is None and axis in ("xx", "yy", "zz", "xy", "xz", "yz"):
        index = ("xyz".index(axis[0]), "xyz".index(axis[1]))
    if index is None or (field == "pose_tilt" and axis == "z"):
        raise InvalidField(
            "parameter", repr(name), "a parameter listed in carosac_toolkit.robot.parameters"
        )
    return field, index


def _field(name: str) -> re.Match[str]:
    """Split a name into its parts."""
    match = _PARAMETER_PATTERN.fullmatch(name)
    if match is None or match["field"] not in _FIELD_UNITS:
        raise InvalidField("parameter", repr(name), f"a name such as {', '.join(_FIELD_UNITS)}")
    return match
