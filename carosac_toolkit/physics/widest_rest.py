"""Rest with the largest margin: how a position is held with all tensions far from their limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from carosac_toolkit.arrays import Array, batch, check_rotations
from carosac_toolkit.errors import InvalidField
from carosac_toolkit.physics import hold_kernels, warp_setup
from carosac_toolkit.physics.cable_kernels import mat66d, vec6d
from carosac_toolkit.physics.device import check_call, device_robot
from carosac_toolkit.physics.tension_margin import scratch
from carosac_toolkit.robot import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class WidestRest:
    position: Array
    rotation: Array
    tension: Array
    unstrained_length: Array
    exit_tension: Array
    margin: Array
    gap: Array
    low: Array
    high: Array
    status: NDArray[np.int32]
    stable: NDArray[np.bool_]
    residual: Array
    closure: Array
    stiffness: Array
    steps: NDArray[np.int32]


def hold(robot: Robot, position: ArrayLike, rotation: ArrayLike | None = None, *, wrench=None, lines=None, device="cpu") -> WidestRest:
    check_call(robot, device)
    where = batch("position", position, (3,))
    size, n = len(where), robot.n
    free = 3 if n < 6 else 0
    held = np.broadcast_to(robot.home_rotation, (size,3,3)) if rotation is None else batch("rotation", rotation, (3,3))
    warp_setup.load(hold_kernels, device)
    cables, bodies = device_robot(robot, device)
    first = np.arange(size+1) if lines is None else np.asarray(lines)
    poses = hold_kernels.Poses()
    kinds = {
        "position": ((size,), wp.vec3d), "rotation": ((size,), wp.mat33d),
        "tension": ((size, n), wp.float64), "unstrained_length": ((size, n), wp.float64),
        "q": ((size, n), wp.vec3d), "inverse": ((size, n), wp.mat33d), "lower": ((size, n), wp.float64),
        "upper": ((size, n), wp.float64), "low": ((size, n), wp.float64), "high": ((size, n), wp.float64),
        "column": ((size, n + free), vec6d), "found": ((size, n + free), wp.float64),
        "kept": ((size, n), wp.float64), "margin": ((size,), wp.float64), "gap": ((size,), wp.float64),
        "status": ((size,), int), "steps": ((size,), int), "stiffness": ((size,), mat66d),
        "residual": ((size,), wp.float64), "closure": ((size,), wp.float64), "stable": ((size,), int),
    }
    for k,(shape,kind) in kinds.items():
        setattr(poses, k, wp.zeros(shape, dtype=kind, device=device))
    poses.position.assign(where); poses.rotation.assign(held)
    work = scratch(len(first)-1, n+free, device)
    w = vec6d(*( [0.0]*6 if wrench is None else [float(x) for x in wrench]))
    wp.launch(hold_kernels.hold, len(first)-1, inputs=[cables, bodies, w, wp.array(first, dtype=int, device=device), poses, work], device=device)
    g = lambda k: getattr(poses, k).numpy()
    return WidestRest(position=where, rotation=g("rotation"), tension=g("tension"), unstrained_length=g("unstrained_length"),
        exit_tension=g("q"), margin=g("margin"), gap=g("gap"), low=g("low"), high=g("high"), status=g("status"),
        stable=g("stable")==1, residual=g("residual"), closure=g("closure"), stiffness=g("stiffness"), steps=g("steps"))
