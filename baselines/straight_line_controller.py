"""Straight-line inverse kinematics as a controller: what most cable robots run on."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from baselines.reference_ahead import Ahead, AheadSettings
from carosac_toolkit.physics import straight_line
from carosac_toolkit.robot import Robot
from carosac_toolkit.values import Belief, Command, Reference


class StraightLineController:
    """Sends the straight-line lengths of the reference, orientation held at home."""

    Settings: ClassVar = AheadSettings

    def __init__(self, robot: Robot, settings: AheadSettings) -> None:
        self._robot = robot
        self._ahead = Ahead(robot, settings)
        self.period = settings.period
        self.horizon = self._ahead.horizon

    @classmethod
    def build(
        cls, robot: Robot, settings: AheadSettings | None = None, *, seed: int = 0
    ) -> StraightLineController:
        """Make one for the nominal robot; it draws no random numbers, so `seed` has no effect."""
        return cls(robot, settings or AheadSettings())

    def reset(self, belief: Belief) -> None:
        """Forget the correction."""
        self._ahead.reset(belief)

    def command(self, belief: Belief, reference: Reference) -> Command:
        """Lengths of straight cables at the pose ahead, and their rates."""
        position, velocity = self._ahead.aim(belief, reference)
        length = straight_line.inverse_kinematics(self._robot, position)
        cables = straight_line.straight_length(self._robot, position)
        rate = np.einsum("bni,bi->bn", cables.direction, velocity)
        return Command(time=belief.time, unstrained_length=length, length_rate=rate)
