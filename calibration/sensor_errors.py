"""Errors of sensors that are no parameters of a robot file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from carosac_toolkit.base.tables import Rows, fit, terminal_width
from carosac_toolkit.reports.page import table

SENSOR_WORDS = {
    "length": ("lengths", "mm", 1e3), "tension": ("load cells", "N", 1.0),
    "attitude": ("the AHRS", "degrees", np.rad2deg(1.0)),
    "inclination": ("the inclinometer", "degrees", np.rad2deg(1.0)),
    "swivel_angle": ("swivel angles", "degrees", np.rad2deg(1.0)),
}  # fmt: skip
SENSOR_UNITS = {
    "tension_scale": "1", "tension_offset": "N", "swivel_offset": "rad", "mounting": "rad",
    "heading": "rad",
}  # fmt: skip
SENSOR_HEADER = ("error of a sensor", "unit", "known to", "found", "1 sigma")
SENSOR_GROUPS = (2, 3)


@dataclass(frozen=True, kw_only=True)
class SensorError:
    """Estimated error of a sensor that is no parameter of a robot file.

    Attributes:
        name: ``tension_scale[C]`` (reading per tension, less 1), ``tension_offset[C]`` [N],
            ``swivel_offset[C]`` [rad], ``mounting.x`` (rotation vector from the sensor to P [rad],
            also y, z) or ``heading`` (of W in the level frame of the AHRS [rad]).
        unit: Its SI unit.
        value: Estimated.
        sigma: One standard deviation.
        prior_sigma: The same before; the prior mean is 0.
    """

    name: str
    unit: str
    value: float
    sigma: float
    prior_sigma: float


def sensor_rows(errors: Sequence[SensorError]) -> Rows:
    """Return one row for each error of a sensor."""
    return [
        (s.name, s.unit, f"{s.prior_sigma:.2g}", f"{s.value:+.4g}", f"{s.sigma:.2g}")
        for s in errors
    ]


def print_sensors(errors: Sequence[SensorError]) -> None:
    """Print the table of errors, if there are any, within the width of the terminal."""
    if errors:
        print("\nerrors of the other sensors:")
        print(fit(SENSOR_HEADER, sensor_rows(errors), SENSOR_GROUPS, terminal_width()))


def sensors_html(errors: Sequence[SensorError]) -> str:
    """Return the table of errors, or nothing where there are none."""
    if not errors:
        return ""
    return (
        "<h2>Errors of other sensors</h2><p>They do not go into the robot file. The scale of a "
        "load cell is given less 1. Known to: one standard deviation before.</p>"
        + table(SENSOR_HEADER, sensor_rows(errors), left=2)
    )


def sensor_data(errors: Sequence[SensorError]) -> dict[str, dict[str, Any]]:
    """Return every error of a sensor by name, ready for JSON."""
    return {
        s.name: {
            "value": s.value, "sigma": s.sigma, "prior_sigma": s.prior_sigma, "unit": s.unit,
        }
        for s in errors
    }  # fmt: skip
