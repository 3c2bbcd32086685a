"""Set positions of n winches: they follow a host within limits, or ramp to rest together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.arrays import Array

_BRAKE = 2.0  # deceleration of a tripped drive, by its brake, over the acceleration limit
HEADROOM = 1.2  # of the drives over the acceleration limit, to come back to the motion asked for
_MARGIN = 0.8  # share of the acceleration limit on which braking to a goal counts
_SLACK = 1e-5  # share of the travel that a set position may lie beyond an end by rounding


@dataclass(frozen=True, kw_only=True, eq=False)
class WinchLimits:
    """Limits that the PLC keeps by itself, in its units.

    Attributes:
        length_min: Soft end positions [unit], shape (n,).
        length_max: [unit], shape (n,).
        speed: [unit/s], shape (n,).
        acceleration: [unit/s^2], shape (n,).
        jerk: Of commands [unit/s^3], shape (n,).
        step: Largest distance of the first command from where a winch stands [unit], shape (n,).
        following: Largest distance of a winch from its set position [unit], shape (n,).
    """

    length_min: Array
    length_max: Array
    speed: Array
    acceleration: Array
    jerk: Array
    step: Array
    following: Array


class Winches:
    """The set point generators of all winches.

    Attributes:
        position: Set positions [unit], shape (n,).
        speed: Set velocities [unit/s], shape (n,).
        speed_peak: Largest absolute set velocity so far, shape (n,).
        acceleration_peak: Largest absolute change of set velocity, drive brakes aside [unit/s^2].
    """

    def __init__(self, limits: WinchLimits, cycle: float) -> None:
        """Stand at 0; call `place` first.

        Args:
            limits: Of the set points.
            cycle: Of the PLC [s].
        """
        self._limits = limits
        self._cycle = cycle
        n = len(limits.speed)
        self.speed_peak, self.acceleration_peak = np.zeros(n), np.zeros(n)
        self.place(np.zeros(n))

    @property
    def at_rest(self) -> bool:
        """Whether no set point moves."""
        return not self.speed.any()

    def place(self, position: Array) -> None:
        """Stand here."""
        self.position = np.array(position, dtype=np.float64)
        self.speed = np.zeros_like(self.position)
        self._start: tuple[Array, Array] | None = None
        self._braked = np.zeros(len(self.position), dtype=bool)

    @property
    def beyond_ends(self) -> bool:
        """Whether a set position lies beyond a soft end and moves further out."""
        limits = self._limits
        slack = _SLACK * (limits.length_max - limits.length_min)
        above = (self.position > limits.length_max + slack) & (self.speed > 0.0)
        below = (self.position < limits.length_min - slack) & (self.speed < 0.0)
        return bool((above | below).any())

    def follow(self, goal: Array, rate: Array, time_constant: float) -> None:
        """One cycle towards a goal that moves, each winch within its own limits and `HEADROOM`.

        Args:
            goal: Where it is at the end of this cycle [unit], shape (n,).
            rate: How fast it moves then [unit/s], shape (n,).
            time_constant: In which small distances vanish [s].
        """
        self._start, self._braked = None, np.zeros_like(self._braked)
        limits, cycle = self._limits, self._cycle
        goal = np.clip(goal, limits.length_min, limits.length_max)
        error = goal - self.position - 0.5 * (self.speed + rate) * cycle
        brake = _MARGIN * limits.acceleration
        closing = np.minimum(np.abs(error) / time_constant, np.sqrt(2.0 * brake * np.abs(error)))
        wanted = rate + np.sign(error) * closing
        down, up = self._ends(brake)
        wanted = np.clip(wanted, -np.minimum(limits.speed, down), np.minimum(limits.speed, up))
        most = HEADROOM * limits.acceleration * cycle
        still = (np.abs(error) < 1e-9) & (rate == 0.0) & (np.abs(self.speed) <= most)
        change = np.clip(wanted - self.speed, -most, most)
        change = np.where(still, -self.speed, change)
        self._advance(self.speed + change)

    def ramp(self, tripped: Array) -> None:
        """One cycle of the ramp to rest: all winches by one common factor, along their path.

        A winch that would run past a soft end so brakes sooner than the others.

        Args:
            tripped: Winches that their brakes stop, and not the ramp, shape (n,); they are held
                for the rest of it.
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
        most = HEADROOM * limits * self._cycle  # where a ramp begins too near to an end
        down, up = np.maximum(down, -self.speed - most), np.maximum(up, self.speed - most)
        now = np.abs(self.speed)
        ramped = np.clip(factor * speed, -np.minimum(down, now), np.minimum(up, now))
        ramped = np.where(np.abs(ramped) < 1e-9 * np.abs(speed), 0.0, ramped)
        least = np.abs(self.speed) - _BRAKE * limits * self._cycle
        braked = np.sign(self.speed) * np.maximum(least, 0.0)
        self._advance(np.where(self._braked, braked, ramped), self._braked)

    def _ends(self, brake: Array) -> tuple[Array, Array]:
        """Speeds down and up from which each winch can brake before its soft end, shape (n,).

        They hold at the end of this cycle: v^2 = 2 * brake * (distance left after it).

        Args:
            brake: Deceleration on which to count [unit/s^2], shape (n,).
        """
        limits, lost = self._limits, brake * self._cycle
        found = []
        for far, speed in (
            (self.position - limits.length_min, -self.speed),
            (limits.length_max - self.position, self.speed),
        ):
            left = np.maximum(0.25 * lost**2 + 2.0 * brake * far - lost * speed, 0.0)
            found.append(np.maximum(np.sqrt(left) - 0.5 * lost, 0.0))
        return found[0], found[1]

    def _advance(self, speed: Array, but: Array | None = None) -> None:
        """Move one cycle to a new velocity."""
        change = np.abs(speed - self.speed) / self._cycle
        change = change if but is None else np.where(but, 0.0, change)
        self.position = self.position + 0.5 * (self.speed + speed) * self._cycle
        self.speed = speed
        self.speed_peak = np.maximum(self.speed_peak, np.abs(speed))
        self.acceleration_peak = np.maximum(self.acceleration_peak, change)
