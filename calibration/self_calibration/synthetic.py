"""Synthetic motor angles with the full measurement model, and the truth behind them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from calibration.self_calibration.motor_angles import MotorAngles
from calibration.self_calibration.problem import MotorAngleProblem
from calibration.self_calibration.settings import SelfCalibrationSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.cable.drum import drums_of
from carosac_toolkit.physics.cable.straight_line import inverse_kinematics
from carosac_toolkit.robot.robot import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasurementNoise:
    """One standard deviation of what is measured.

    Attributes:
        line: Of the line paid out by a drum [m].
        known: Of known positions per axis [m].
        friction: Largest share of a tension that friction adds or takes away [1].
    """

    line: float = 1e-3
    known: float = 1e-3
    friction: float = 0.0


def draw_robot(robot: Robot, rng: np.random.Generator, settings: SelfCalibrationSettings) -> Robot:
    """Draw a robot that the given one may be, as far as it is known before.

    Alike drums are wrong by the same; the lengths at the reference follow from the exit points.
    """
    problem = MotorAngleProblem(robot, _nothing(robot), settings)
    drawn = rng.multivariate_normal(problem.prior.mean, problem.prior.covariance, method="cholesky")
    drums = drums_of(robot)
    return replace(
        robot,
        exit_points=drawn[problem.exits],
        drum_radius=drums.radius + drawn[problem.radii],
        drum_buildup=drawn[problem.buildups],
    )


def draw_positions(robot: Robot, count: int, rng: np.random.Generator) -> Array:
    """Return home, and positions drawn from the workspace [m], shape (count, 3)."""
    drawn = rng.uniform(robot.workspace_min, robot.workspace_max, (count - 1, 3))
    return np.vstack([robot.home_position, drawn])


def measure_motor_angles(
    robot: Robot,
    position: Array,
    known: Array,
    noise: MeasurementNoise,
    rng: np.random.Generator,
    *,
    blunders: Mapping[tuple[int, int], float] | None = None,
    tension: Array | None = None,
    rotation: Array | None = None,
) -> MotorAngles:
    """Simulate what the motors of a robot show.

    Args:
        robot: The true one, with drums.
        position: Platform origin in W [m], shape (N, 3); the angles count from the first.
        known: Numbers of the samples whose position is known, shape (K,).
        noise: Of the measurement.
        rng: Generator.
        tension: With which the motors hold the cables [N], shape (N, n); None: cables are stiff,
            and no tensions are measured.
        rotation: From P to W, shape (N, 3, 3); None: home's.
        blunders: Line that got lost [m], by sample and cable, such as a cable off its pulley.

    Returns:
        Motor angles; sample 0 is at angle 0 but for noise.
    """
    drums = drums_of(robot)
    length = inverse_kinematics(robot, position, rotation)
    if tension is not None:
        friction = 1.0 + rng.uniform(-noise.friction, noise.friction, length.shape)
        strain = tension * friction / robot.axial_stiffness
        length = (length - robot.run_length * strain) / (1.0 + strain)
    extra = rng.normal(0.0, noise.line, length.shape)
    for (row, cable), line in (blunders or {}).items():
        if not 0 <= row < len(position) or not 0 <= cable < robot.n:
            allowed = f"samples 0 to {len(position) - 1}, cables 0 to {robot.n - 1}"
            raise InvalidField("blunders", f"{(row, cable)}", allowed)
        extra[row, cable] += line
    angle = drums.motor_angle(length + extra / drums.advantage)
    is_known = np.isin(np.arange(len(position)), known)
    measured = position + rng.normal(0.0, noise.known, position.shape)
    return MotorAngles(
        samples=tuple(str(k) for k in range(len(position))),
        cables=robot.cable_names,
        motor_angle=angle - drums.motor_angle(length[:1]),
        known_position=np.where(is_known[:, None], measured, 0.0),
        is_known=is_known,
        tension=tension,
    )


def _nothing(robot: Robot) -> MotorAngles:
    """Return one sample, of which nothing is used."""
    return MotorAngles(
        samples=("0",),
        cables=robot.cable_names,
        motor_angle=np.zeros((1, robot.n)),
        known_position=np.zeros((1, 3)),
        is_known=np.zeros(1, dtype=np.bool_),
    )
