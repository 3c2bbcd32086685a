"""A plan: states and tensions at coming times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.mpc import model
from carosac_toolkit.base.arrays import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """Planned states and tensions over N stages.

    Attributes:
        time: Of the states [s], shape (N + 1,).
        state: As in `model`, shape (N + 1, 12).
        tension: Along the chords, held over each stage [N], shape (N, n).
        rotation: R_0 of the states, shape (3, 3).
    """

    time: Array
    state: Array
    tension: Array
    rotation: Array

    def shifted(self, time: Array) -> tuple[Array, Array]:
        """Return states at other times, and the tensions between them; the last ones stay.

        Args:
            time: [s], shape (N + 1,).

        Returns:
            Shapes (N + 1, 12) and (N, n).
        """
        columns = [np.interp(time, self.time, column) for column in self.state.T]
        middle = 0.5 * (time[1:] + time[:-1])
        stage = np.clip(np.searchsorted(self.time, middle) - 1, 0, len(self.tension) - 1)
        return np.stack(columns, axis=1), self.tension[stage]

    def turned(self, rotation: Array) -> Plan:
        """Return the same plan about another R_0."""
        state = self.state.copy()
        for row in state:
            turn = model.rotation_of(row[3:6]) @ self.rotation
            row[3:6] = model.parameters_of(turn @ rotation.T)
        return Plan(time=self.time, state=state, tension=self.tension, rotation=rotation)


def pose_of(state: Array, rotation: Array) -> tuple[Array, Array]:
    """Return position (3,) and rotation (3, 3) of a state about R_0."""
    return state[:3], model.rotation_of(state[3:6]) @ rotation
