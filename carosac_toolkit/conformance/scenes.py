"""Small test worlds for the checks, made of statics and a line, without any driver."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from carosac_toolkit import trajectories
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.values import Belief, Command, Measurement, Reference
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.trajectories import Trajectory

SCENE_STEPS = 5
DEFAULT_PERIOD_S = 0.02  # [s], where the plug-in does not say
PER_CABLE_FIELDS = (
    "exit_points", "exit_covariance", "pulley_radius", "swivel_axis", "run_length",
    "anchor_points", "linear_density", "axial_stiffness", "axial_damping", "cable_diameter",
    "tension_min", "tension_max", "speed_max", "acceleration_max", "winch_lag", "length_min",
    "length_max", "drum_radius", "drum_buildup", "exit_friction", "anchor_friction",
    "capstan_friction", "length_hysteresis",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class ConformanceScene:
    """Platform that follows a slow line, observed at `SCENE_STEPS` times.

    Attributes:
        path: From home a little into the workspace.
        beliefs: Beliefs of a perfect estimator, a few millimetres off.
        measurements: Measurements of its cable lengths alone.
    """

    path: Trajectory
    beliefs: tuple[Belief, ...]
    measurements: tuple[Measurement, ...]

    def references(self, period: float, horizon: float) -> list[Reference]:
        """Return the reference window of each step."""
        return [self.path.window(float(b.time[0]), horizon, period) for b in self.beliefs]


def make_scene(robot: Robot, *, offset: float = 0.003) -> ConformanceScene:
    """Make a scene near home.

    Args:
        robot: Robot description.
        offset: Error of the beliefs along each axis [m].

    Raises:
        InvalidField: The robot cannot rest there, so that nothing can be checked with it.
    """
    home = robot.home_position
    reach = 0.1 * (robot.workspace_max - robot.workspace_min)
    towards = np.where(home + reach < robot.workspace_max, reach, -reach)
    path = trajectories.line(home, home + towards, speed_max=0.3, acceleration_max=0.3)
    time = np.linspace(0.0, 0.9 * path.duration, SCENE_STEPS)
    rest = statics.inverse_kinematics(robot, path.sample(time).position)
    if not rest.converged.all():
        raise InvalidField("robot", robot.name, "a robot that can rest at home and near it")
    rows = [slice(k, k + 1) for k in range(SCENE_STEPS)]
    return ConformanceScene(
        path=path,
        beliefs=tuple(
            Belief(time=time[k], position=rest.position[k] + offset, rotation=rest.rotation[k])
            for k in rows
        ),
        measurements=tuple(
            Measurement(time=time[k], unstrained_length=rest.unstrained_length[k]) for k in rows
        ),
    )


def other_robot(robot: Robot) -> Robot:
    """Return the same robot with one more cable, beside the last one."""
    changed: dict[str, Any] = {
        name: np.concatenate([value, value[-1:]])
        for name in PER_CABLE_FIELDS
        if (value := getattr(robot, name)) is not None
    }
    changed["exit_points"][-1] += [0.1, 0.0, 0.0]
    names = (*robot.cable_names, "one_more")
    return replace(robot, name=f"{robot.name}+1", cable_names=names, **changed)


def stacked(one: Reference, other: Reference) -> Reference:
    """Return two references as a batch of two."""
    names = ("time", "position", "velocity", "acceleration")
    return Reference(
        **{name: np.concatenate([getattr(one, name), getattr(other, name)]) for name in names}
    )


@contextmanager
def wide_numbers() -> Iterator[None]:
    """Let numpy overflow or divide silently; the result is checked instead."""
    with np.errstate(all="ignore"):
        yield


class LengthPlayback:
    """Driver that measures given lengths, ignores commands and knows no truth."""

    def __init__(self, measurements: tuple[Measurement, ...]) -> None:
        self._measurements = measurements
        self._index = 0
        self.sent: list[Array] = []

    def connect(self) -> None:
        """Go to the first measurement."""
        self._index = 0

    def measure(self) -> Measurement:
        """Return the measurement of this cycle."""
        return self._measurements[self._index]

    def command(self, command: Command) -> Command:
        """Note the command."""
        self.sent.append(command.unstrained_length)
        return command

    def wait(self, duration: float) -> bool:
        """Go to the next measurement."""
        self._index += 1
        return self._index < len(self._measurements)

    def stop(self, reason: str) -> None:
        """Do nothing: nothing moves."""

    def close(self) -> None:
        """Do nothing: nothing is held."""
