"""Brake of a guard: the stop along the path, whatever fails."""

from __future__ import annotations

import time

import numpy as np

from carosac_toolkit.loop.drive_state import DriveState, Fault
from carosac_toolkit.loop.protocols import SupportsDisable, SupportsFaultHold
from carosac_toolkit.loop.values import Command
from carosac_toolkit.safety.guard.checks import Finding
from carosac_toolkit.safety.guard.commander import Commander
from carosac_toolkit.safety.guard.inner import described
from carosac_toolkit.safety.guard.monitor import Monitor
from carosac_toolkit.safety.guard.timing import CycleTimer

SETTLING_LAGS = 4.0  # winch lags after the last command of a stop: 2 % of it is then left to go
STOP_TIME_MAX_S = 5.0  # nine times the stop of the bundled `carosac` from full speed
HANG_TIME_AT_REST_S = 10.0  # such as in the first cycle, where programs load what they need


class Brake:
    """Brings the winches of a guard to rest, also from the thread of its watchdog."""

    def __init__(self, monitor: Monitor, commander: Commander, cycles: CycleTimer) -> None:
        """Brake what the commander sends; `cycles` knows how long a controller takes."""
        self._monitor, self._commander, self._cycles = monitor, commander, cycles
        self._life = monitor.lifecycle

    def send(self, asked: Command | None) -> Command:
        """Send the next command of the stop along the path, and journal it.

        Args:
            asked: Command of the controller that is not followed, or None.
        """
        monitor = self._monitor
        why = "warm_up" if self._cycles.warming else "stop"
        if self._life.fault is not None:
            why = str(self._life.fault.fault)
        return self._commander.brake(monitor.now if asked is None else asked.time, asked, why)

    def begin(self) -> None:
        """Begin a stop before anybody hears of it."""
        if self._life.live and not self._monitor.sent:
            self._monitor.quietly(self.send, None)

    def slow_down(self) -> bool:
        """Pass one period of a stop."""
        if not self._monitor.sent:
            self.send(None)
        return self._monitor.pass_period()

    def run_down(self) -> None:
        """Brake along the path until the winches are at rest, then disable, whatever happens."""
        life = self._life
        if not life.live:
            return
        try:
            self.begin()
            if life.fault is None:
                life.go(DriveState.STOPPING)
            self._monitor.quietly(self.to_rest)
        finally:
            life.live = False
            self._monitor.quietly(self.switch_off)
            self._monitor.checks.standing(None)
        if life.fault is None:
            life.go(DriveState.HOMED)

    def switch_off(self) -> None:
        """Disable the drives; where they can, they hold a fault of this host for the next one."""
        inner, report = self._monitor.inner, self._life.fault
        if isinstance(inner, SupportsFaultHold) and report is not None:
            inner.hold_fault(report.fault)
            self._monitor.held = Finding(fault=report.fault, text=report.text)
        elif isinstance(inner, SupportsDisable):
            self._monitor.call(inner.disable)  # who cannot be reached may latch a fault

    def to_rest(self) -> None:
        """Pass all cycles of a stop, blind where the driver fails, up to `STOP_TIME_MAX_S`."""
        monitor, commander = self._monitor, self._commander
        period, blind = monitor.settings.period, 0
        rest = int(np.ceil(SETTLING_LAGS * monitor.robot.winch_lag.max() / period))
        for _ in range(int(np.ceil(STOP_TIME_MAX_S / period))):
            rest -= commander.at_rest and commander.slowing
            if rest < 0:
                monitor.event("at_rest", f"as told, {blind} cycles unseen" if blind else "")
                return
            began = time.monotonic()
            try:
                if not self.slow_down():
                    monitor.event("let_go", "the driver behind has stopped by itself")
                    return
                monitor.measure()
            except Exception as error:  # commands may still arrive
                blind += 1
                monitor.sent = False
                if blind == 1:
                    monitor.event("error", described(error))
                if monitor.real_time:
                    time.sleep(max(0.0, began + period - time.monotonic()))
        monitor.event("not_at_rest", f"given up after {STOP_TIME_MAX_S:g} s")

    def miss(self) -> bool:
        """Slow down for a controller that is late, and stop for good where it takes too long.

        Returns:
            True where the controller hangs; the winches are then at rest.
        """
        life, waited = self._life, self._cycles.waited
        if not life.live:
            return False
        moving = self._commander.slowing or not self._commander.at_rest
        slowing = moving and life.state is not DriveState.ENABLED
        if waited > (self._monitor.settings.hang_time if slowing else HANG_TIME_AT_REST_S):
            text = f"the controller gave no command for {waited:.3f} s"
            self._monitor.latch(Finding(fault=Fault.CONTROLLER, text=text))
            self.run_down()
            return True
        if slowing:
            self._monitor.quietly(self.slow_down)
        return False
