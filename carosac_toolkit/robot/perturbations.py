"""Conditions: random differences of the plant from the nominal robot.

A condition is drawn once per seed. Controllers and estimators keep the nominal robot; only the
driver gets the plant. ``nominal-2`` is stated in parts of the robot, and equal to ``nominal-1`` on
``carosac``. Conditions of one's own are files (`carosac_toolkit.robot.condition_file`).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.robot.sizes import CAROSAC_SIZES, Part


@dataclass(frozen=True, kw_only=True)
class Condition:
    """One standard deviation of everything that is drawn.

    Shares are logarithmic: a factor is exp(share * z) with z standard normal, so it stays positive.
    Distances, force and time may be parts of the robot (`Part`); `of` turns them into numbers.

    Attributes:
        mass: Share.
        center_of_mass: Per axis [m].
        inertia: Share, the same for all entries.
        axial_stiffness: Share, one for all cables, which are of one batch.
        linear_density: Share, one for all cables.
        exit_points: Per axis and cable [m].
        anchor_points: Per axis and cable [m].
        winch_lag: Share, per cable.
        drag: Logarithm of the factor on air drag, linear and angular alike.
        wind_force: Standard deviation of the force of the wind per horizontal axis [N].
        wind_time: Its correlation time [s].
    """

    mass: float = 0.0
    center_of_mass: float | Part = 0.0
    inertia: float = 0.0
    axial_stiffness: float = 0.0
    linear_density: float = 0.0
    exit_points: float | Part = 0.0
    anchor_points: float | Part = 0.0
    winch_lag: float = 0.0
    drag: float = 0.0
    wind_force: float | Part = 0.0
    wind_time: float | Part = 2.0

    def of(self, robot: Robot) -> PlainCondition:
        """Return the condition in metres, newtons and seconds for a robot."""
        return PlainCondition(
            **{item.name: part_of(robot, getattr(self, item.name)) for item in fields(self)}
        )


@dataclass(frozen=True, kw_only=True)
class PlainCondition:
    """A condition for one robot; attributes as those of `Condition`, all of them numbers."""

    mass: float
    center_of_mass: float
    inertia: float
    axial_stiffness: float
    linear_density: float
    exit_points: float
    anchor_points: float
    winch_lag: float
    drag: float
    wind_force: float
    wind_time: float


def part_of(robot: Robot, value: float | Part) -> float:
    """Return a number as it is, and a part of a robot in its SI unit."""
    return value.of(robot) if isinstance(value, Part) else value


CONDITIONS_BY_NAME = {
    "none": Condition(),
    "nominal-1": Condition(
        mass=0.03,
        center_of_mass=0.01,
        inertia=0.10,
        axial_stiffness=0.20,
        linear_density=0.02,
        exit_points=5e-3,
        anchor_points=1e-3,
        winch_lag=0.20,
        drag=float(np.log(1.5)),
        wind_force=1.0,
    ),
    "nominal-2": Condition(
        mass=0.03,
        center_of_mass=Part(0.01, "platform", at=CAROSAC_SIZES["platform"]),  # 3.4 %
        inertia=0.10,
        axial_stiffness=0.20,
        linear_density=0.02,
        exit_points=Part(5e-3, "frame", at=CAROSAC_SIZES["frame"]),  # 0.07 %
        anchor_points=Part(1e-3, "platform", at=CAROSAC_SIZES["platform"]),  # 0.34 %
        winch_lag=0.20,
        drag=float(np.log(1.5)),
        wind_force=Part(1.0, "weight", at=CAROSAC_SIZES["weight"]),  # 0.43 %
        wind_time=Part(2.0, "time", at=CAROSAC_SIZES["time"]),  # 2.1 times
    ),
}
DEFAULT_CONDITION = "nominal-2"
SEEDED_AS = {"nominal-2": "nominal-1"}  # whose seeds a condition draws from


def draw_plant(
    robot: Robot, condition: Condition | PlainCondition, rng: np.random.Generator
) -> Robot:
    """Draw a robot that differs from the nominal one by a condition.

    The order of the draws is fixed, so that one seed is one plant whatever else is compared.

    Args:
        robot: The nominal robot.
        condition: Standard deviations of the draw.
        rng: Source of the draw.

    Returns:
        The plant; its name is changed if anything was drawn.
    """
    n = robot.n
    if isinstance(condition, Condition):
        condition = condition.of(robot)

    def factor(share: float) -> float:
        return float(np.exp(share * rng.standard_normal()))

    changed = replace(
        robot,
        mass=robot.mass * factor(condition.mass),
        center_of_mass=robot.center_of_mass + condition.center_of_mass * rng.standard_normal(3),
        inertia=robot.inertia * factor(condition.inertia),
        axial_stiffness=robot.axial_stiffness * factor(condition.axial_stiffness),
        linear_density=robot.linear_density * factor(condition.linear_density),
        exit_points=robot.exit_points + condition.exit_points * rng.standard_normal((n, 3)),
        anchor_points=robot.anchor_points + condition.anchor_points * rng.standard_normal((n, 3)),
        winch_lag=robot.winch_lag * np.exp(condition.winch_lag * rng.standard_normal(n)),
    )
    drag = factor(condition.drag)
    return replace(changed, drag=robot.drag * drag, angular_drag=robot.angular_drag * drag)
