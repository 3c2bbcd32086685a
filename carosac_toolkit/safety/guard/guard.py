"""The driver `guarded`: lifecycle and safety on top of any other driver, simulated or real.

Without `motion` a run is dry: commands are checked, limited and journaled, and not sent. A fault is
latched: all cables brake together along the path that they are on (`CoordinatedStop`), `wait`
returns False, and nothing moves again before `reset_fault`, `enable`, and, where the fault took the
homing with it, `home`.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import ClassVar

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.numbers import check_period
from carosac_toolkit.loop.drive_state import DriveState
from carosac_toolkit.loop.protocols import (
    Driver,
    MotionDriver,
    StatusSource,
    SupportsEnable,
    SupportsFaultReset,
    SupportsSetDown,
    TruthSource,
)
from carosac_toolkit.loop.values import Belief, Command, Measurement, State
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.safety.guard.brake import Brake
from carosac_toolkit.safety.guard.checks import Finding
from carosac_toolkit.safety.guard.commander import Commander, changed
from carosac_toolkit.safety.guard.homing import Homing
from carosac_toolkit.safety.guard.inner import (
    build_inner,
    check_no_fault_held,
    error_finding,
    interrupted_by_operator,
    plugin_finding,
    reset_held_fault,
)
from carosac_toolkit.safety.guard.journal import Journal, NoJournal
from carosac_toolkit.safety.guard.lifecycle import FaultReport, NotReady
from carosac_toolkit.safety.guard.monitor import Monitor, check_shape
from carosac_toolkit.safety.guard.settings import GuardSettings
from carosac_toolkit.safety.guard.timing import CycleTimer, Watchdog
from carosac_toolkit.safety.settled import settled

DRIVEN_STATES = (DriveState.ENABLED, DriveState.FOLLOWING)


class GuardedDriver(MotionDriver):
    """One guarded robot of n cables.

    Every call on the driver behind it holds one lock, as a watchdog brakes where the controller
    does not come back. `stop` ends a run; to move again after it, connect anew.

    Attributes:
        inner: The driver behind the guard.
        settings: Settings of the guard.
        real_time: Whether time is wall-clock time.
        journal: Listener to everything; set it before `connect`. In real time it is called from a
            thread of its own: one that blocks holds nobody up, and is a fault after `record_lag`.
        on_hang: Called by the watchdog once it has stopped the winches of a hanging controller.
        monitor: What passes to and from the driver, with lifecycle and checks; like the other
            parts (`commander`, `cycles`, `brake`, `homing`, `watchdog`) new at each `connect`.
        cleared: Fault that the drives held when `connect` reset them, or None.
        refused: Count of what would have been a fault in a dry run, by its name.
        ending: Reason of the first call of `end`, or None.
        unrecorded: Rows that the journal never got; counted in `close`.
    """

    Settings: ClassVar[type[GuardSettings]] = GuardSettings
    name: ClassVar[str] = "guarded"

    def __init__(
        self, inner: Driver, robot: Robot, settings: GuardSettings, *, real_time: bool
    ) -> None:
        """Guard a driver of a robot; `real_time`: its time is wall-clock time."""
        self.inner, self.settings, self.real_time = inner, settled(settings, robot), real_time
        self._robot = robot
        self._lock = threading.RLock()
        self.journal: Journal = NoJournal()
        self.on_hang: Callable[[], None] | None = None
        self._start_over()

    @classmethod
    def build(
        cls, robot: Robot, settings: GuardSettings | None = None, *, seed: int = 0
    ) -> GuardedDriver:
        """Make the driver behind it by name, for the same robot and seed.

        Raises:
            InvalidField: A driver that replays or is a guard, or settings that it does not have.
        """
        chosen = settled(settings or cls.Settings(), robot)
        inner, real_time = build_inner(robot, chosen, seed, guard=GuardedDriver)
        return cls(inner, robot, chosen, real_time=real_time)

    def _start_over(self) -> None:
        """Know nothing of the robot."""
        self.monitor = Monitor(
            self.inner, self._robot, self.settings, real_time=self.real_time,
            journal=lambda: self.journal,
        )  # fmt: skip
        self._life = self.monitor.lifecycle
        self.commander = Commander(self.monitor)
        self.cycles = CycleTimer(self.settings, real_time=self.real_time)
        self.brake = Brake(self.monitor, self.commander, self.cycles)
        self.homing = Homing(self.monitor)
        self.watchdog: Watchdog | None = None
        self.cleared: Finding | None = None
        self.refused: dict[str, int] = {}
        self.ending: str | None = None
        self.unrecorded = 0

    @property
    def state(self) -> DriveState:
        """State of the lifecycle; `ESTOP` where the driver behind says so."""
        state, inner = self._life.state, self.inner
        if state is DriveState.FAULT and isinstance(inner, StatusSource):
            return DriveState.ESTOP if inner.status() == DriveState.ESTOP else state
        return state

    def status(self) -> str:
        """Return `state` in one word."""
        return str(self.state)

    @property
    def fault(self) -> FaultReport | None:
        """Fault that was latched first, or None."""
        return self._life.fault

    @property
    def held(self) -> Finding | None:
        """Fault that the drives hold, see `Monitor`, or None."""
        return self.monitor.held

    @property
    def home_change(self) -> Array | None:
        """Change of the readings by the last homing [m], shape (n,), or None."""
        return self.homing.change

    @property
    def overruns(self) -> int:
        """Cycles since `connect` whose command took longer than a period, in real time."""
        return self.cycles.late

    @property
    def at_rest(self) -> bool:
        """True while this host moves no winch."""
        return not self._life.live or self.commander.at_rest

    def connect(self) -> None:
        """Connect the driver behind; home and enable at once where the settings say so.

        Raises:
            IllegalTransition: It is connected.
            CarosacError: Error of the driver behind, or why it cannot be enabled.
        """
        with self._lock:
            self._life.allow("connect")
            self._start_over()
            self.monitor.checks.prepare()
            self.inner.connect()
            self.monitor.restart_checks()  # the driver now knows how patient it must be
            self._life.go(DriveState.CONNECTED)
            try:
                self._prepare()
            except BaseException:
                self.close()
                raise
            if self.real_time:
                self.watchdog = Watchdog(
                    self.settings.period, lambda: self.cycles.waited, self._miss, self._miss_failed
                )
                self.watchdog.start()

    def _prepare(self) -> None:
        """Measure; clear, set down, home, enable or rehearse as the settings say."""
        settings, inner, start = self.settings, self.inner, self.homing.start()
        set_down = settings.motion and isinstance(inner, SupportsSetDown) and inner.sets_down
        if settings.motion and (settings.reset_at_once or set_down):
            self.cleared = reset_held_fault(inner, self.monitor.event)
        if set_down and isinstance(inner, SupportsSetDown):
            x, y, z = start.position[0]
            inner.set_down((float(x), float(y), float(z)))
        moves = settings.enable_at_once and settings.motion
        if moves:
            check_no_fault_held(inner)
        self.measure()
        if moves:
            placed = settings.home_confirmed or set_down  # who sets it down knows where it is
            self.home(start, anew=settings.home_anew or set_down, confirmed=placed)
            self.monitor.checks.first_way &= not set_down
            self.enable()
        elif settings.rehearse and not settings.motion:
            self.home(start, anew=settings.home_anew, confirmed=True)  # nothing moves
            self._ready_to_enable()

    def home(self, position: State, *, anew: bool = False, confirmed: bool = False) -> None:
        """Find the offset of each cable; the platform stands still at this pose.

        Args:
            position: A batch of one. Its lengths count if it has some; else those of the statics:
                with six cables or more at its rotation, with fewer at that of rest.
            anew: Whether offsets may change by more than `GuardSettings.home_change_max`, such as
                where they were never found before; only for a pose that was measured. Load cells,
                IMU and pose measurement must then fit it.
            confirmed: Whether a person vouches for such a pose, which is needed where those would
                not notice an error of `GuardSettings.workspace_margin`.

        Raises:
            IllegalTransition: Not connected, or enabled.
            NotReady: The lengths change, there is a fault, an offset would change by too much,
                the senses contradict the pose, or nobody has confirmed it.
            InvalidField: No pose of rest.
        """
        with self._lock:
            self._life.allow("home")
            self.homing.home(position, anew=anew, confirmed=confirmed)

    def enable(self) -> None:
        """Let commands through, from where the winches stand.

        Raises:
            IllegalTransition: Not homed.
            NotReady: The settings forbid motion, the lengths change, or a check finds something.
            InvalidField: The winches stand outside their limits.
            CarosacError: Error of the driver behind.
        """
        with self._lock:
            self._life.allow("enable")
            if not self.settings.motion:
                raise NotReady("enable: this guard is read only; set motion=True on purpose")
            standing = self._ready_to_enable()
            if isinstance(self.inner, SupportsEnable):
                self.inner.enable()
            self.monitor.checks.standing(standing)
            self.cycles.warm_up()
            self._life.live, self._life.ended = True, False
            self._life.go(DriveState.ENABLED)

    def _ready_to_enable(self) -> Array:
        """Return where the winches stand [m], shape (n,), once nothing forbids enabling."""
        standing, finding = self.homing.standing_still(), self.monitor.finding
        if finding is not None:
            raise NotReady(f"enable: {finding.fault}: {finding.text}")
        self.commander.start(standing)
        return standing

    def disable(self) -> None:
        """Come to rest along the path and let no command through; `enable` may follow."""
        with self._lock:
            self._life.allow("disable")
            self.brake.run_down()

    def reset_fault(self) -> None:
        """Clear the latched fault, once its cause is gone and the winches are at rest.

        Raises:
            IllegalTransition: There is no fault.
            NotReady: The cause is still there; the fault stays.
            CarosacError: Error of the driver behind; the fault stays.
        """
        with self._lock:
            self._life.allow("reset_fault")
            self.brake.run_down()
            if isinstance(self.inner, SupportsFaultReset):
                self.inner.reset_fault()
            self.measure()  # a length that jumped since the last one costs the homing
            latched, self._life.fault = self._life.fault, None
            self.monitor.restart_checks()
            try:
                self.homing.standing_still()
                finding = self.monitor.finding
                if finding is not None:
                    raise NotReady(f"{finding.fault}: {finding.text}")
            except CarosacError as error:
                self._life.fault = latched
                self.monitor.quietly(self.brake.switch_off)
                raise NotReady(f"reset_fault: {error}; the fault stays") from error
            self._life.release()

    def measure(self) -> Measurement:
        """Return what the driver behind measures, with the offsets of homing; checked.

        Raises:
            InvalidField: An impossible measurement, such as a length that is not a number; that is
                latched.
            CarosacError: It cannot measure; that is latched as a lost connection.
        """
        with self._lock:
            self._check_connected()
            return self.monitor.measure()

    def truth(self) -> State | None:
        """Return the truth, where the driver behind knows it, or None."""
        with self._lock:
            return self.inner.truth() if isinstance(self.inner, TruthSource) else None

    def believe(self, belief: Belief) -> None:
        """Latch a belief that is far from what the lengths say."""
        with self._lock:
            self.monitor.note(self.journal.believed, belief)
            finding = self.monitor.checks.belief(belief) if self._life.homed else None
            if finding is not None:
                self.monitor.latch(finding)

    def fail(self, part: str, error: BaseException) -> None:
        """Latch an error of the estimator, the controller or, while the winches follow, all else.

        Where a fault is latched already, that is the cause. An operator who interrupts the program
        is none.
        """
        if part == "program" and not self._life.live:
            return
        if isinstance(error, KeyboardInterrupt) and interrupted_by_operator(self.ending):
            return
        with self._lock:
            self.monitor.latch(plugin_finding(part, error))

    def command(self, command: Command) -> Command:
        """Check, limit and send a command.

        Returns:
            Command that was really sent, with every limit hit: ``not_enabled`` where nothing was,
            ``warm_up`` in the first cycles, ``stop`` or the name of the fault where the winches
            brake instead.

        Raises:
            InvalidField: Another shape.
            CarosacError: This cycle has its command already.
        """
        with self._lock:
            self._check_connected()
            check_shape(command.unstrained_length, self._robot.n)
            newest = self.monitor.measured
            actual = (newest if newest is not None else self.measure()).unstrained_length
            if self._life.state in DRIVEN_STATES:
                first = self._life.state is DriveState.ENABLED
                standing = self.commander.motion.length if first else actual
                finding = self.monitor.checks.command(command, standing[0], first=first)
                if finding is not None:
                    self.monitor.latch(finding)
                elif not self.cycles.warming:
                    return self._follow(command, actual)
            if self._life.live:
                return self.brake.send(command)
            return self._dry_run(command, np.asarray(actual))

    def _follow(self, command: Command, actual: Array) -> Command:
        """Limit and send."""
        if self.monitor.sent:
            raise CarosacError(f"{self.name}: one command a cycle; call wait() before the next")
        self._life.go(DriveState.FOLLOWING)
        return self.commander.follow(command, actual)

    def _dry_run(self, command: Command, held: Array) -> Command:
        """Limit and journal a command; return that the winches hold."""
        limited = command
        if self.fault is None and not self._life.ended:
            first = not self.commander.dry
            finding = self.monitor.checks.command(command, held[0], first=first)
            try:
                if finding is not None:
                    raise InvalidField(str(finding.fault), finding.text, "what `enable` allows")
                limited = self.commander.would_send(command, held)
                self.monitor.note(self.journal.sent, command, limited, really=False)
            except InvalidField as error:
                self.refused[error.field] = self.refused.get(error.field, 0) + 1
                self.monitor.event("would_be_refused", f"{error.field}: {error.value}")
        hits = (*limited.limited, *changed("not_enabled", command, held))
        return Command(time=command.time, unstrained_length=held, limited=hits)

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
            if self._life.live and not self.monitor.sent:
                self.brake.send(None)
            finding = self.cycles.end_cycle()
            if finding is not None and self._life.live:
                self.monitor.latch(finding)
            alive = self.monitor.pass_period()
            self.cycles.begin()
            over = self._life.ended or self.ending is not None or self.fault is not None
            return alive and not over

    def end(self, reason: str) -> None:
        """Have `wait` return False, so that the loop stops; safe in a signal handler.

        The first reason is the one that counts.
        """
        self.ending = self.ending or reason

    def stop(self, reason: str) -> None:
        """Bring all cables to rest along their path, wait for it, and disable; ends the run."""
        with self._lock:
            if self._life.state is DriveState.DISCONNECTED:
                return
            self.brake.begin()
            if not self._life.ended:
                self.monitor.event("stop", self.ending or reason)
            self.brake.run_down()
            self._life.ended = True
            self.monitor.quietly(self.inner.stop, reason)

    def close(self) -> None:
        """Come to rest and let go."""
        watchdog = self.watchdog
        try:
            with self._lock:
                self.watchdog = None
                try:
                    self.brake.run_down()
                finally:
                    if self._life.state is not DriveState.DISCONNECTED:
                        self.monitor.quietly(self.inner.close)
                        self._life.go(DriveState.DISCONNECTED)
        finally:
            if watchdog is not None:
                watchdog.end()
            self.end_recording()

    def end_recording(self) -> None:
        """Give the journal some seconds for its last rows; nothing is recorded afterwards."""
        self.unrecorded = self.monitor.rows.end()

    def _check_connected(self) -> None:
        """Refuse to work before `connect` and after `close`."""
        if self._life.state is DriveState.DISCONNECTED:
            raise CarosacError(f"{self.name}: not connected; call connect() first")

    def _miss(self) -> None:
        """Let the watchdog brake; tell `on_hang` of a controller that hangs."""
        with self._lock:
            hung = self.on_hang if self.brake.miss() else None
        if hung is not None:
            hung()

    def _miss_failed(self, error: Exception) -> None:
        """Have the driver behind stop by itself, as the watchdog could not brake."""
        with self._lock:
            self.monitor.quietly(self.inner.stop, "the watchdog failed")
            self.monitor.quietly(self.monitor.latch, error_finding(error))
