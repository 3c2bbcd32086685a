"""Hash of the machine that a robot file describes: geometry, cables, drums, masses, limits, units.

Two files of one machine have the same hash whatever their comments, order of keys, units and
network addresses; any number that changes what a command does changes it. A field that a later
version adds to `Robot` counts by itself, but only where it is not 0, or what it is where a file
says nothing, so that hashes stay the same for robots without the new effect.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import fields
from typing import Any

import numpy as np

from carosac_toolkit.robot.hardware import Hardware
from carosac_toolkit.robot.robot import Robot

SIGNIFICANT_DIGITS = 12  # as in written robot files
DECIMALS = 14  # below them a number in SI units is rounding, such as 5.6e-17 instead of 0
_NOT_OF_THE_MACHINE = (  # texts, where a run starts, uncertainty, sensors of recordings
    "name", "description", "licence", "provenance", "home_position", "home_rotation",
    "exit_covariance", "calibrated", "calibration_covariance", "length_offset", "length_scale",
    "length_delay", "pose_rotation", "model_error", "hardware",
)  # fmt: skip
_USUAL: dict[str, Any] = {"angular_drag_axes": 1.0, "cable_drag": None}  # where it is not 0


def machine_hash(robot: Robot) -> int:
    """Return a hash of 64 bits of all numbers that describe the machine."""
    return int.from_bytes(hashlib.sha256(machine_text(robot).encode()).digest()[:8], "big")


def machine_text(robot: Robot) -> str:
    """Return the text that is hashed: JSON, keys sorted, SI units, cables in their order.

    Of the section ``hardware`` it has sign and scale: homing sets the offset.
    """
    hardware = robot.hardware or Hardware.loopback(robot.n)
    values = {f.name: getattr(robot, f.name) for f in fields(Robot)}
    for name in _NOT_OF_THE_MACHINE:
        del values[name]
    values |= {"hardware.sign": hardware.sign, "hardware.scale": hardware.scale}
    known = {k: _rounded(v) for k, v in values.items() if _counts(k, v)}
    return json.dumps(known, sort_keys=True)


def _counts(name: str, value: Any) -> bool:
    """Return whether a field is other than without its effect."""
    if name in _USUAL:
        return not np.all(value == _USUAL[name])
    return isinstance(value, tuple) or bool(np.any(value))


def _rounded(value: Any) -> Any:
    """Return numbers as texts of `SIGNIFICANT_DIGITS`, in lists of the same shape."""
    if isinstance(value, np.ndarray | tuple):
        return [_rounded(entry) for entry in value]
    if isinstance(value, float):
        return f"{round(value, DECIMALS) + 0.0:.{SIGNIFICANT_DIGITS}g}"  # + 0.0: no -0
    return value
