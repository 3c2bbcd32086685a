"""Names of the single numbers of a robot that a calibration estimates.

========================== ======= ==========================================================
name                       unit    meaning
========================== ======= ==========================================================
``exit_points[C].x``       m       coordinate of the exit point of cable C in W; also y, z
``anchor_points[C].x``     m       coordinate of its anchor point in P; also y, z
``length_offset[C]``       m       reading of the encoder at unstrained length 0
``length_scale[C]``        1       change of the reading per unstrained length
``drum_radius[C]``         m       also ``drum_buildup[C]``
``axial_stiffness[C]``     N       also ``linear_density``, ``axial_damping``, ``run_length``;
                                   without ``[C]`` one number for all cables
``exit_friction[C]``       N m     also ``anchor_friction``, and ``length_hysteresis`` [m]; likewise
``capstan_friction[C]``    1       of the cable on its pulley; likewise
``length_delay``           s       by how much readings lead poses
``pose_tilt.x``            rad     of the frame of measured poses against W, about x of W; also y
``mass``                   kg      also ``drag``, ``angular_drag``
``angular_drag_axes.x``    1       factor of the angular drag about x of P; also y, z
``cable_drag``             1/s     air drag of the cables per mass
``center_of_mass.x``       m       in P; also y, z
``inertia.xx``             kg m^2  also yy, zz, xy, xz, yz
========================== ======= ==========================================================
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.robot.parameter_names import SCALAR_FIELDS, locate
from carosac_toolkit.robot.robot import Robot

_UNCALIBRATED_VALUES = {"length_offset": 0.0, "length_scale": 1.0, "length_delay": 0.0}


def values_of(robot: Robot, names: Sequence[str]) -> Array:
    """Return values of parameters, shape (k,); an uncalibrated robot reads true lengths.

    Raises:
        InvalidField: A name that the robot does not have.
    """
    return np.array([_get(robot, name) for name in names])


def with_values(robot: Robot, names: Sequence[str], values: Array) -> Robot:
    """Return a robot with other values of some parameters; their covariance is dropped.

    Args:
        robot: The robot.
        names: Parameters.
        values: shape (k,).

    Raises:
        InvalidField: A name that the robot does not have, or a value that it cannot have.
    """
    return replace(robot, **fields_with(robot, names, values))


def fields_with(robot: Robot, names: Sequence[str], values: Array) -> dict[str, Any]:
    """Return the changed fields of a robot with other values of some parameters.

    Those of its calibration become None, as with `with_values`.

    Args:
        robot: The robot.
        names: Parameters.
        values: shape (k,).

    Raises:
        InvalidField: A name that the robot does not have.
    """
    changed: dict[str, Any] = {}
    for name, value in zip(names, values, strict=True):
        field, where = locate(robot.cable_names, name)
        if field == "pose_tilt":
            tilt = changed.setdefault(field, _tilt(robot))
            tilt[where[0]] = value
            continue
        if not where:
            changed[field] = float(value)
            continue
        array = changed.setdefault(field, np.array(_array(robot, field)))
        array[where] = value
        if field == "inertia":
            array[where[::-1]] = value
    if "pose_tilt" in changed:
        about_z = _turned(_tilt(robot)).T @ _given(robot.pose_rotation)
        changed["pose_rotation"] = _turned(changed.pop("pose_tilt")) @ about_z
    if changed.keys() & _UNCALIBRATED_VALUES.keys():  # all of the length sensors, or nothing
        for field, usual in _UNCALIBRATED_VALUES.items():
            known = getattr(robot, field)
            each = usual if field in SCALAR_FIELDS else np.full(robot.n, usual)
            changed.setdefault(field, each if known is None else known)
    return changed | {"calibrated": None, "calibration_covariance": None}


def turn_between(before: Robot, after: Robot) -> Array:
    """Return the rotation from W of a robot to W of one whose measured poses are turned otherwise.

    Returns:
        shape (3, 3); identity where both see them alike.
    """
    return frame_turn(before.pose_rotation, after.pose_rotation)


def frame_turn(before: Array | None, after: Array | None) -> Array:
    """Return the rotation of `turn_between` by both `pose_rotation`."""
    return _given(after) @ _given(before).T


def _get(robot: Robot, name: str) -> float:
    """Return the value of one parameter."""
    field, where = locate(robot.cable_names, name)
    if field == "pose_tilt":
        return float(_tilt(robot)[where])
    if not where:
        value = getattr(robot, field)
        if value is None:
            value = _UNCALIBRATED_VALUES.get(field)
        if value is None:
            raise _unknown(robot, field)
        return float(value)
    entries = np.atleast_1d(_array(robot, field)[where])
    if np.ptp(entries) > 1e-12 * np.abs(entries).max():
        allowed = f"a name of each cable, {field}[{robot.cable_names[0]}]: they differ"
        raise InvalidField("parameter", repr(name), allowed)
    return float(entries[0])


def _array(robot: Robot, field: str) -> Array:
    """Return a field as an array; its neutral value if the robot has no calibration."""
    value: Array | None = getattr(robot, field)
    if value is not None:
        return value
    if field not in _UNCALIBRATED_VALUES:
        raise _unknown(robot, field)
    return np.full(robot.n, _UNCALIBRATED_VALUES[field])


def _unknown(robot: Robot, field: str) -> InvalidField:
    """Return the error about a parameter that a robot does not have."""
    return InvalidField("parameter", f"'{field}'", f"one that robot {robot.name!r} has")


def _given(rotation: Array | None) -> Array:
    """Return the rotation from the frame of measured poses to W, (3, 3)."""
    return np.eye(3) if rotation is None else rotation


def _tilt(robot: Robot) -> Array:
    """Return the rotation vector in W that tilts the z axis of the pose frame, (2,) [rad].

    The rotation of the frame is a turn about z followed by this tilt.
    """
    up = _given(robot.pose_rotation)[:, 2]
    sine = float(np.hypot(up[0], up[1]))
    angle = float(np.arctan2(sine, up[2]))
    tilt: Array = np.array([-up[1], up[0]]) * (angle / sine if sine > 0.0 else 1.0)
    return tilt


def _turned(tilt: Array) -> Array:
    """Return the rotation of a tilt about x and y."""
    angle = float(np.hypot(tilt[0], tilt[1]))
    cross = np.array([[0.0, 0.0, tilt[1]], [0.0, 0.0, -tilt[0]], [-tilt[1], tilt[0], 0.0]])
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    rotation: Array = np.eye(3) + first * cross + second * cross @ cross
    return rotation
