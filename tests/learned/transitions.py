"""Transitions for tests: two environments of a robot with four cables, at rest on their targets."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from learned.transition import Transition


def transition(**changes: Any) -> Transition:
    """Two steps in which nothing happens, but for the changes."""
    length = np.full((2, 4), 7.0)
    still = Transition(
        target=np.zeros((2, 3)), position_before=np.zeros((2, 3)), position=np.zeros((2, 3)),
        length_before=length, length=length, asked=length, straight_position=length,
        straight_target=length, inconsistency=np.zeros((2, 4)), velocity=np.zeros((2, 3)),
        effort=np.zeros(2), failed=np.zeros(2, dtype=bool),
    )  # fmt: skip
    return replace(still, **{name: np.asarray(value) for name, value in changes.items()})
