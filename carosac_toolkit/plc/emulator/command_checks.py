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
ARRIVAL_JITTER_MAX_S = 0.05  # by which commands may come sooner than at the speed limit


@dataclass
class Counters:
    """Counts of events since the PLC started.

    Attributes:
        commands: New commands followed or refused.
        lost: Commands that never arrived.
        not_finite: Commands with NaN or infinity, or with a period out of range or changed.
        over_length: Commands outside the soft end positions.
        over_speed: Commands that asked for more than the speed limit.
        over_acceleration: The same of acceleration, from three commands in a row.
        over_jerk: The same of jerk, from four.
        jumps: Commands too far from where the winches stood at rest.
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
    """Checks of successive commands against the limits, by the clock of the PLC.

    The period and the number of a command come from the host. They count only as far as the time
    between its arrivals has room for them.

    Attributes:
        gap: Periods from the last command to the newest, 1 or more.
    """

    def __init__(
        self, limits: WinchLimits, counters: Counters, *, period_min: float, period_max: float
    ) -> None:
        """Set up; call `reset` before anything else.

        Args:
            limits: Limits of the winches.
            counters: Where to count.
            period_min: Shortest period of the commands [s].
            period_max: Longest [s].
        """
        self._limits, self._counters = limits, counters
        self._periods = (period_min, period_max)
        self.reset(np.zeros(len(limits.speed)), 0, 0.0)

    def reset(self, position: Array, number: int, now: float) -> None:
        """Start at rest at set positions [unit], shape (n,), after command `number`, at a time."""
        rest = np.zeros_like(position)
        self._last: list[Array | None] = [np.array(position), rest, rest]
        self._number, self._period, self._time, self._ahead = number, 0.0, now, 0.0
        self.gap = 1

    def check(self, host: dict[str, Any], position: Array, *, now: float, standing: bool) -> Fault:
        """Count one new command; return the fault that forbids to follow it, if any.

        A host that goes on elsewhere after its commands have run out was away.

        Args:
            host: Members of `blocks.from_host` by name.
            position: Present set positions [unit], shape (n,).
            now: Clock of the PLC [s].
            standing: Whether the winches stand, before the first command or for want of any.
        """
        counters, limits = self._counters, self._limits
        counters.commands += 1
        length, rate, period = host["length"], host["rate"], host["period"]
        finite = np.isfinite(length).all() and np.isfinite(rate).all()
        low, high = self._periods
        if not (finite and low <= period <= high and self._period in (0.0, period)):
            counters.not_finite += 1
            return Fault.COMMAND
        slack = LIMIT_TOLERANCE * (limits.length_max - limits.length_min)
        if ((length < limits.length_min - slack) | (length > limits.length_max + slack)).any():
            counters.over_length += 1
            return Fault.COMMAND
        if standing and (np.abs(length - position) > limits.step).any():
            counters.jumps += 1
            return Fault.COMMAND if self._period == 0.0 else Fault.HEARTBEAT_LOST
        elapsed, gap = now - self._time, (host["command"] - self._number) % 2**32
        self._number, self._period, self._time = host["command"], period, now
        duration = min(gap * period, elapsed + ARRIVAL_JITTER_MAX_S)
        self.gap = max(1, round(duration / period))
        counters.lost += self.gap - 1
        return self._differences(length, rate, duration, elapsed)

    def _differences(self, length: Array, rate: Array, duration: float, elapsed: float) -> Fault:
        """Check speed, acceleration and jerk; the last two are unknown after a lost command.

        Args:
            length: Command [unit], shape (n,).
            rate: Its velocity [unit/s], shape (n,).
            duration: Time since the last command [s], as the host says it.
            elapsed: The same by the clock of the PLC.
        """
        limits, old, lost = self._limits, self._last, self.gap > 1
        assert old[0] is not None
        step = length - old[0]
        needed = float((np.abs(step) / limits.speed).max()) / SPEED_FAULT_RATIO
        self._ahead = max(0.0, self._ahead + needed - elapsed)
        speed = step / duration
        acceleration = None if lost or old[1] is None else (speed - old[1]) / duration
        jerk = None
        if acceleration is not None and old[2] is not None:
            jerk = (acceleration - old[2]) / duration
        self._last = [length, None if lost else speed, acceleration]
        share = self._count("speed", np.maximum(np.abs(speed), np.abs(rate)), limits.speed)
        self._count("acceleration", acceleration, limits.acceleration)
        self._count("jerk", jerk, limits.jerk)
        over = share > SPEED_FAULT_RATIO or self._ahead > ARRIVAL_JITTER_MAX_S
        return Fault.OVER_LIMIT if over else Fault.NONE

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
