"""Transitions for tests: two environments of a robot with four cables, at rest on their targets."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from carosac_toolkit.physics.cable import straight_line
from learned.transition import Transition
from tests.robots import simple_robot

ORIGIN = np.zeros((2, 3))
STRAIGHT = straight_line.inverse_kinematics(simple_robot(), ORIGIN)  # [m] at the targets


def transition(**changes: Any) -> Transition:
    """Two steps in which nothing happens, but for the changes; straight cables all the time."""
    still = Transition(
        robot=simple_robot(), target=ORIGIN, position_before=ORIGIN, position=ORIGIN,
        length_before=STRAIGHT, length=STRAIGHT, asked=STRAIGHT, inconsistency=np.zeros((2, 4)),
        tension=None, velocity=np.zeros((2, 3)), effort=np.zeros(2), jerk=np.zeros(2),
        failed=np.zeros(2, dtype=bool),
    )  # fmt: skip
    return replace(still, **{name: np.asarray(value) for name, value in changes.items()})
