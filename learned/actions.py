"""Meaning of the numbers of an action: lengths, or a push that the cables give the platform."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot
from learned.length_map import LengthMap
from learned.observation import ObservationInputs, ObservationScales


class ActionMap(Protocol):
    """From actions in [-1, 1] to lengths."""

    size: int

    def applied(self, action: Array, look: ObservationInputs) -> Array:
        """Return the action applied after the one applied last, in [-1, 1], shape (B, a)."""
        ...

    def lengths(self, applied: Array, look: ObservationInputs) -> Array:
        """Return the lengths to ask the winches for [m], shape (B, n)."""
        ...

    def effort(self, applied: Array) -> Array:
        """Return the used share of its range, shape (B,)."""
        ...


class Absolute:
    """Each number is a length: -1 the shortest in the workspace box, 1 the longest."""

    def __init__(self, scales: ObservationScales) -> None:
        self._scales = scales
        self.size = len(scales.length_low)

    def applied(self, action: Array, look: ObservationInputs) -> Array:
        """Return the action itself."""
        return action

    def lengths(self, applied: Array, look: ObservationInputs) -> Array:
        """Return the lengths of an action, whatever is observed."""
        return self._scales.to_length(applied)

    def effort(self, applied: Array) -> Array:
        """Return zero: lengths cost nothing."""
        return np.zeros(len(applied))


class Push:
    """A push [m/s^2] on the platform, by way of catenary inverse kinematics.

    Lengths are those of rest at a target that is moved by

    .. math:: u = S(p) a,

    with the softness S of the rest at the target p, see `learned.length_map`: so far must the rest
    be moved for the cables to pull the platform at p with m a. Where a direction is soft, as the
    one in which a suspended platform sways, a push moves the rest far, where it is stiff, hardly;
    so pushes of one size are about as hard on the cables in all directions. Displaced lengths agree
    with each other, whatever the policy does: no cable is pulled against the others.

    With feedforward the acceleration of the target is pushed for as well, and the action corrects
    that; without, no action is catenary inverse kinematics.

    A correction K moves the target by -K times the lasting error e, a mean of past errors that
    fades over seconds: what a plant lies off by at rest becomes 1 / (1 + K) of it, also where the
    platform is stiff and pushes of a size that is safe do not move it. Being slow it does not
    excite the sway, but a swing about a soft direction must be damped, by actions. It leans on the
    belief: of a constant error of that, K / (1 + K) goes into the position.
    """

    size = 3

    def __init__(
        self,
        robot: Robot,
        reach: float,
        *,
        lead: float = 0.0,
        share: float = 1.0,
        feedforward: bool = False,
        correction: float = 0.0,
        device: str = "cpu",
    ) -> None:
        """Fit the maps of lengths and softness.

        Args:
            robot: The nominal robot.
            reach: Largest push per axis [m/s^2].
            lead: How far ahead of the target the reference is aimed at [s].
            share: Of the way to the action that a push goes in a step: a low-pass that keeps fast
                modes quiet. 1 goes all of it.
            feedforward: Whether the push of an action comes on top of that of the target.
            correction: K above, >= 0 [-].
            device: Warp device of the maps.
        """
        self._map = LengthMap(robot, device)
        self._reach = reach
        self._feedforward = feedforward
        self._lead = lead
        self._share = share
        self._correction = correction

    def applied(self, action: Array, look: ObservationInputs) -> Array:
        """Go a share of the way from what was applied last to the action."""
        return look.last_action + self._share * (action - look.last_action)

    def lengths(self, applied: Array, look: ObservationInputs) -> Array:
        """Return the equilibrium lengths at the displaced target."""
        push = self._reach * applied
        if self._feedforward:
            push = push + look.aimed_acceleration
        offset = self._lead * look.target_velocity - self._correction * look.lasting_error
        return self._map.lengths(look.target, push=push, offset=offset)

    def effort(self, applied: Array) -> Array:
        """Return the norm of the push over the reach."""
        return np.asarray(np.linalg.norm(applied, axis=1))
