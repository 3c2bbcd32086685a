"""What the numbers of an action mean: lengths, or a displacement of the reference."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from carosac_toolkit.arrays import Array
from carosac_toolkit.robot import Robot
from learned.length_map import LengthMap
from learned.observation import Look, Scales


class ActionMap(Protocol):
    """From actions in [-1, 1] to lengths."""

    size: int

    def lengths(self, action: Array, look: Look) -> Array:
        """Lengths to ask the winches for [m], shape (B, n)."""
        ...

    def applied(self, action: Array, look: Look) -> Array:
        """What an action comes to after what was applied last, in [-1, 1], shape (B, a)."""
        ...

    def effort(self, action: Array) -> Array:
        """How much of its range an action uses, shape (B,)."""
        ...


class Absolute:
    """Each number is a length: -1 the shortest in the workspace box, 1 the longest."""

    def __init__(self, scales: Scales) -> None:
        self._scales = scales
        self.size = len(scales.length_low)

    def lengths(self, action: Array, look: Look) -> Array:
        """The lengths, whatever there is to see."""
        return self._scales.to_length(action)

    def applied(self, action: Array, look: Look) -> Array:
        """The action itself."""
        return action

    def effort(self, action: Array) -> Array:
        """None: lengths cost nothing."""
        return np.zeros(len(action))


class Displacement:
    """A displacement of the target from the reference, before catenary inverse kinematics.

    Displaced lengths agree with each other, whatever the policy does: no cable is pulled against
    the others.
    """

    size = 3

    def __init__(self, robot: Robot, reach: float, lead: float = 0.0, share: float = 1.0) -> None:
        """Fit the map of the lengths.

        Args:
            robot: The nominal robot.
            reach: Largest displacement per axis [m].
            lead: How far ahead of the target the reference is aimed at [s].
            share: Of the way to the action that the displacement goes in a step: a low-pass that
                keeps fast modes quiet. 1 goes all of it.
        """
        self._map = LengthMap(robot)
        self._reach = reach
        self._lead = lead
        self._share = share

    def lengths(self, action: Array, look: Look) -> Array:
        """Lengths of rest at the displaced target."""
        aimed = look.target + self._lead * look.target_velocity
        return self._map.lengths(aimed, self._reach * self.applied(action, look))

    def applied(self, action: Array, look: Look) -> Array:
        """Some of the way from what was applied last to the action."""
        return look.last_action + self._share * (action - look.last_action)

    def effort(self, action: Array) -> Array:
        """Norm of the displacement over the reach."""
        found: Array = np.linalg.norm(action, axis=1)
        return found
