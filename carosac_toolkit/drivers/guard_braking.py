"""How a guard sends: commands that are followed, and the stop along the path, whatever fails."""

from __future__ import annotations

import time

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.drivers.guard_checks import Finding
from carosac_toolkit.drivers.guard_commander import changed
from carosac_toolkit.drivers.guard_core import GuardCore
from carosac_toolkit.drivers.guard_inner import described, error_finding, inner_finding
from carosac_toolkit.loop.drive_state import DriveState, Fault
from carosac_toolkit.loop.values import Command, Measurement

SETTLE = 4.0  # winch lags after the last command of a stop until the winches count as at rest


class BrakingGuard(GuardCore):
    """A guard that can bring its winches to rest, also from the thread of its watchdog."""

    def stop(self, reason: str) -> None:
        """Bring all cables to rest along their path, wait for it, and disable; ends the run."""
        with self._lock:
            if self._life.state is DriveState.DISCONNECTED:
                return
            self._brake_at_once()
            if not self._ended:
                self._event("stop", self.ending or reason)
            self._run_down()
            self._ended = True
            self._quietly(self.inner.stop, reason)

    def _follow(self, command: Command, measured: Measurement) -> Command:
        """Limit and send."""
        if self._out.sent:
            raise CarosacError(f"{self.name}: one command per cycle; call wait() before the next")
        self._life.go(DriveState.FOLLOWING)
        sent = self._out.follow(command, measured.unstrained_length)
        self._note(self.journal.sent, command, sent, really=True)
        return sent

    def _brake(self, asked: Command | None) -> Command:
        """Send the next command of the stop along the path, and journal it."""
        why = "warm_up" if self._time.warming else "stop"
        if self.fault is not None:
            why = str(self.fault.fault)
        already = self._out.sent
        sent = self._out.brake(self._now() if asked is None else asked.time, asked, why)
        if not already:
            self._note(self.journal.sent, asked, sent, really=True)
        return sent

    def _dry_run(self, command: Command, held: Array) -> Command:
        """Limit and journal a command, and say that the winches hold."""
        limited = command
        if self.fault is None and not self._ended:
            found = self._checks.command(command, held[0], first=not self._out.dry)
            try:
                if found is not None:
                    raise InvalidField(str(found.fault), found.text, "what `enable` lets through")
                limited = self._out.would_send(command, held)
                self._note(self.journal.sent, command, limited, really=False)
            except InvalidField as error:
                name, value = error.field, str(error.value)
                self.refused[name] = self.refused.get(name, 0) + 1
                self._event("would_be_refused", f"{name}: {value}")
        hits = (*limited.limited, *changed("not_enabled", command, held))
        return Command(time=command.time, unstrained_length=held, limited=hits)

    def _pass_period(self) -> bool:
        """Let one period pass on the driver behind; latch the fault that has ended it."""
        self._out.sent = False
        alive = bool(self._call(self.inner.wait, self.settings.period))
        following = self._life.state is DriveState.FOLLOWING
        found = None if alive or self._ended else inner_finding(self.inner, following=following)
        if found is not None and (self._live or self._counts_at_rest(found)):
            self.latch(found)
        return alive

    def _slow_down(self) -> bool:
        """One period of a stop."""
        if not self._out.sent:
            self._brake(None)
        return self._pass_period()

    def _brake_at_once(self) -> None:
        """Begin a stop before anybody hears of it."""
        if self._live and not self._out.sent:
            self._quietly(self._brake, None)

    def _run_down(self) -> None:
        """Brake along the path until the winches are at rest, then disable, whatever happens."""
        if not self._live:
            return
        try:
            self._brake_at_once()
            if self.fault is None:
                self._life.go(DriveState.STOPPING)
            self._quietly(self._brake_to_rest)
        finally:
            self._live = False
            self._quietly(self._switch_off)
            self._checks.standing(None)
        if self.fault is None:
            self._life.go(DriveState.HOMED)

    def _switch_off(self) -> None:
        """Disable the drives; they hold a fault of this side too, for whoever comes after us."""
        hold = getattr(self.inner, "hold_fault", None)
        if hold is not None and self.fault is not None:
            hold(self.fault.fault)
            self.held = Finding(fault=self.fault.fault, text=self.fault.text)
        elif hasattr(self.inner, "disable"):
            self.inner.disable()

    def _brake_to_rest(self) -> None:
        """All cycles of a stop, blind where the driver fails; gives up after `stop_time_max`."""
        period, blind = self.settings.period, 0
        rest = int(np.ceil(SETTLE * self._robot.winch_lag.max() / period))
        for _ in range(int(np.ceil(self.settings.stop_time_max / period))):
            rest -= self._out.at_rest and self._out.slowing
            if rest < 0:
                self._event("at_rest", f"as told, {blind} cycles unseen" if blind else "")
                return
            began = time.monotonic()
            try:
                if not self._slow_down():
                    self._event("let_go", "the driver behind has stopped by itself")
                    return
                self.measure()
            except Exception as error:  # commands may still arrive
                blind += 1
                self._out.sent = False
                if blind == 1:
                    self._event("error", described(error))
                if self.real_time:
                    time.sleep(max(0.0, began + period - time.monotonic()))
        self._event("not_at_rest", f"given up after {self.settings.stop_time_max:g} s")

    def _let_go(self) -> None:
        """Close the driver behind."""
        if self._life.state is not DriveState.DISCONNECTED:
            self._quietly(self.inner.close)
            self._life.go(DriveState.DISCONNECTED)

    def _miss(self) -> None:
        """Called by the watchdog: slow down; stop for good where it takes too long."""
        hung = None
        with self._lock:
            if not self._live:
                return
            moving = self._out.slowing or not self._out.at_rest
            slowing = moving and self._life.state is not DriveState.ENABLED
            waited, settings = self._time.waited, self.settings
            if waited > (settings.hang_time if slowing else settings.hang_time_at_rest):
                text = f"the controller gave no command for {waited:.3f} s"
                self.latch(Finding(fault=Fault.CONTROLLER, text=text))
                self._run_down()
                hung = self.on_hang
            elif slowing:
                self._quietly(self._slow_down)
        if hung is not None:
            hung()

    def _miss_failed(self, error: Exception) -> None:
        """The watchdog could not brake: have the driver behind stop by itself."""
        with self._lock:
            self._quietly(self.inner.stop, "the watchdog failed")
            self._quietly(self.latch, error_finding(error))
