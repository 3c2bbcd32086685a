"""What a robot is and how it hangs at home, as numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from carosac_toolkit.arrays import Array
from carosac_toolkit.robot import Robot

if TYPE_CHECKING:
    from carosac_toolkit.physics.statics import Equilibrium

SHAPE_SAMPLES = 101


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotReport:
    """A robot at its home position.

    Attributes:
        robot: The robot.
        equilibrium: How it hangs at home, B = 1; look at `feasible` first.
        shape: Points along each cable at home in W [m], shape (n, samples, 3); straight lines
            where there is no equilibrium.
        sag: Largest distance of each cable to its chord at home [m], shape (n,); NaN where there
            is no equilibrium.
        frequencies: Natural frequencies at home [Hz], slowest first, shape (6,); negative for an
            unstable mode, NaN where there is no equilibrium.
    """

    robot: Robot
    equilibrium: Equilibrium
    shape: Array
    sag: Array
    frequencies: Array

    @property
    def constraint(self) -> str:
        """``under-constrained`` (n < 6), ``exactly constrained`` or ``over-constrained``."""
        if self.robot.n == 6:
            return "exactly constrained"
        return "under-constrained" if self.robot.n < 6 else "over-constrained"

    @property
    def suspended(self) -> bool:
        """Whether every cable pulls up at home, so that only gravity keeps the cables taut."""
        return is_suspended(self.robot, self.equilibrium.position, self.equilibrium.rotation)

    @property
    def feasible(self) -> bool:
        """Whether the robot hangs stably at home with all tensions within their limits."""
        tension = self.equilibrium.tension[0]
        robot = self.robot
        within = (tension >= robot.tension_min - 1e-6) & (tension <= robot.tension_max + 1e-6)
        converged, stable = self.equilibrium.converged[0], self.equilibrium.stable[0]
        return bool(converged and stable and within.all())

    @property
    def tilt(self) -> float:
        """Angle between the z axes of platform and world at home [rad]."""
        return float(np.arccos(np.clip(self.equilibrium.rotation[0, 2, 2], -1.0, 1.0)))

    def data(self) -> dict[str, Any]:
        """All numbers under names with units, ready for JSON; NaN is unknown."""
        robot, home = self.robot, self.equilibrium
        known = 1.0 if home.converged[0] else np.nan
        per_cable = {
            "exit_point_m": robot.exit_points,
            "anchor_point_m": robot.anchor_points,
            "pulley_radius_m": robot.pulley_radius,
            "run_length_m": robot.run_length,
            "linear_density_kg_per_m": robot.linear_density,
            "axial_stiffness_N": robot.axial_stiffness,
            "tension_min_N": robot.tension_min,
            "tension_max_N": robot.tension_max,
            "length_min_m": robot.length_min,
            "length_max_m": robot.length_max,
            "home_unstrained_length_m": home.unstrained_length[0] * known,
            "home_tension_N": home.tension[0] * known,
            "home_sag_m": self.sag,
        }
        return {
            "name": robot.name,
            "description": robot.description,
            "licence": robot.licence,
            "n": robot.n,
            "constraint": self.constraint,
            "suspended": self.suspended,
            "gravity_m_per_s2": robot.gravity,
            "mass_kg": robot.mass,
            "center_of_mass_m": robot.center_of_mass,
            "inertia_kg_m2": robot.inertia,
            "workspace_min_m": robot.workspace_min,
            "workspace_max_m": robot.workspace_max,
            "cables": [
                {"name": name, **{key: value[i] for key, value in per_cable.items()}}
                for i, name in enumerate(robot.cable_names)
            ],
            "home": {
                "position_m": robot.home_position,
                "rotation": home.rotation[0] * known,
                "tilt_rad": self.tilt * known,
                "feasible": self.feasible,
                "converged": bool(home.converged[0]),
                "stable": bool(home.stable[0]),
                "residual_N": home.residual[0],
                "natural_frequencies_Hz": self.frequencies,
            },
            "provenance": dict(robot.provenance),
        }


def report_robot(robot: Robot) -> RobotReport:
    """Work out how a robot hangs at home.

    Args:
        robot: The robot, n cables.

    Returns:
        The report; `RobotReport.feasible` says whether there is an equilibrium at home within the
        limits.
    """
    from carosac_toolkit.physics import modes, statics

    equilibrium = statics.inverse_kinematics(robot, robot.home_position[None])
    if equilibrium.converged[0]:
        shape = statics.cable_shape(robot, equilibrium, SHAPE_SAMPLES)[0]
        sag = statics.sag(robot, equilibrium, samples=SHAPE_SAMPLES)[0]
        frequencies = modes.natural_frequencies(robot, equilibrium)[0]
    else:
        anchors = robot.home_position + robot.anchor_points @ robot.home_rotation.T
        share = np.linspace(0.0, 1.0, SHAPE_SAMPLES)[:, None]
        shape = robot.exit_points[:, None] * (1.0 - share) + anchors[:, None] * share
        sag, frequencies = np.full(robot.n, np.nan), np.full(6, np.nan)
    return RobotReport(
        robot=robot, equilibrium=equilibrium, shape=shape, sag=sag, frequencies=frequencies
    )


def is_suspended(robot: Robot, position: Array, rotation: Array) -> bool:
    """Tell whether every cable pulls up at these poses.

    Args:
        robot: The robot, n cables.
        position: Platform origin in W [m], shape (B, 3).
        rotation: From P to W, shape (B, 3, 3).
    """
    anchors = position[:, None, :] + np.einsum("bij,nj->bni", rotation, robot.anchor_points)
    return bool((robot.exit_points[:, 2] > anchors[..., 2]).all())
