"""The driver `guarded`: lifecycle and safety on top of any other driver, simulated or real.

Without `home` and `enable` a run is dry: commands are checked, limited and journaled, and not sent.
A fault is latched: all cables brake together along the path that they are on (`CoordinatedStop`),
`wait` says False, and nothing moves again before `reset_fault`, `enable`, and, where the fault took
the homing with it, `home`.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from carosac_toolkit.arrays import Array
from carosac_toolkit.coordinated_stop import CoordinatedStop
from carosac_toolkit.drivers.drive_state import DriveState, Fault
from carosac_toolkit.drivers.guard_checks import Checks, Finding
from carosac_toolkit.drivers.guard_inner import build_inner, homing_lengths, inner_finding
from carosac_toolkit.drivers.guard_settings import GuardSettings
from carosac_toolkit.drivers.guard_watch import Watchdog
from carosac_toolkit.drivers.journal import Journal, Silence
from carosac_toolkit.drivers.lifecycle import (
    ALLOWED,
    UNHOMED,
    FaultReport,
    IllegalTransition,
    NotReady,
)
from carosac_toolkit.errors import CarosacError, InvalidField
from carosac_toolkit.limits import Limiter
from carosac_toolkit.protocols import TruthSource
from carosac_toolkit.robot import Robot
from carosac_toolkit.values import Belief, Command, LimitHit, Measurement, State

SETTLE = 4.0  # winch lags after the last command of a stop until the winches count as at rest
GONE = 1.0  # silence of the driver behind that is a fault also where nothing moves [s]
MEMORY = 0.1  # time constant of the mean acceleration that a stop goes on with [s]
LIVE_ONLY = (Fault.TENSION, Fault.FOLLOWING_ERROR)  # no fault of a robot that nobody drives


class GuardedDriver:
    """One guarded robot of n cables; a `carosac_toolkit.protocols.MotionDriver`.

    Every call on the driver behind it holds one lock, as a watchdog brakes where the controller
    does not come back.

    Attributes:
        inner: The driver behind the guard.
        fault: What was latched first, or None.
        journal: Hears of everything; set it before `connect`.
        overruns: Cycles since `connect` whose command took longer than a period, in real time.
        refused: What would have been a fault in a dry run, counted by text.
        ending: Why `end` was called, or None.
        on_hang: Called by the watchdog once it has stopped the winches of a hanging controller.
    """

    Settings: ClassVar[type[GuardSettings]] = GuardSettings
    name: ClassVar[str] = "guarded"

    def __init__(
        self, inner: Any, robot: Robot, settings: GuardSettings, *, real_time: bool
    ) -> None:
        """Guard a driver; `robot` says the limits, `real_time` whether a clock runs."""
        self.inner = inner
        self.settings = settings
        self._robot, self._real_time = robot, real_time
        self._limiter = Limiter(robot, settings.limits, period=settings.period)
        self._lock = threading.RLock()
        self._state = DriveState.DISCONNECTED
        self.journal: Journal = Silence()
        self.on_hang: Callable[[], None] | None = None
        self.fault: FaultReport | None = None
        self._forget()

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

    def _forget(self) -> None:
        """Know nothing of the robot."""
        self._checks = Checks(self._robot, self.settings)
        self._offset = np.zeros(self._robot.n)
        self._bend = np.zeros(self._robot.n)
        self._stop: CoordinatedStop | None = None
        self._measured: Measurement | None = None
        self._watchdog: Watchdog | None = None
        self._live = self._sent = self._ended = self._dry = False
        self._was_homed = self._homed_lost = False
        self._warming, self._gone = 0, 0.0
        self.overruns = 0
        self.ending: str | None = None
        self.refused: dict[str, int] = {}
        self.finding: Finding | None = None
        self.began = time.monotonic()
        self._late: deque[bool] = deque(maxlen=max(10, round(1.0 / self.settings.period)))

    @property
    def state(self) -> DriveState:
        """Where the lifecycle stands."""
        return self._state

    def status(self) -> str:
        """The same in one word."""
        return str(self._state)

    @property
    def moving(self) -> bool:
        """Whether what was last sent moves."""
        return self._live and not self._limiter.stopped

    # --- Lifecycle -------------------------------------------------------------------------------

    def connect(self) -> None:
        """Connect the driver behind; homed and enabled at once where the settings say so.

        Raises:
            IllegalTransition: It is connected.
            CarosacError: What the driver behind says, or why it cannot be enabled.
        """
        with self._lock:
            self._allow("connect")
            self._forget()
            self.fault = None
            self._checks.prepare()
            self.inner.connect()
            self._go(DriveState.CONNECTED)
            self.began = time.monotonic()
            try:
                self.measure()
                if self.settings.enable_at_once and self.settings.motion:
                    self.home(self._start())
                    self.enable()
            except BaseException:
                self.close()
                raise
            if self._real_time:
                self._watchdog = Watchdog(self)
                self._watchdog.start()

    def home(self, position: State) -> None:
        """Find the offset of each cable; the platform stands still at this pose.

        Args:
            position: A batch of one. Its lengths count if it has some; else those of the statics:
                with six cables or more at its rotation, with fewer at that of rest.

        Raises:
            IllegalTransition: Not connected, or enabled.
            NotReady: The lengths change.
            InvalidField: No pose of rest.
        """
        with self._lock:
            self._allow("home")
            lengths = homing_lengths(self._robot, position)
            standing = self._standing_still()
            if hasattr(self.inner, "home"):
                self.inner.home(replace(position, unstrained_length=lengths[None]))
            else:
                self._offset = self._offset + (lengths - standing)
            self._checks = Checks(self._robot, self.settings)
            self._go(DriveState.HOMED)
            said = ", ".join(f"{x:+.4f}" for x in lengths - standing)
            self._event("home", f"readings changed by {said} m")
            self.measure()

    def enable(self) -> None:
        """Let commands through, from where the winches stand.

        Raises:
            IllegalTransition: Not homed.
            NotReady: The settings forbid motion, the lengths change, or a check finds something.
            CarosacError: What the driver behind says.
            InvalidField: The winches stand outside their limits.
        """
        with self._lock:
            self._allow("enable")
            if not self.settings.motion:
                raise NotReady("enable: this guard is read only; set motion=True on purpose")
            standing = self._standing_still()
            if self.finding is not None:
                raise NotReady(f"enable: {self.finding.fault}: {self.finding.text}")
            self._limiter.reset(standing[None])
            if hasattr(self.inner, "enable"):
                self.inner.enable()
            self._bend = np.zeros(self._robot.n)
            self._stop, self._ended, self._dry = None, False, False
            self._checks.standing(standing)
            self._live = True
            self._warming = self.settings.warm_up if self._real_time else 0
            self.began = time.monotonic()
            self._go(DriveState.ENABLED)

    def disable(self) -> None:
        """Come to rest along the path and let no command through; `enable` may follow."""
        with self._lock:
            self._allow("disable")
            self._run_down()

    def reset_fault(self) -> None:
        """Clear the latched fault, once its cause is gone and the winches are at rest.

        Raises:
            IllegalTransition: There is no fault.
            NotReady: The cause is still there; the fault stays.
        """
        with self._lock:
            self._allow("reset_fault")
            self._run_down()
            if hasattr(self.inner, "reset_fault"):
                self.inner.reset_fault()
            latched, self.fault = self.fault, None
            self._checks = Checks(self._robot, self.settings)
            try:
                self._standing_still()
                if self.finding is not None:
                    raise NotReady(f"{self.finding.fault}: {self.finding.text}")
            except CarosacError as error:
                self.fault = latched
                raise NotReady(f"reset_fault: {error}; {latched} stays") from error
            homed = self._homed and (latched is None or latched.fault not in UNHOMED)
            self._go(DriveState.HOMED if homed else DriveState.CONNECTED)

    # --- The cycle -------------------------------------------------------------------------------

    def measure(self) -> Measurement:
        """What the driver behind measures, with the offsets of homing; checked.

        Raises:
            CarosacError: It cannot measure; that is latched as a lost connection.
        """
        with self._lock:
            self._check_connected()
            got = self._call(self.inner.measure)
            if got.unstrained_length.shape != (1, self._robot.n):
                shape = f"shape {got.unstrained_length.shape}"
                raise InvalidField("unstrained_length", shape, f"shape (1, {self._robot.n})")
            measurement: Measurement = got
            if self._offset.any():
                measurement = replace(got, unstrained_length=got.unstrained_length + self._offset)
            self._measured = measurement
            self._note(self.journal.measured, measurement)
            found = inner_finding(self.inner)
            if found is None:
                found = self._checks.measured(measurement, homed=self._homed)
            self.finding = found
            lost = found is not None and found.fault is Fault.LOST_CONNECTION
            self._gone = self._gone + self.settings.period if lost else 0.0
            if found is not None and (self._live or self._counts_at_rest(found)):
                self.latch(found)
            return measurement

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
            shape, wanted = command.unstrained_length.shape, (1, self._robot.n)
            if shape != wanted:
                raise InvalidField("unstrained_length", f"shape {shape}", f"shape {wanted}")
            measurement = self._measured if self._measured is not None else self.measure()
            if self._state in (DriveState.ENABLED, DriveState.FOLLOWING):
                first = self._state is DriveState.ENABLED
                standing = self._limiter.motion.length if first else measurement.unstrained_length
                found = self._checks.command(command, standing[0], first=first)
                if found is not None:
                    self.latch(found)
                elif self._warming == 0:
                    return self._follow(command, measurement)
            if self._live:
                return self._brake(command)
            return self._dry_run(command, measurement)

    def wait(self, duration: float) -> bool:
        """Wait to the next tick; a cycle without a command slows down along the path.

        Returns:
            False at a latched fault, after `stop`, and where the driver behind says so.

        Raises:
            InvalidField: Another duration than the period, for which the limits count.
        """
        with self._lock:
            self._check_connected()
            period = self.settings.period
            if not abs(duration - period) <= 1e-9 * period:
                raise InvalidField("duration", f"{duration} s", f"the guard's period, {period} s")
            if self._live and not self._sent:
                self._brake(None)
            if self._warming > 0:
                self._warming -= 1
            else:
                self._count_late()
            alive = self._pass_period()
            self.began = time.monotonic()
            found = None if alive or self._ended else inner_finding(self.inner)
            if found is not None:
                self.latch(found)
            over = self._ended or self.ending is not None or self._state is DriveState.FAULT
            return alive and not over

    def stop(self, reason: str) -> None:
        """Bring all cables to rest along their path, wait for it, and disable; ends the run."""
        with self._lock:
            if self._state is DriveState.DISCONNECTED:
                return
            if not self._ended:
                self._event("stop", self.ending or reason)
            self._run_down()
            self._ended = True
            self._quietly(self.inner.stop, reason)

    def close(self) -> None:
        """Come to rest and let go."""
        with self._lock:
            watchdog, self._watchdog = self._watchdog, None
            if self._state is not DriveState.DISCONNECTED:
                self._run_down()
                self._quietly(self.inner.close)
                self._go(DriveState.DISCONNECTED)
        if watchdog is not None:
            watchdog.end()

    def end(self, reason: str) -> None:
        """Have `wait` say False, so that the loop stops; safe in a signal handler."""
        self.ending = reason

    def truth(self) -> State | None:
        """The truth, where the driver behind knows it."""
        with self._lock:
            return self.inner.truth() if isinstance(self.inner, TruthSource) else None

    # --- What the loop says of those who command -------------------------------------------------

    def believe(self, belief: Belief) -> None:
        """Latch a belief that is far from what the lengths say."""
        with self._lock:
            self._note(self.journal.believed, belief)
            found = self._checks.belief(belief) if self._homed else None
            if found is not None:
                self.latch(found)

    def fail(self, part: str, error: BaseException) -> None:
        """Latch what the estimator or controller raised."""
        fault = Fault.ESTIMATOR if part == "estimator" else Fault.CONTROLLER
        named = getattr(error, "field", "").partition("[")[0]
        if part == "controller" and named in ("unstrained_length", "length_rate"):
            fault = Fault.COMMAND
        with self._lock:
            text = f"the {part} raised {type(error).__name__}: {error}"
            self.latch(Finding(fault=fault, text=text))

    def latch(self, found: Finding) -> None:
        """Latch a finding as the fault, unless there is one."""
        with self._lock:
            if self._state is DriveState.DISCONNECTED or self.fault is not None:
                return
            cable = None if found.cable is None else self._robot.cable_names[found.cable]
            self.fault = FaultReport(
                fault=found.fault, text=found.text, cable=cable, time=float(self._now()[0])
            )
            if found.fault in UNHOMED:
                self._homed_lost = True
            self._go(DriveState.FAULT, str(self.fault))

    # --- What the watchdog does ------------------------------------------------------------------

    def miss(self, waited: float) -> None:
        """The controller has missed its tick: slow down; stop for good where it takes too long.

        Args:
            waited: Since the guard was last called [s].
        """
        with self._lock:
            if self._state not in (DriveState.ENABLED, DriveState.FOLLOWING):
                return
            settings = self.settings
            following = self._state is DriveState.FOLLOWING
            slowing = following and (self._stop is not None or self.moving)
            if waited > (settings.hang_time if slowing else settings.hang_time_at_rest):
                text = f"the controller gave no command for {waited:.3f} s"
                self.latch(Finding(fault=Fault.CONTROLLER, text=text))
                self._run_down()
                hung = self.on_hang
            else:
                hung = None
                if slowing:
                    self._quietly(self._slow_down)
        if hung is not None:
            hung()

    def _slow_down(self) -> None:
        """One period of a stop that a command may still end."""
        if not self._sent:
            self._brake(None)
        self._pass_period()

    # --- Below ------------------------------------------------------------------------------------

    @property
    def _homed(self) -> bool:
        """Whether lengths belong to poses."""
        return self._was_homed and not self._homed_lost

    def _go(self, state: DriveState, text: str = "") -> None:
        """Change the state."""
        if state in (DriveState.CONNECTED, DriveState.HOMED):
            self._was_homed, self._homed_lost = state is DriveState.HOMED, False
        if state is not self._state or text:
            self._state = state
            self._event(str(state), text)

    def _counts_at_rest(self, found: Finding) -> bool:
        """Whether a finding is a fault where nobody drives the winches."""
        if found.fault is Fault.LOST_CONNECTION:
            return self._gone > GONE
        return found.fault not in LIVE_ONLY

    def _allow(self, step: str) -> None:
        """Refuse a step that is not legal here."""
        if self._state not in ALLOWED[step]:
            why = f" ({self.fault.fault})" if self.fault is not None else ""
            raise IllegalTransition(self._state, step, why)

    def _check_connected(self) -> None:
        """Refuse to work before `connect` and after `close`."""
        if self._state is DriveState.DISCONNECTED:
            raise CarosacError(f"{self.name}: not connected; call connect() first")

    def _start(self) -> State:
        """The pose by which `enable_at_once` homes."""
        robot, point = self._robot, self.settings.start_position
        position = robot.home_position if point is None else np.asarray(point, dtype=float)
        rotation = robot.home_rotation
        return State(
            time=np.zeros(1), position=position.reshape(1, 3), rotation=rotation.reshape(1, 3, 3)
        )

    def _now(self) -> Array:
        """The driver's time [s], shape (1,)."""
        return np.zeros(1) if self._measured is None else np.asarray(self._measured.time)

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

    def _follow(self, command: Command, measurement: Measurement) -> Command:
        """Limit and send."""
        if self._sent:
            raise CarosacError(f"{self.name}: one command a cycle; call wait() before the next")
        self._stop = None
        sent = self._limiter.apply(command, measurement.unstrained_length)
        if self._state is DriveState.ENABLED:
            self._go(DriveState.FOLLOWING)
        return self._send(sent, command)

    def _brake(self, asked: Command | None) -> Command:
        """Send the next command of the stop along the path, unless this cycle has its command."""
        now = self._now() if asked is None else asked.time
        if self._sent:
            return Command(time=now, unstrained_length=self._limiter.motion.length)
        if self._stop is None:
            self._stop = CoordinatedStop(self._limiter, self._bend)
        sent = self._stop.step(np.asarray(now))
        if asked is not None:
            why = "warm_up" if self._warming > 0 else "stop"
            why = why if self.fault is None else str(self.fault.fault)
            sent = replace(sent, limited=(*sent.limited, *_changed(why, asked, sent)))
        return self._send(sent, asked)

    def _send(self, command: Command, asked: Command | None) -> Command:
        """Hand a command to the driver behind."""
        motion = self._limiter.motion
        share = min(1.0, self.settings.period / MEMORY)
        if self._stop is None:
            self._bend = self._bend + share * (motion.acceleration[0] - self._bend)
        offset = self._offset
        shifted = command
        if offset.any():
            shifted = replace(command, unstrained_length=command.unstrained_length - offset)
        self._sent = True
        sent: Command = self._call(self.inner.command, shifted)
        if offset.any():
            sent = replace(sent, unstrained_length=sent.unstrained_length + offset)
        self._checks.sent(motion)
        self._note(self.journal.sent, asked, sent, really=True)
        return sent

    def _dry_run(self, command: Command, measurement: Measurement) -> Command:
        """Limit and journal a command, and say that the winches hold."""
        held = np.asarray(measurement.unstrained_length)
        if self._state is not DriveState.FAULT and not self._ended:
            found = self._checks.command(command, held[0], first=not self._dry)
            if found is not None:
                self.refused[found.text] = self.refused.get(found.text, 0) + 1
                self._event("would_be_fault", f"{found.fault}: {found.text}")
            else:
                command = self._would_send(command, held)
        hits = (*command.limited, *_changed("not_enabled", command, held))
        return Command(time=command.time, unstrained_length=held, limited=hits)

    def _would_send(self, command: Command, held: Array) -> Command:
        """What the limits would leave of a command; from where the winches stand at first."""
        try:
            if not self._dry:
                self._limiter.reset(held)
            self._dry = True
            would = self._limiter.apply(command)
        except InvalidField as error:
            self._event("would_be_refused", str(error))
            return command
        self._note(self.journal.sent, command, would, really=False)
        return would

    def _pass_period(self) -> bool:
        """Let one period pass on the driver behind."""
        self._sent = False
        return bool(self._call(self.inner.wait, self.settings.period))

    def _count_late(self) -> None:
        """Count cycles that took longer than a period; too many within a second are a fault."""
        late = self._real_time and time.monotonic() - self.began > self.settings.period
        self.overruns += late
        self._late.append(late)
        full = len(self._late) == self._late.maxlen
        share = sum(self._late) / len(self._late)
        if self._live and full and share > self.settings.overrun_share:
            text = f"{100 * share:.0f} % of the cycles of the last second came too late"
            self.latch(Finding(fault=Fault.OVERRUN, text=text))

    def _run_down(self) -> None:
        """Brake along the path until the winches are at rest, then disable."""
        if not self._live:
            return
        if self._state is not DriveState.FAULT:
            self._go(DriveState.STOPPING)
        self._quietly(self._brake_to_rest)
        self._live = False
        if hasattr(self.inner, "disable"):
            self._quietly(self.inner.disable)
        self._checks.standing(None)
        if self._state is not DriveState.FAULT:
            self._go(DriveState.HOMED)

    def _brake_to_rest(self) -> None:
        """All cycles of a stop; gives up after `stop_time_max`."""
        period = self.settings.period
        rest = int(np.ceil(SETTLE * self._robot.winch_lag.max() / period))
        for _ in range(int(np.ceil(self.settings.stop_time_max / period))):
            if self._limiter.stopped and self._stop is not None:
                rest -= 1
            if rest < 0:
                self._event("at_rest", "")
                return
            if not self._sent:
                self._brake(None)
            if not self._pass_period():
                found = inner_finding(self.inner)
                if found is not None:
                    self.latch(found)
                self._event("let_go", "the driver behind has stopped by itself")
                return
            self.measure()
        self._event("not_at_rest", f"given up after {self.settings.stop_time_max:g} s")

    def _call(self, method: Callable[..., Any], *arguments: Any) -> Any:
        """Call the driver behind; where it fails the connection counts as lost."""
        try:
            return method(*arguments)
        except InvalidField:
            raise
        except CarosacError as error:
            found = inner_finding(self.inner)
            lost = Finding(fault=Fault.LOST_CONNECTION, text=str(error))
            self.latch(lost if found is None else found)
            raise

    def _quietly(self, method: Callable[..., Any], *arguments: Any) -> None:
        """Call where an error must not keep the rest from happening; it is journaled."""
        try:
            method(*arguments)
        except CarosacError as error:
            self._event("error", str(error))

    def _event(self, name: str, text: str) -> None:
        """Journal an event."""
        self._note(self.journal.event, float(self._now()[0]), name, text)

    def _note(self, method: Callable[..., None], *arguments: Any, **named: Any) -> None:
        """Journal; a journal that cannot write is a fault, and hears no more."""
        try:
            method(*arguments, **named)
        except OSError as error:
            self.journal = Silence()
            text = f"the recording failed: {error.strerror or error}"
            self.latch(Finding(fault=Fault.UNKNOWN, text=text))


def _changed(limit: str, asked: Command, sent: Command | Array) -> list[LimitHit]:
    """A hit for every cable that was not sent what was asked."""
    lengths = sent.unstrained_length if isinstance(sent, Command) else sent
    pairs = zip(asked.unstrained_length[0], lengths[0], strict=True)
    return [
        LimitHit(limit=limit, cable=i, asked=float(a), sent=float(s))
        for i, (a, s) in enumerate(pairs)
        if a != s
    ]
