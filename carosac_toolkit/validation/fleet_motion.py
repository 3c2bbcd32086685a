"""Open-loop motion of several robots at once, each on its own lengths and from its own start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.physics.cable.shapes import hanging_cables
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.physics.fleet import Fleet
from carosac_toolkit.physics.motion.dynamics import NodelessDynamics, Placement
from carosac_toolkit.physics.motion.winch import WinchSettings
from carosac_toolkit.physics.motion.worlds import allocate_worlds, upload_plants
from carosac_toolkit.physics.rest.held_lengths import (
    moved_poses,
    poses_on_lengths,
    twists_on_rates,
)
from carosac_toolkit.physics.rest.statics import Equilibrium, forward_kinematics
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

FLEET_TIME_STEP = Scaled(0.01, "s")  # at most
_DEVICE = "cpu"


@dataclass(frozen=True, kw_only=True, eq=False)
class FleetMotion:
    """Motion of B robots at M times.

    Attributes:
        position: Platform origins in W [m], shape (M, B, 3).
        rotation: From P to W, shape (M, B, 3, 3).
        twist: Of the origins, linear first, in W, shape (M, B, 6).
    """

    position: Array
    rotation: Array
    twist: Array


def fleet_motion(
    robots: Sequence[Robot], time: Array, length: Array, move: Array, twist: Array
) -> FleetMotion:
    """Simulate robots on quasi-static catenaries while their lengths change as given.

    Args:
        robots: B robots of n cables.
        time: Increasing [s], shape (M,).
        length: Unstrained, straight between these times [m], shape (M, B, n).
        move: From rest on the first lengths to where they start: linear, then rotation vector in W,
            shape (B, 6). The component that would stretch cables is taken away.
        twist: With which they start, shape (B, 6); likewise.

    Raises:
        CarosacError: A robot cannot rest on its first lengths, or its motion is not finite.
    """
    fleet = Fleet(robots)
    rest = forward_kinematics(fleet, length[0])
    if not (rest.converged & rest.stable).all():
        raise CarosacError("the robot cannot rest on the first lengths")
    start, twists = _starts(fleet, rest, time, length, move, twist)
    plants = upload_plants(fleet, _DEVICE, WinchSettings(), 0.0, 1.0)
    size = len(robots)
    worlds = allocate_worlds(size, fleet.n, _DEVICE, np.zeros(size, dtype=np.int32))
    dynamics = NodelessDynamics(plants, worlds, size, fleet.n, _DEVICE, "catenary")
    dynamics.place(np.arange(size, dtype=np.int32), start, twists)
    longest = FLEET_TIME_STEP.of(Scales(robots[0]).ratios)
    found = FleetMotion(
        position=np.empty((len(time), size, 3)),
        rotation=np.empty((len(time), size, 3, 3)),
        twist=np.empty((len(time), size, 6)),
    )
    command, steps = worlds.command.numpy(), np.diff(time, prepend=time[0])
    for k, step in enumerate(steps):
        if k > 0:
            command[:] = length[k]
            count = max(1, int(np.ceil(step / longest - 1e-6)))
            dynamics.advance(True, count, float(step) / count)
        for name in ("position", "rotation", "twist"):
            getattr(found, name)[k] = getattr(worlds, name).numpy()
    if worlds.failed.numpy().any():
        raise CarosacError("the simulated motion is not finite")
    return found


def _starts(
    fleet: Fleet,
    rest: Equilibrium,
    time: Array,
    length: Array,
    move: Array,
    twist: Array,
) -> tuple[Placement, Array]:
    """Return where robots start, and their twists (B, 6)."""
    away = moved_poses(rest.position, rest.rotation, move)
    held = straight_length(fleet, rest.position, rest.rotation).length
    position, rotation = poses_on_lengths(fleet, *away, held)
    rate = (length[1] - length[0]) / (time[1] - time[0])
    twists = twists_on_rates(fleet, position, rotation, length[0], rate, twist)
    cables = hanging_cables(fleet, position, rotation, length[0], device=_DEVICE)
    if not cables.valid.all():
        raise CarosacError("a cable cannot hang where the motion starts")
    start = Placement(
        position=position, rotation=rotation, unstrained_length=length[0],
        tension=cables.tension, exit_tension=cables.exit_tension, at_rest=False,
    )  # fmt: skip
    return start, twists
