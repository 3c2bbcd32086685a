"""The driver `guarded`: lifecycle and safety on top of any other driver, simulated or real.

Without `motion` a run is dry: commands are checked, limited and journaled, and not sent. A fault is
latched: all cables brake together along the path that they are on (`CoordinatedStop`), `wait` says
False, and nothing moves again before `reset_fault`, `enable`, and, where the fault took the homing
with it, `home`.

What a guard knows stands in `carosac_toolkit.safety.guard.monitor`, how it brakes in
`carosac_toolkit.safety.guard.brake`; here are the lifecycle and the cycle.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.base.numbers import check_period
from carosac_toolkit.loop.drive_state import DriveState
from carosac_toolkit.loop.values import Command, State
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.safety.guard.brake import BrakingGuard
from carosac_toolkit.safety.guard.inner import (
    build_inner,
    holds_fault,
    homing_lengths,
    inner_finding,
)
from carosac_toolkit.safety.guard.lifecycle import NotReady
from carosac_toolkit.safety.guard.monitor import check_shape
from carosac_toolkit.safety.guard.settings import GuardSettings
from carosac_toolkit.safety.guard.timing import Watchdog

DRIVEN = (DriveState.ENABLED, DriveState.FOLLOWING)


class GuardedDriver(BrakingGuard):
    """One guarded robot of n cables; a `carosac_toolkit.loop.protocols.MotionDriver`.

    Every call on the driver behind it holds one lock, as a watchdog brakes where the controller
    does not come back. `stop` ends a run; to move again after it, connect anew. For its attributes
    see `carosac_toolkit.safety.guard.monitor.GuardCore`.
    """

    @classmethod
    def build(
        cls, robot: Robot, settings: GuardSettings | None = None, *, seed: int = 0
    ) -> GuardedDriver:
        """Make the driver behind it by name, for the same robot and seed.

        Raises:
            InvalidField: A driver that replays, or settings that it does not have.
        """
        chosen = settings or cls.Settings()
        inner, real_time = build_inner(robot, chosen, seed)
        return cls(inner, robot, chosen, real_time=real_time)

    def connect(self) -> None:
        """Connect the driver behind; homed and enabled at once where the settings say so.

        Raises:
            IllegalTransition: It is connected.
            CarosacError: What the driver behind says, or why it cannot be enabled.
        """
        with self._lock:
            self._life.allow("connect")
            self._forget()
            self._checks.prepare()
            self.inner.connect()
            self._checks = self._new_checks()  # the driver now knows how patient it must be
            self._life.go(DriveState.CONNECTED)
            try:
                motion, start = self.settings.motion, self._start()
                emulated = motion and self.settings.set_down
                emulated = emulated and getattr(self.inner, "emulated", False)
                if motion and (self.settings.reset_at_once or emulated):
                    self._reset_inner()
                if emulated:
                    self.inner.set_down(tuple(float(x) for x in start.position[0]))
                moves = self.settings.enable_at_once and motion
                if moves:
                    self._check_held()
                self.measure()
                if moves:
                    self.home(start, anew=self.settings.home_anew or emulated)
                    self.enable()
                elif self.settings.rehearse and not self.settings.motion:
                    self.home(self._start(), anew=self.settings.home_anew)
                    self._ready_to_enable()
            except BaseException:
                self.close()
                raise
            if self.real_time:
                period = self.settings.period
                self._watchdog = Watchdog(
                    period, lambda: self._time.waited, self._miss, self._miss_failed
                )
                self._watchdog.start()

    def _reset_inner(self) -> None:
        """Clear the fault that the driver behind holds from an earlier run; it must be homed."""
        held = inner_finding(self.inner)
        if held is not None and hasattr(self.inner, "reset_fault"):
            self._event("reset", f"{held.fault}: {held.text}")
            self.inner.reset_fault()
            self.cleared = held

    def _check_held(self) -> None:
        """Refuse to move drives that hold a fault, as one of an earlier run or case."""
        held = inner_finding(self.inner) if holds_fault(self.inner) else None
        if held is not None:
            raise NotReady(
                f"enable: the drives hold a fault of before: {held.fault}: {held.text}. "
                f"{held.fault.meaning} Find out why, then reset it (--reset, reset_at_once=True)"
            )

    def home(self, position: State, *, anew: bool = False) -> None:
        """Find the offset of each cable; the platform stands still at this pose.

        Args:
            position: A batch of one. Its lengths count if it has some; else those of the statics:
                with six cables or more at its rotation, with fewer at that of rest.
            anew: Whether offsets may change by more than `GuardSettings.home_change_max`, such as
                where they were never found before; only for a pose that was measured.

        Raises:
            IllegalTransition: Not connected, or enabled.
            NotReady: The lengths change, there is a fault, or an offset would change by too much.
            InvalidField: No pose of rest.
        """
        with self._lock:
            self._life.allow("home")
            lengths = homing_lengths(self._robot, position)
            standing = self._standing_still()
            if not anew:
                self._check_home(lengths - standing)
            if hasattr(self.inner, "home"):
                self.inner.home(replace(position, unstrained_length=lengths[None]))
            else:
                self._out.offset = self._out.offset + (lengths - standing)
            self._checks = self._new_checks()
            self._life.go(DriveState.HOMED)
            self.home_change = lengths - standing
            said = ", ".join(f"{x:+.4f}" for x in self.home_change)
            self._event("home", f"readings changed by {said} m")
            self.measure()

    def enable(self) -> None:
        """Let commands through, from where the winches stand.

        Raises:
            IllegalTransition: Not homed.
            NotReady: The settings forbid motion, the lengths change, or a check finds something.
            InvalidField: The winches stand outside their limits.
            CarosacError: What the driver behind says.
        """
        with self._lock:
            self._life.allow("enable")
            if not self.settings.motion:
                raise NotReady("enable: this guard is read only; set motion=True on purpose")
            standing = self._ready_to_enable()
            if hasattr(self.inner, "enable"):
                self.inner.enable()
            self._checks.standing(standing)
            self._time.warm_up()
            self._live, self._ended = True, False
            self._life.go(DriveState.ENABLED)

    def _ready_to_enable(self) -> Array:
        """Where the winches stand [m], shape (n,), once nothing speaks against enabling."""
        standing = self._standing_still()
        if self.finding is not None:
            raise NotReady(f"enable: {self.finding.fault}: {self.finding.text}")
        self._out.start(standing)
        return standing

    def disable(self) -> None:
        """Come to rest along the path and let no command through; `enable` may follow."""
        with self._lock:
            self._life.allow("disable")
            self._run_down()

    def reset_fault(self) -> None:
        """Clear the latched fault, once its cause is gone and the winches are at rest.

        Raises:
            IllegalTransition: There is no fault.
            NotReady: The cause is still there; the fault stays.
            CarosacError: What the driver behind says; the fault stays.
        """
        with self._lock:
            self._life.allow("reset_fault")
            self._run_down()
            if hasattr(self.inner, "reset_fault"):
                self.inner.reset_fault()
            self.measure()  # a length that jumped since the last one costs the homing
            latched, self._life.fault = self._life.fault, None
            self._checks = self._new_checks()
            try:
                self._standing_still()
                if self.finding is not None:
                    raise NotReady(f"{self.finding.fault}: {self.finding.text}")
            except CarosacError as error:
                self._life.fault = latched
                self._quietly(self._switch_off)
                raise NotReady(f"reset_fault: {error}; the fault stays") from error
            self._life.release()

    def command(self, command: Command) -> Command:
        """Check, limit and send a command.

        Returns:
            What was really sent, with every limit hit: ``not_enabled`` where nothing was,
            ``warm_up`` in the first cycles, ``stop`` or the name of the fault where the winches
            brake instead.

        Raises:
            InvalidField: Another shape.
            CarosacError: This cycle has its command already.
        """
        with self._lock:
            self._check_connected()
            check_shape(command.unstrained_length, self._robot.n)
            measured = self._measured if self._measured is not None else self.measure()
            if self._life.state in DRIVEN:
                first = self._life.state is DriveState.ENABLED
                standing = self._out.motion.length if first else measured.unstrained_length
                found = self._checks.command(command, standing[0], first=first)
                if found is not None:
                    self.latch(found)
                elif not self._time.warming:
                    return self._follow(command, measured)
            if self._live:
                return self._brake(command)
            return self._dry_run(command, np.asarray(measured.unstrained_length))

    def wait(self, duration: float) -> bool:
        """Wait to the next tick; a cycle without a command slows down along the path.

        Returns:
            False at a latched fault, after `stop` or `end`, and where the driver behind says so.

        Raises:
            InvalidField: Another duration than the period, for which the limits count.
        """
        with self._lock:
            self._check_connected()
            check_period(duration, self.settings.period, "guard")
            if self._live and not self._out.sent:
                self._brake(None)
            found = self._time.end_cycle()
            if found is not None and self._live:
                self.latch(found)
            alive = self._pass_period()
            self._time.begin()
            return alive and not self._ended and self.ending is None and self.fault is None

    def close(self) -> None:
        """Come to rest and let go."""
        watchdog = self._watchdog
        try:
            with self._lock:
                self._watchdog = None
                try:
                    self._run_down()
                finally:
                    self._let_go()
        finally:
            if watchdog is not None:
                watchdog.end()
            self.end_recording()

    def _check_home(self, change: Array) -> None:
        """Refuse to change the offsets by more than a homing of every day does."""
        i, most = int(np.argmax(np.abs(change))), self.settings.home_change_max
        if abs(change[i]) > most:
            cable = self._robot.cable_names[i]
            raise NotReady(
                f"home: the offset of cable '{cable}' would change by {change[i]:+.3f} m; allowed: "
                f"{most:g} m. Is the platform at the pose that was given? Where that was measured, "
                "home anew (home_anew, --home-anew)"
            )

    def _start(self) -> State:
        """The pose by which `enable_at_once` homes."""
        robot, point = self._robot, self.settings.start_position
        position = robot.home_position if point is None else np.asarray(point, dtype=float)
        rotation = robot.home_rotation
        return State(
            time=np.zeros(1), position=position.reshape(1, 3), rotation=rotation.reshape(1, 3, 3)
        )

    def _standing_still(self) -> Array:
        """Mean of some samples of winches that stand [m], shape (n,)."""
        lengths = []
        for _ in range(self.settings.homing_samples):
            lengths.append(self.measure().unstrained_length[0])
            self._pass_period()
            if self.fault is not None:
                raise NotReady(str(self.fault))
        moved = float(np.ptp(lengths, axis=0).max())
        if moved > self.settings.rest_max:
            allowed = f"allowed: {self.settings.rest_max:g} m"
            raise NotReady(f"the winches do not stand still: {moved:.4f} m of change; {allowed}")
        return np.asarray(np.mean(lengths, axis=0))
