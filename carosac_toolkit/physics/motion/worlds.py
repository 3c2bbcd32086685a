"""Simulated worlds on a device: plants, state, and the calls that every cable model shares."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.physics.cable.catenary_kernels import vec6d
from carosac_toolkit.physics.device import body_record, cable_records, record_type, stacked
from carosac_toolkit.physics.device_kernels import Cable
from carosac_toolkit.physics.fleet import Fleet
from carosac_toolkit.physics.motion import world_kernels
from carosac_toolkit.physics.motion.body_kernels import BodyMotion, DynamicBody, Gusts, Wind
from carosac_toolkit.physics.motion.cable_drag import cable_drag_of
from carosac_toolkit.physics.motion.friction_kernels import Bristles
from carosac_toolkit.physics.motion.winch import WinchSettings, winch_records
from carosac_toolkit.physics.motion.winch_kernels import Winch, WinchState
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

GUST_INTERVAL = Scaled(0.01, "s")  # between two draws of the wind
# What a world needs to go on, and what people read of it.
STATE_FIELDS = (
    "motion", "winch", "anchor_velocity", "anchor_rate", "bristles", "gusts", "seed", "last",
    "rough", "failed", "time", "command", "position", "rotation", "twist", "acceleration",
    "unstrained_length", "wound_length", "tension", "iterations", "capped", "residual",
)  # fmt: skip


def rigid_body_record(robot: Robot) -> NDArray[Any]:
    """Return the platform of a robot as one `DynamicBody` struct, shape ()."""
    record = np.zeros((), dtype=record_type(DynamicBody))
    shared = body_record(robot)
    for name in ("center_of_mass", "arm", "size"):
        record[name] = shared[name]
    for name in ("mass", "inertia", "drag", "angular_drag", "gravity"):
        record[name] = getattr(robot, name)
    record["angular_drag_beyond"] = robot.angular_drag * (robot.angular_drag_axes - 1.0)
    record["cable_drag"] = cable_drag_of(robot)
    return record


def gust_interval(robot: Robot) -> float:
    """Return the time between two draws of the wind [s]: the same for plants drawn at random."""
    ratios = Scales(robot).ratios
    return GUST_INTERVAL.of(ratios._replace(time=float(f"{ratios.time:.3g}")))


def upload_plants(
    fleet: Fleet, device: str, winch: WinchSettings, wind_force: float, wind_time: float
) -> Any:
    """Upload the `Plants` struct of a fleet.

    Args:
        fleet: One robot for all worlds, or one for each.
        device: Warp device.
        winch: Control of the winches by their drives.
        wind_force: Standard deviation of the wind per horizontal axis [N].
        wind_time: Its correlation time [s].
    """
    robots = fleet.robots
    winds = np.zeros(len(robots), dtype=record_type(Wind))
    winds["deviation"], winds["time"] = wind_force, wind_time
    winds["interval"] = stacked(lambda robot: np.array(gust_interval(robot)), robots)
    out = world_kernels.Plants()
    for name, kind, records in (
        ("cables", Cable, stacked(cable_records, robots)),
        ("bodies", DynamicBody, stacked(rigid_body_record, robots)),
        ("winches", Winch, stacked(lambda robot: winch_records(robot, winch), robots)),
        ("winds", Wind, winds),
    ):
        setattr(out, name, wp.array(records, dtype=kind, device=device))
    return out


def allocate_worlds(size: int, n: int, device: str, seeds: NDArray[np.int32]) -> Any:
    """Allocate the `Worlds` struct of B worlds of n cables; `seeds` of their wind, shape (B,)."""
    out = world_kernels.Worlds()
    for name, kind in (
        ("motion", BodyMotion), ("gusts", Gusts), ("rough", int), ("failed", int),
        ("last", wp.float64),
        ("position", wp.vec3d), ("rotation", wp.mat33d), ("twist", vec6d),
        ("acceleration", vec6d), ("time", wp.float64), ("iterations", int),
        ("capped", int), ("residual", wp.float64),
    ):  # fmt: skip
        setattr(out, name, wp.zeros(size, dtype=kind, device=device))
    for name, kind in (
        ("winch", WinchState), ("winch_before", WinchState), ("anchor_velocity", wp.vec3d),
        ("anchor_rate", wp.vec3d), ("bristles", Bristles), ("command", wp.float64),
        ("unstrained_length", wp.float64), ("wound_length", wp.float64), ("tension", wp.float64),
    ):  # fmt: skip
        setattr(out, name, wp.zeros((size, n), dtype=kind, device=device))
    out.seed = wp.array(seeds, dtype=int, device=device)
    return out
