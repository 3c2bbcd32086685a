"""The same robot in another size: all that its physics depends on, scaled by Froude's law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from carosac_toolkit.base.numbers import check_positive
from carosac_toolkit.base.scaled import Ratios
from carosac_toolkit.robot.model_error import MODEL_ERROR_UNITS, ModelError
from carosac_toolkit.robot.robot import Robot

UNITS_BY_FIELD: Mapping[str, str] = {
    "exit_points": "m", "exit_covariance": "m^2", "pulley_radius": "m", "run_length": "m",
    "anchor_points": "m", "linear_density": "kg/m", "axial_stiffness": "N", "axial_damping": "N s",
    "exit_friction": "N m", "anchor_friction": "N m", "length_hysteresis": "m",
    "cable_diameter": "m", "tension_min": "N", "tension_max": "N", "speed_max": "m/s",
    "acceleration_max": "m/s^2", "winch_lag": "s", "length_min": "m", "length_max": "m",
    "drum_radius": "m", "drum_buildup": "m", "mass": "kg", "center_of_mass": "m",
    "inertia": "kg m^2", "drag": "N s/m", "angular_drag": "N m s", "cable_drag": "1/s",
    "workspace_min": "m", "workspace_max": "m", "home_position": "m", "length_offset": "m",
    "length_delay": "s",
}  # fmt: skip


def similarity(factor: float) -> Ratios:
    """Return ratios of mass, length and time under which gravity and densities stay as they are."""
    check_positive("factor", factor)
    return Ratios(mass=factor**3, length=factor, time=float(np.sqrt(factor)))


def similar_robot(robot: Robot, factor: float) -> Robot:
    """Return the robot in another size; all of its dimensionless results stay the same.

    Lengths grow by the factor, times and speeds by its root, masses and forces by its cube;
    accelerations stay. Stiffness grows as a force, which no cable of the same material does.

    Args:
        robot: Robot description.
        factor: Of its lengths.

    Returns:
        The other robot, without hardware and without what a calibration found.
    """
    ratios = similarity(factor)
    changed: dict[str, Any] = {}
    for name, unit in UNITS_BY_FIELD.items():
        value = getattr(robot, name)
        if value is not None:
            changed[name] = value * ratios.of_unit(unit)
    error = robot.model_error
    if error is not None:
        changed["model_error"] = ModelError(**{
            name: getattr(error, name) * ratios.of_unit(unit)
            for name, unit in MODEL_ERROR_UNITS.items()
        })  # fmt: skip
    return replace(
        robot, **changed, name=f"{robot.name} x {factor:g}", hardware=None, calibrated=None,
        calibration_covariance=None,
    )  # fmt: skip


def unscaled_fields() -> set[str]:
    """Return the fields of a robot that do not depend on its size."""
    return {item.name for item in fields(Robot)} - set(UNITS_BY_FIELD)
