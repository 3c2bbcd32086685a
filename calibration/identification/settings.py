"""Settings of an identification: prior sigmas, and how the fit is computed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.scaled import Scaled

# Of candidates that are held else.
CANDIDATE_SIGMAS = {
    "inertia_products": 0.15, "angular_drag_axes": 0.5, "cable_drag": 1.0, "capstan_friction": 0.1,
}  # fmt: skip
_NO_SIGMAS = ("rate", "iterations", "time_step")


@dataclass(frozen=True, kw_only=True)
class IdentificationSettings:
    """One standard deviation of each parameter where the robot file knows none; 0 holds it.

    Shares are logarithmic: 0.7 is a factor of two. Defaults with a size are those of `carosac`;
    they grow with the robot.

    Attributes:
        exit_points: Per axis [m].
        anchor_points: Per axis [m].
        length_offset: [m].
        length_scale: [1].
        length_delay: [s].
        center_of_mass: Per axis [m].
        mass: Share.
        inertia: Share of each principal spread of the mass.
        inertia_products: Off the diagonal, over the root of the spreads along both axes.
        linear_density: Share, one for all cables.
        axial_stiffness: Share, one for all cables.
        axial_damping: Share, one for all cables.
        run_length: Of cable between winch and exit point, one for all cables [m].
        exit_friction: Dry moment at the exits, one for all cables, over the weight per cable times
            the length of the cables at home.
        anchor_friction: At the anchor points, over the weight per cable times their lever.
        capstan_friction: Coefficient of the cable on its pulley or eyelet, one for all cables.
        length_hysteresis: Of each winch [m].
        pose_tilt: Of the frame of the poses against gravity, about x and y [rad]. Exit
            points that are held stay where they are in W.
        drag: Share.
        angular_drag: Share.
        angular_drag_axes: Share of the factor about each axis of the platform.
        cable_drag: Share of the air drag of the cables.
        rate: Poses per second that are fitted, at most [Hz].
        iterations: At most.
        time_step: Of the simulator, at most [s].
    """

    exit_points: float = Scaled(0.02, "m")
    anchor_points: float = Scaled(0.005, "m")
    length_offset: float = Scaled(0.05, "m")
    length_scale: float = 0.002
    length_delay: float = 0.05
    center_of_mass: float = Scaled(0.02, "m")
    mass: float = 0.05
    inertia: float = 0.3
    inertia_products: float = 0.0
    linear_density: float = 0.05
    axial_stiffness: float = 0.7
    axial_damping: float = 1.0
    run_length: float = Scaled(2.0, "m")
    exit_friction: float = 1e-3
    anchor_friction: float = 0.01
    capstan_friction: float = 0.0
    length_hysteresis: float = Scaled(1e-3, "m")
    pose_tilt: float = 0.01
    drag: float = 1.0
    angular_drag: float = 1.0
    angular_drag_axes: float = 0.0
    cable_drag: float = 0.0
    rate: float = Scaled(10.0, "Hz")
    iterations: int = 25
    time_step: float = Scaled(1.0 / 140.0, "s")

    def __post_init__(self) -> None:
        """Refuse what is no standard deviation."""
        for field in fields(self):
            value = getattr(self, field.name)
            lowest = "> 0" if field.name in _NO_SIGMAS else ">= 0"
            if not (math.isfinite(value) and (value > 0.0 or (value == 0.0 and lowest == ">= 0"))):
                raise InvalidField(field.name, value, f"{field.name} {lowest}, finite")

    def with_candidates(self, names: Sequence[str]) -> IdentificationSettings:
        """Free what is held of some parameters, by a usual sigma.

        Raises:
            InvalidField: A name that is of no parameters.
        """
        usual: dict[str, Any] = {
            field.name: field.default for field in fields(self) if field.name not in _NO_SIGMAS
        }
        usual |= CANDIDATE_SIGMAS
        for name in names:
            if name not in usual:
                raise InvalidField("candidates", repr(name), f"any of {', '.join(usual)}")
        return replace(self, **{name: getattr(self, name) or usual[name] for name in names})

    def without(self, names: Sequence[str]) -> IdentificationSettings:
        """Hold some parameters."""
        held: dict[str, Any] = dict.fromkeys(names, 0.0)
        return replace(self, **held)
