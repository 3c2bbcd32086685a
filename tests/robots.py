"""Small robots for tests, built without any file."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.robot.robot import Robot


def simple_robot(**changes: Any) -> Robot:
    """The four-cable suspended robot of the industrial hall: nearly coplanar eyelets, 8.4 m up."""
    robot = _robot(
        "simple",
        exit_points=[
            [-1.98747, -8.31966, 8.47185],
            [2.51921, -8.38834, 8.46905],
            [2.71727, 4.77495, 8.36403],
            [-1.79674, 4.83346, 8.37007],
        ],
        anchor_points=[
            [-0.21, -0.21, -0.011],
            [0.21, -0.21, -0.011],
            [0.21, 0.21, -0.011],
            [-0.21, 0.21, -0.011],
        ],
        mass=23.655,
        center_of_mass=[0.0, 0.0, -0.12],
        inertia=np.diag([0.6, 0.6, 0.8]),
        workspace=([-1.6, -3.8, 1.0], [2.4, 0.2, 5.0]),
        home=[0.4, -1.8, 2.2],
        run_length=8.0,
    )
    return replace(robot, **changes)


def eight_cable_robot(**changes: Any) -> Robot:
    """An over-constrained eight-cable robot: a box in a frame of 4 x 3 x 2 m."""
    corners = [
        [x, y, z] for z in (2.0, 0.0) for x, y in ((-2, -1.5), (2, -1.5), (2, 1.5), (-2, 1.5))
    ]
    box = [[0.2, 0.15, 0.15], [-0.2, 0.15, 0.15], [-0.2, -0.15, 0.15], [0.2, -0.15, 0.15]]
    upper = [[-x, -y, -0.1] for x, y, _ in box]  # upper cables hold the lower corners
    lower = [[-x * 0.4, -y, z] for x, y, z in box]
    robot = _robot(
        "eight",
        exit_points=corners,
        anchor_points=upper + lower,
        mass=10.0,
        center_of_mass=[0.01, -0.02, 0.03],
        inertia=np.diag([0.3, 0.35, 0.4]),
        workspace=([-0.8, -0.6, 0.6], [0.8, 0.6, 1.4]),
        home=[0.0, 0.0, 1.0],
        run_length=0.0,
    )
    return replace(robot, **changes)


def with_pulleys(robot: Robot, radius: float = 0.06) -> Robot:
    """The same robot with swivelling pulleys, fed from winches below them."""
    n = robot.n
    axis = np.tile([0.0, 0.0, 1.0], (n, 1))
    return replace(robot, pulley_radius=np.full(n, radius), swivel_axis=axis)


def _robot(
    name: str,
    *,
    exit_points: Any,
    anchor_points: Any,
    mass: float,
    center_of_mass: Any,
    inertia: Any,
    workspace: tuple[Any, Any],
    home: Any,
    run_length: float,
) -> Robot:
    """Fill in the carbon-fibre cable and the winches all test robots share."""
    n = len(exit_points)
    same = np.ones(n)
    return Robot(
        name=name,
        cable_names=tuple(f"cable{i + 1}" for i in range(n)),
        exit_points=exit_points,
        exit_covariance=None,
        pulley_radius=0.0 * same,
        swivel_axis=np.tile([0.0, 0.0, 1.0], (n, 1)),
        run_length=run_length * same,
        anchor_points=anchor_points,
        linear_density=0.01055 * same,
        axial_stiffness=0.95e6 * same,
        axial_damping=100.0 * same,
        cable_diameter=0.003 * same,
        tension_min=5.0 * same,
        tension_max=500.0 * same,
        speed_max=2.5 * same,
        acceleration_max=5.0 * same,
        winch_lag=0.05 * same,
        length_min=0.1 * same,
        length_max=40.0 * same,
        drum_radius=None,
        drum_buildup=None,
        mass=mass,
        center_of_mass=center_of_mass,
        inertia=inertia,
        drag=0.3,
        angular_drag=0.05,
        gravity=9.81,
        workspace_min=workspace[0],
        workspace_max=workspace[1],
        home_position=home,
        home_rotation=np.eye(3),
        description="for tests",
        licence="Apache-2.0",
        provenance={},
    )


# Fields with one value a cable, but for its name and points.
PER_CABLE = (
    "pulley_radius", "swivel_axis", "run_length", "linear_density", "axial_stiffness",
    "axial_damping", "cable_diameter", "tension_min", "tension_max", "speed_max",
    "acceleration_max", "winch_lag", "length_min", "length_max", "exit_friction",
    "anchor_friction", "capstan_friction", "length_hysteresis",
)  # fmt: skip
EXITS = {2: [(-3, 0, 6), (3, 0, 6)], 3: [(-3, -2, 6), (3, -2, 6), (0, 3.5, 6)]}
ANCHORS = {2: [(-0.2, 0, 0), (0.2, 0, 0)], 3: [(-0.2, -0.15, 0), (0.2, -0.15, 0), (0, 0.25, 0)]}


def hanging(n: int) -> Robot:
    """Return a platform of 10 kg on 2 or 3 cables, 6 m high, with the ropes of `carosac`."""
    robot = load_robot("carosac")
    return replace(
        robot, name=f"hanging_{n}", cable_names=tuple(f"c{i}" for i in range(n)),
        exit_points=np.array(EXITS[n], float), anchor_points=np.array(ANCHORS[n], float),
        mass=10.0, center_of_mass=np.array([0.0, 0.0, -0.2]), inertia=np.diag([0.3, 0.3, 0.4]),
        workspace_min=np.array([-1.0, -0.5, 1.0]), workspace_max=np.array([1.0, 0.5, 4.0]),
        home_position=np.array([0.0, 0.0, 2.0]),
        **{name: getattr(robot, name)[:n] for name in PER_CABLE},
    )  # fmt: skip
