"""Numbers of a robot: its description, and its equilibrium at home."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.inspection import findings
from carosac_toolkit.inspection.home import RobotAtHome
from carosac_toolkit.physics.motion.cable_drag import cable_drag_of
from carosac_toolkit.robot.parameter_names import unit_of
from carosac_toolkit.robot.parameters import values_of, with_values
from carosac_toolkit.robot.robot import Robot

if TYPE_CHECKING:
    from carosac_toolkit.physics.rest.statics import Equilibrium
    from carosac_toolkit.robot.schema import RobotFile

CABLE_SHAPE_POINTS = 101


class CalibratedParameter(NamedTuple):
    """Parameter that a calibration estimated.

    Attributes:
        name: Name as in `carosac_toolkit.robot.parameters`.
        value: Value of the robot; NaN where one number was estimated for cables that now differ.
        sigma: One standard deviation.
        unit: Unit of both.
    """

    name: str
    value: float
    sigma: float
    unit: str


class SensorReport(NamedTuple):
    """Sensor calibration in the robot file.

    Attributes:
        offset: Reading of length sensors at unstrained length 0 [m], (n,); None: not calibrated.
        scale: Change of the reading per unstrained length, (n,); None: not calibrated.
        delay: By how much their readings lead poses [s]; None: not calibrated.
        tilt: Of the frame of measured poses about x and y of W [rad], (2,); None: it is W.
        turn: Of that frame about z, before the tilt [rad].
    """

    offset: Array | None
    scale: Array | None
    delay: float | None
    tilt: Array | None
    turn: float


class RobotReport(RobotAtHome):
    """Robot at its home position, judged."""

    @property
    def constraint(self) -> str:
        """``under-constrained`` (n < 6), ``exactly constrained`` or ``over-constrained``."""
        if self.robot.n == 6:
            return "exactly constrained"
        return "under-constrained" if self.robot.n < 6 else "over-constrained"

    @property
    def suspended(self) -> bool:
        """True if every cable pulls up at home, so that only gravity keeps the cables taut."""
        return is_suspended(self.robot, self.equilibrium.position, self.equilibrium.rotation)

    @cached_property
    def problems(self) -> tuple[str, ...]:
        """Reasons why the robot cannot stay at home, in words; empty if it can."""
        return tuple(findings.problems(self))

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """Suspected mistakes of a robot that may still work, in words."""
        return tuple(findings.warnings(self))

    @property
    def feasible(self) -> bool:
        """True if the robot can stay at home: stable, within the limits of tension and length."""
        return not self.problems

    @cached_property
    def calibration(self) -> tuple[CalibratedParameter, ...]:
        """Every parameter that a calibration estimated, as the robot file has it."""
        robot = self.robot
        if robot.calibrated is None or robot.calibration_covariance is None:
            return ()
        sigma = np.sqrt(np.maximum(np.diag(robot.calibration_covariance), 0.0))
        return tuple(
            CalibratedParameter(name, _value(robot, name), float(each), unit_of(name))
            for name, each in zip(robot.calibrated, sigma, strict=True)
        )

    @property
    def sensors(self) -> SensorReport | None:
        """Sensor calibration in the robot file, or None."""
        robot = self.robot
        known = (robot.length_offset, robot.length_scale, robot.length_delay, robot.pose_rotation)
        if all(value is None for value in known):
            return None
        tilt, turn = None, 0.0
        if robot.pose_rotation is not None:
            tilt = values_of(robot, ("pose_tilt.x", "pose_tilt.y"))
            rest = with_values(robot, ("pose_tilt.x", "pose_tilt.y"), np.zeros(2)).pose_rotation
            assert rest is not None
            turn = float(np.arctan2(rest[1, 0], rest[0, 0]))
        return SensorReport(robot.length_offset, robot.length_scale, robot.length_delay, tilt, turn)

    def data(self) -> dict[str, Any]:
        """Return all numbers under names with units, ready for JSON; NaN is unknown."""
        robot = self.robot
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
            "air_drag_N_s_per_m": robot.drag,
            "angular_air_drag_N_m_s": robot.angular_drag * robot.angular_drag_axes,
            "cable_air_drag_per_s": cable_drag_of(robot),
            "payloads": [
                {
                    "name": payload.name,
                    "mass_kg": payload.mass,
                    "center_of_mass_m": payload.center_of_mass,
                    "inertia_kg_m2": payload.inertia,
                }
                for payload in (self.file.platform.payloads if self.file is not None else [])
            ],
            "workspace_min_m": robot.workspace_min,
            "workspace_max_m": robot.workspace_max,
            "cables": self._cable_data(),
            "home": self._home_data(),
            "sensors": self._sensor_data(),
            "calibration": {
                estimate.name: {
                    "value": estimate.value,
                    "sigma": estimate.sigma,
                    "unit": estimate.unit,
                }
                for estimate in self.calibration
            },
            "problems": self.problems,
            "warnings": self.warnings,
            "provenance": dict(robot.provenance),
        }

    def _cable_data(self) -> list[dict[str, Any]]:
        """Return one mapping per cable."""
        robot, home = self.robot, self.equilibrium
        known = 1.0 if home.converged[0] else np.nan
        pulley = robot.pulley_radius > 0.0
        per_cable = {
            "exit_point_m": robot.exit_points,
            "anchor_point_m": robot.anchor_points,
            "pulley_radius_m": robot.pulley_radius,
            "swivel_axis": [robot.swivel_axis[i] if pulley[i] else None for i in range(robot.n)],
            "run_length_m": robot.run_length,
            "cable_diameter_m": robot.cable_diameter,
            "linear_density_kg_per_m": robot.linear_density,
            "axial_stiffness_N": robot.axial_stiffness,
            "tension_min_N": robot.tension_min,
            "tension_max_N": robot.tension_max,
            "length_min_m": robot.length_min,
            "length_max_m": robot.length_max,
            "home_unstrained_length_m": home.unstrained_length[0] * known,
            "home_tension_N": home.tension[0] * known,
            "home_sag_m": self.sag,
            "home_wrap_rad": self.wrap,
        }
        return [
            {"name": name, **{key: value[i] for key, value in per_cable.items()}}
            for i, name in enumerate(robot.cable_names)
        ]

    def _sensor_data(self) -> dict[str, Any] | None:
        """Return the sensor calibration of the robot file."""
        sensors = self.sensors
        if sensors is None:
            return None
        return {
            "length_offset_m": sensors.offset,
            "length_scale": sensors.scale,
            "length_delay_s": sensors.delay,
            "pose_tilt_rad": sensors.tilt,
            "pose_turn_rad": None if sensors.tilt is None else sensors.turn,
        }

    def _home_data(self) -> dict[str, Any]:
        """Return the equilibrium at home; null if there is none."""
        home = self.equilibrium
        converged = bool(home.converged[0])
        known = 1.0 if converged else np.nan
        return {
            "position_m": self.robot.home_position,
            "rotation": home.rotation[0] * known,
            "tilt_rad": self.tilt * known,
            "feasible": self.feasible,
            "converged": converged,
            "stable": bool(home.stable[0]) if converged else None,
            "residual_N": home.residual[0],
            "natural_frequencies_Hz": self.frequencies,
            "natural_directions": self.directions,
        }


def report_robot(robot: Robot, file: RobotFile | None = None) -> RobotReport:
    """Solve for the equilibrium of a robot at home.

    Args:
        robot: The robot, n cables.
        file: The checked file that it comes from, if any.

    Returns:
        The report; `RobotReport.feasible` is True if it can stay at home.
    """
    from carosac_toolkit.physics.cable import straight_line
    from carosac_toolkit.physics.rest import modes, statics

    equilibrium = statics.inverse_kinematics(robot, robot.home_position[None])
    straight = straight_line.straight_length(robot, robot.home_position[None])
    wrap = straight.wrap[0]
    if equilibrium.converged[0]:
        shape = statics.cable_shape(robot, equilibrium, CABLE_SHAPE_POINTS)[0]
        sag = statics.sag(robot, equilibrium, samples=CABLE_SHAPE_POINTS)[0]
        motions = modes.natural_modes(robot, equilibrium)
        frequencies = motions.frequency[0]
        (directions,) = modes.main_directions(robot, equilibrium.rotation, motions.shape)
        wrap = _wrap(robot, equilibrium)
    else:
        anchors = robot.home_position + robot.anchor_points @ robot.home_rotation.T
        share = np.linspace(0.0, 1.0, CABLE_SHAPE_POINTS)[:, None]
        free = straight.length[0] - robot.pulley_radius * wrap
        start = anchors - free[:, None] * straight.direction[0]
        shape = start[:, None] * (1.0 - share) + anchors[:, None] * share
        sag, frequencies = np.full(robot.n, np.nan), np.full(6, np.nan)
        directions = ()
    return RobotReport(
        robot=robot,
        equilibrium=equilibrium,
        shape=shape,
        sag=sag,
        frequencies=frequencies,
        directions=directions,
        straight=straight,
        wrap=wrap,
        file=file,
    )


def _value(robot: Robot, name: str) -> float:
    """Return the value of a parameter; NaN if the cables that share it differ."""
    try:
        return float(values_of(robot, [name])[0])
    except InvalidField:
        return np.nan


def _wrap(robot: Robot, equilibrium: Equilibrium) -> Array:
    """Return the angle of contact of each hanging cable [rad], shape (n,); 0 without a pulley.

    The cable comes along the swivel axis k and leaves along cos(wrap) k + sin(wrap) e, where e
    points from the axis to the anchor point; it lies in that vertical or tilted plane.
    """
    anchors = equilibrium.position[0] + robot.anchor_points @ equilibrium.rotation[0].T
    relative = anchors - robot.exit_points
    axis = robot.swivel_axis
    outward = relative - np.einsum("ni,ni->n", relative, axis)[:, None] * axis
    leaving = -equilibrium.exit_tension[0]  # towards the platform
    sine = np.einsum("ni,ni->n", leaving, outward) / np.linalg.norm(outward, axis=1).clip(1e-300)
    angle = np.arctan2(sine, np.einsum("ni,ni->n", leaving, axis))
    angle = np.where(angle < -1e-9, angle + 2.0 * np.pi, angle)
    return np.where(robot.pulley_radius > 0.0, angle, 0.0)


def is_suspended(robot: Robot, position: Array, rotation: Array) -> bool:
    """Return True if every cable pulls up at these poses.

    Args:
        robot: The robot, n cables.
        position: Platform origin in W [m], shape (B, 3).
        rotation: From P to W, shape (B, 3, 3).
    """
    anchors = position[:, None, :] + np.einsum("bij,nj->bni", rotation, robot.anchor_points)
    return bool((robot.exit_points[:, 2] > anchors[..., 2]).all())
