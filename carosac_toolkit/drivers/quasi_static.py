"""Simulated robots without inertia: at every instant they rest on their cables.

Winches, sensors and limits are real in time; the platform follows the wound lengths through the
statics. It shows geometry, sag, elasticity, delay and bias, and no sway.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.drivers.simulated import SimulatedDriver, SimulatedSettings
from carosac_toolkit.loop.values import State
from carosac_toolkit.physics.cable.swivel import swivel_angle
from carosac_toolkit.physics.motion.winch import WinchBatch, WinchSettings
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.nearest import rest_at
from carosac_toolkit.robot.robot import Robot


@dataclass(frozen=True, kw_only=True)
class QuasiStaticSettings(SimulatedSettings):
    """Settings of `QuasiStaticDriver`, those of every simulated driver.

    Any suite but those with an IMU, as there is no inertia.
    """

    inertial: ClassVar[bool] = False


class QuasiStaticPlant:
    """B robots that rest on the wound lengths at every instant; a `Plant`.

    Attributes:
        robot: The plant robot, n cables.
        size: B.
        inertial: False.
    """

    inertial = False

    def __init__(self, robot: Robot, winch: WinchSettings | None = None, size: int = 1) -> None:
        """Take a robot; call `reset` before anything else."""
        self.robot = robot
        self.size = size
        self._winch = winch

    def reset(self, position: Array) -> None:
        """Rest at these positions in W [m], shape (B, 3).

        Raises:
            InvalidField: There is no rest within the tension limits.
        """
        rest = rest_at(self.robot, position)
        if not rest.converged.all():
            row = int(np.argmin(rest.converged))
            where = "start_position" if self.size == 1 else f"start_position[{row}]"
            reason = statics.STATUS_REASONS[rest.status[row]]
            raise InvalidField(where, position[row], f"a position with an equilibrium ({reason})")
        self._winches = WinchBatch(self.robot, rest.unstrained_length, self._winch)
        self._rest = rest
        self._settled = False
        self._time = 0.0

    def advance(self, command: Array, duration: float) -> None:
        """Wind towards the lengths asked of the winches [m], (B, n), for a time [s]."""
        self._winches.advance(command, duration)
        self._settled = False
        self._time += duration

    def truth(self) -> State:
        """Return the poses at which the platforms rest on the wound lengths.

        Raises:
            CarosacError: There is no pose of rest; the winches have pulled a robot apart.
        """
        length = self._winches.length
        if not self._settled:
            rest = statics.forward_kinematics(self.robot, length, guess=self._rest)
            if not rest.converged.all():
                row = int(np.argmin(rest.converged))
                raise CarosacError(f"no equilibrium at lengths {length[row]} m, {self._time:.3f} s")
            self._rest = rest
            self._settled = True
        return State(
            time=np.full(self.size, self._time),
            position=self._rest.position,
            rotation=self._rest.rotation,
            unstrained_length=length,
            tension=self._rest.tension,
        )

    def swivel_angles(self) -> Array:
        """Return how far pulleys have swivelled [rad], shape (B, n)."""
        self.truth()  # the rest on the lengths as they are
        return swivel_angle(self.robot, -self._rest.exit_tension)

    def acceleration(self) -> Array:
        """Refuse: a platform at rest has no acceleration to measure.

        Raises:
            CarosacError: Always.
        """
        raise CarosacError("quasi_static: no inertia, so no acceleration")

    def read_lengths(self) -> Array:
        """Return readings of perfect encoders [m], shape (B, n)."""
        return self._winches.read()


class QuasiStaticDriver(SimulatedDriver):
    """One simulated robot without inertia."""

    Settings: ClassVar = QuasiStaticSettings
    name: ClassVar = "quasi_static"

    @classmethod
    def build(
        cls, robot: Robot, settings: QuasiStaticSettings | None = None, *, seed: int = 0
    ) -> QuasiStaticDriver:
        """Make one for a plant; `seed` draws bias and noise of the sensors."""
        chosen = settings or QuasiStaticSettings()
        return cls(QuasiStaticPlant(robot, chosen.winch), chosen, seed)
