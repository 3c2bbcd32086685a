"""What tests of the simulator share: robots with and without damping, and ways to run worlds."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

import carosac_toolkit as ct
from carosac_toolkit.physics.rest.statics import Equilibrium
from carosac_toolkit.robot.robot import Robot
from sim_warp import Simulator, SimulatorState

Array = NDArray[Any]
MODELS = ("particles", "catenary", "straight", "xpbd")
ASIDE = {"simple": (0.5, -0.7, 0.4), "eight": (0.1, -0.2, 0.15)}  # from home [m]: no symmetry
KICK = np.array([[0.3, -0.2, 0.1, 0.2, -0.1, 0.3]])


def undamped(robot: Robot, **changes: Any) -> Robot:
    """The same robot without air and without damping in its cables."""
    return replace(
        robot, drag=0.0, angular_drag=0.0, axial_damping=np.zeros(robot.n), **changes
    )  # fmt: skip


def damped(robot: Robot) -> Robot:
    """The same robot in oil: its sway is gone after 20 s, its rest is the same."""
    return replace(robot, drag=80.0, angular_drag=6.0)


def aside(robot: Robot) -> Equilibrium:
    """Rest at a pose without symmetry."""
    found = ct.statics.inverse_kinematics(robot, robot.home_position[None] + [ASIDE[robot.name]])
    assert found.converged.all()
    return found


def held(sim: Simulator) -> Array:
    """What the winches have wound [m], as a command to hold it."""
    return np.array(sim.state.unstrained_length.numpy())


def on_device(command: Array, device: str = "cpu") -> wp.array:
    """Lengths as a Warp array, which nothing checks."""
    return wp.array(command, dtype=wp.float64, device=device)


def rows(state: SimulatorState, keep: Any) -> dict[str, Array]:
    """Some worlds of a state."""
    fields = {name: getattr(state, name) for name in SimulatorState.__dataclass_fields__}
    return {name: value[keep] for name, value in fields.items() if value is not None}


def assert_same(one: dict[str, Array], other: dict[str, Array]) -> None:
    """Bit for bit."""
    assert one.keys() == other.keys()
    for name, value in one.items():
        assert np.array_equal(value, other[name]), name


def assert_same_snapshots(one: Any, other: Any) -> None:
    """Everything that changes, bit for bit."""
    assert (one.cables, one.segments) == (other.cables, other.segments)
    assert_same(one.arrays, other.arrays)
