"""Set positions of n winches: they follow a host within limits, or ramp to rest together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.arrays import Array

BRAKE_RATIO = 2.0  # deceleration by the brake of a tripped drive over the acceleration limit
BRAKING_SHARE = 0.8  # of the acceleration limit, with which braking to a goal is planned
RETURN_RATIO = 0.002  # of the speed limit, with which winches go back to a goal they have passed
END_TOLERANCE = 1e-5  # share of the travel that rounding may take a set position beyond an end


@dataclass(frozen=True, kw_only=True, eq=False)
class WinchLimits:
    """Limits that the PLC enforces by itself, in its units.

    Attributes:
        length_min: Soft end positions [unit], shape (n,).
        length_max: [unit], shape (n,).
        speed: [unit/s], shape (n,).
        acceleration: [unit/s^2], shape (n,).
        jerk: Jerk of the commands [unit/s^3], shape (n,).
        step: Largest distance from a winch to its first command [unit], shape (n,).
        following: Largest distance from a winch to its set position [unit], shape (n,).
    """

    length_min: Array
    length_max: Array
    speed: Array
    acceleration: Array
    jerk: Array
    step: Array
    following: Array


class Winches:
    """Set point generators of all winches.

    Attributes:
        position: Set positions [unit], shape (n,).
        speed: Set velocities [unit/s], shape (n,).
        speed_peak: Largest absolute set velocity so far [unit/s], shape (n,).
        acceleration_peak: Largest absolute acceleration so far [unit/s^2], shape (n,).
    """

    def __init__(self, limits: WinchLimits, cycle: float) -> None:
        """Stand at 0; call `place` first.

        Args:
            limits: Limits of the set points.
            cycle: Period of the PLC [s].
        """
        self._limits = limits
        self._cycle = cycle
        n = len(limits.speed)
        self.speed_peak, self.acceleration_peak = np.zeros(n), np.zeros(n)
        self.place(np.zeros(n))

    @property
    def at_rest(self) -> bool:
        """True if no set position moves."""
        return not self.speed.any()

    def place(self, position: Array) -> None:
        """Set the set positions, at rest."""
        self.position = np.array(position, dtype=np.float64)
        self.speed = np.zeros_like(self.position)
        self._direction = np.zeros_like(self.position)
        self._start: tuple[Array, Array] | None = None
        self._braked = np.zeros(len(self.position), dtype=bool)

    @property
    def beyond_ends(self) -> bool:
        """Return whether a set position lies beyond a soft end and moves further out."""
        limits = self._limits
        slack = END_TOLERANCE * (limits.length_max - limits.length_min)
        above = (self.position > limits.length_max + slack) & (self.speed > 0.0)
        below = (self.position < limits.length_min - slack) & (self.speed < 0.0)
        return bool((above | below).any())

    def follow(self, goal: Array, rate: Array, time_constant: float) -> None:
        """Move one cycle towards a moving goal, within the limits of each winch.

        Distances vanish in proportion, and speeds change in proportion. Winches that are ahead of
        their goal wait for it; if it stops behind them, they go back at `RETURN_RATIO`.

        Args:
            goal: Position of the goal at the end of this cycle [unit], shape (n,).
            rate: Its velocity then [unit/s], shape (n,).
            time_constant: Time constant with which small distances vanish [s].
        """
        self._start, self._braked = None, np.zeros_like(self._braked)
        limits, cycle = self._limits, self._cycle
        goal = np.clip(goal, limits.length_min, limits.length_max)
        error = goal - self.position - 0.5 * (self.speed + rate) * cycle
        brake = BRAKING_SHARE * limits.acceleration
        distance = np.maximum(np.abs(error), 1e-12)
        closing = min(1.0 / time_constant, float(np.sqrt(2.0 * brake / distance).min()))
        back = RETURN_RATIO * limits.speed
        direction = np.where(np.abs(rate) > back, np.sign(rate), self._direction)
        room = np.where(error * direction < 0.0, (np.abs(rate) + back) / distance, np.inf)
        wanted = rate + min(closing, float(room.min())) * error
        change_max = limits.acceleration * cycle
        still = (np.abs(error) < 1e-9) & (rate == 0.0) & (np.abs(self.speed) <= change_max)
        change = np.where(still, 0.0, wanted) - self.speed
        change *= min(1.0, float((change_max / np.maximum(np.abs(change), 1e-300)).min()))
        down, up = self._ends(brake)
        ended = np.clip(
            self.speed + change, -np.minimum(limits.speed, down), np.minimum(limits.speed, up)
        )
        self._advance(np.clip(ended, self.speed - change_max, self.speed + change_max))

    def ramp(self, tripped: Array) -> None:
        """Move one cycle of the ramp to rest: all winches slow down by one common factor.

        A winch that would run past a soft end brakes sooner than the others.

        Args:
            tripped: Whether the brake of each winch stops it instead, shape (n,); it then holds
                for the rest of the ramp.
        """
        if self._start is None:
            self._start = (self.speed.copy(), np.zeros(1))
        speed, elapsed = self._start
        elapsed += self._cycle
        self._braked = self._braked | tripped
        limits = self._limits.acceleration
        needed = float((np.abs(speed) / limits).max())
        factor = max(0.0, 1.0 - float(elapsed[0]) / needed) if needed > 0.0 else 0.0
        factor = 0.0 if factor < 1e-9 else factor
        down, up = self._ends(limits)
        change_max = limits * self._cycle
        down, up = (
            np.maximum(down, -self.speed - change_max),
            np.maximum(up, self.speed - change_max),
        )
        now = np.abs(self.speed)
        ramped = np.clip(factor * speed, -np.minimum(down, now), np.minimum(up, now))
        ramped = np.where(np.abs(ramped) < 1e-9 * np.abs(speed), 0.0, ramped)
        least = np.abs(self.speed) - BRAKE_RATIO * limits * self._cycle
        braked = np.sign(self.speed) * np.maximum(least, 0.0)
        self._advance(np.where(self._braked, braked, ramped))

    def _ends(self, brake: Array) -> tuple[Array, Array]:
        """Return the largest speeds down and up from which each winch can stop at its soft end.

        They hold at the end of this cycle: v^2 = 2 * brake * (distance left after it).

        Args:
            brake: Deceleration to plan with [unit/s^2], shape (n,).

        Returns:
            Speeds [unit/s], each of shape (n,).
        """
        limits, lost = self._limits, brake * self._cycle
        speeds = []
        for distance, speed in (
            (self.position - limits.length_min, -self.speed),
            (limits.length_max - self.position, self.speed),
        ):
            left = np.maximum(0.25 * lost**2 + 2.0 * brake * distance - lost * speed, 0.0)
            speeds.append(np.maximum(np.sqrt(left) - 0.5 * lost, 0.0))
        return speeds[0], speeds[1]

    def _advance(self, speed: Array) -> None:
        """Move one cycle, to a new velocity."""
        change = np.abs(speed - self.speed) / self._cycle
        self.position = self.position + 0.5 * (self.speed + speed) * self._cycle
        self.speed = speed
        moving = np.abs(speed) > 2.0 * RETURN_RATIO * self._limits.speed
        self._direction = np.where(moving, np.sign(speed), self._direction)
        self.speed_peak = np.maximum(self.speed_peak, np.abs(speed))
        self.acceleration_peak = np.maximum(self.acceleration_peak, change)
