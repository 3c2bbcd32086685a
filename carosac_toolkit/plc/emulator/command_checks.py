"""Checks of every command that reaches the emulated PLC, and their counters."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop.drive_state import Fault
from carosac_toolkit.plc.emulator.winches import WinchLimits

LIMIT_TOLERANCE = 1e-4  # share of a limit that rounding and a change of units may take
SPEED_FAULT_RATIO = 1.05  # over the speed limit; above it the PLC stops


@dataclass
class Counters:
    """Counts of events since the PLC started.

    Attributes:
        commands: New commands followed or refused.
        lost: Commands that never arrived.
        not_finite: Commands with NaN or infinity.
        over_length: Commands outside the soft end positions.
        over_speed: Commands that asked for more than the speed limit.
        over_acceleration: The same of acceleration, from three commands in a row.
        over_jerk: The same of jerk, from four.
        jumps: First commands too far from where a winch stood.
        ignored: Commands that came while the PLC did not follow.
        foreign: Writes of other sessions than the one it obeys.
        torn: Blocks that were not of one write.
        watchdog: Times the host fell silent while the drives were on.
        beyond_ends: Cycles in which a set position moved beyond a soft end.
        worst: Largest share of a limit asked for, by name; 1 is the limit.
    """

    commands: int = 0
    lost: int = 0
    not_finite: int = 0
    over_length: int = 0
    over_speed: int = 0
    over_acceleration: int = 0
    over_jerk: int = 0
    jumps: int = 0
    ignored: int = 0
    foreign: int = 0
    torn: int = 0
    watchdog: int = 0
    beyond_ends: int = 0
    worst: dict[str, float] = field(
        default_factory=lambda: {"speed": 0.0, "acceleration": 0.0, "jerk": 0.0}
    )


class CommandChecks:
    """Checks of successive commands against the limits."""

    def __init__(self, limits: WinchLimits, counters: Counters) -> None:
        self._limits = limits
        self._counters = counters
        self.reset(np.zeros(len(limits.speed)), 0)

    def reset(self, position: Array, number: int) -> None:
        """Start at rest at set positions [unit], shape (n,), after command `number`."""
        rest = np.zeros_like(position)
        self._last: list[Array | None] = [np.array(position), rest, rest]
        self._number, self._first = number, True

    def check(self, host: dict[str, Any], position: Array) -> Fault:
        """Count one new command; return the fault that forbids to follow it, if any.

        Args:
            host: Members of `blocks.from_host` by name.
            position: Present set positions [unit], shape (n,).
        """
        counters, limits = self._counters, self._limits
        counters.commands += 1
        length, rate, period = host["length"], host["rate"], host["period"]
        finite = np.isfinite(length).all() and np.isfinite(rate).all() and np.isfinite(period)
        if not finite or period <= 0.0:
            counters.not_finite += 1
            return Fault.COMMAND
        slack = LIMIT_TOLERANCE * (limits.length_max - limits.length_min)
        if ((length < limits.length_min - slack) | (length > limits.length_max + slack)).any():
            counters.over_length += 1
            return Fault.COMMAND
        if self._first and (np.abs(length - position) > limits.step).any():
            counters.jumps += 1
            return Fault.COMMAND
        gap = (host["command"] - self._number) % 2**32
        self._number, self._first = host["command"], False
        counters.lost += gap - 1
        return self._differences(length, gap, period)

    def _differences(self, length: Array, gap: int, period: float) -> Fault:
        """Check speed, acceleration and jerk; the last two are unknown after a lost command."""
        limits, old = self._limits, self._last
        assert old[0] is not None
        speed = (length - old[0]) / (gap * period)
        acceleration = None if gap > 1 or old[1] is None else (speed - old[1]) / period
        before = old[2]
        jerk = None if acceleration is None or before is None else (acceleration - before) / period
        self._last = [length, speed if gap == 1 else None, acceleration]
        share = self._count("speed", speed, limits.speed)
        self._count("acceleration", acceleration, limits.acceleration)
        self._count("jerk", jerk, limits.jerk)
        return Fault.OVER_LIMIT if share > SPEED_FAULT_RATIO else Fault.NONE

    def _count(self, name: str, value: Array | None, limit: Array) -> float:
        """Compare with a limit; return the largest share of it."""
        if value is None:
            return 0.0
        share = float((np.abs(value) / limit).max())
        counters = self._counters
        counters.worst[name] = max(counters.worst[name], share)
        if share > 1.0 + LIMIT_TOLERANCE:
            setattr(counters, f"over_{name}", getattr(counters, f"over_{name}") + 1)
        return share
