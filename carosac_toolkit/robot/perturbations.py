"""Conditions: random differences of the plant from the nominal robot.

A condition is drawn once per seed. Controllers and estimators keep the nominal robot; only the
driver gets the plant.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.robot.robot import Robot


@dataclass(frozen=True, kw_only=True)
class Condition:
    """One standard deviation of everything that is drawn.

    Shares are logarithmic: a factor is exp(share * z) with z standard normal, so it stays positive.

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
    center_of_mass: float = 0.0
    inertia: float = 0.0
    axial_stiffness: float = 0.0
    linear_density: float = 0.0
    exit_points: float = 0.0
    anchor_points: float = 0.0
    winch_lag: float = 0.0
    drag: float = 0.0
    wind_force: float = 0.0
    wind_time: float = 2.0


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
}


def find_condition(name: str) -> Condition:
    """Return a condition by its name.

    Raises:
        InvalidField: There is none of that name.
    """
    if name not in CONDITIONS_BY_NAME:
        raise InvalidField("perturbation", repr(name), f"one of {sorted(CONDITIONS_BY_NAME)}")
    return CONDITIONS_BY_NAME[name]


def draw_plant(robot: Robot, condition: Condition, rng: np.random.Generator) -> Robot:
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
