"""Straight-line inverse kinematics as a controller: what most cable robots run on."""

from __future__ import annotations

import numpy as np

from baselines.lookahead import LookaheadController
from carosac_toolkit.loop.values import Belief, Command, Reference
from carosac_toolkit.physics.cable import straight_line


class StraightLineController(LookaheadController):
    """Sends the straight-line lengths of the reference, orientation held at home."""

    def command(self, belief: Belief, reference: Reference) -> Command:
        """Return the lengths of straight cables at the pose ahead, and their rates."""
        position, velocity = self._ahead.aim(belief, reference)
        length = straight_line.inverse_kinematics(self._robot, position)
        cables = straight_line.straight_length(self._robot, position)
        rate = np.einsum("bni,bi->bn", cables.direction, velocity)
        return Command(time=belief.time, unstrained_length=length, length_rate=rate)
