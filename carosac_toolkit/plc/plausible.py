"""Check of the numbers of a PLC: nothing that no winch can do goes on to estimators and limits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.plc.blocks import DriveStatus
from carosac_toolkit.robot.hardware import Hardware
from carosac_toolkit.robot.robot import Robot

LENGTH_RATIO_MAX = 1000.0  # of the longest cable: encoders may count from anywhere before homing
RATE_RATIO_MAX = 2.0  # of the largest speed of a winch: overspeed, and noise of encoders
TENSION_RATIO_MAX = 10.0  # of the largest tension: jerks, and load cells that are off


def check_plausible(values: Mapping[str, Any], robot: Robot, hardware: Hardware) -> None:
    """Refuse numbers that are not finite, or beyond what winches can do.

    Args:
        values: Members of `blocks.to_host`.
        robot: Robot description with the limits, n cables.
        hardware: Units of the PLC.

    Raises:
        InvalidField: Such a number, named by field and cable; an error of the guard follows from
            the name of the field (`carosac_toolkit.safety.guard.inner.error_finding`).
    """
    unit = hardware.unit
    limits = {
        "length": (unit * values["length"], "m", LENGTH_RATIO_MAX * robot.length_max),
        "length_rate": (unit * values["rate"], "m/s", RATE_RATIO_MAX * robot.speed_max),
    }
    if values["has_tension"]:
        limits["tension"] = values["tension"], "N", TENSION_RATIO_MAX * robot.tension_max
    if (values["drive_status"] != DriveStatus.OFF).any():
        distance = unit * (values["set_length"] - values["length"])
        limits["set_length"] = distance, "m from length", robot.length_max
    for name, (numbers, unit_name, limit) in limits.items():
        wrong = ~(np.abs(numbers) <= limit)  # also what is not a number
        if wrong.any():
            i = int(np.argmax(wrong))
            raise InvalidField(
                f"{name}[{robot.cable_names[i]}]", f"{numbers[i]:.4g} {unit_name} from the PLC",
                f"at most {limit[i]:.4g} {unit_name.partition(' ')[0]} either way, finite",
            )  # fmt: skip
