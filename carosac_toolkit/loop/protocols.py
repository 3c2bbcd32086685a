"""Contracts between the toolkit and everything that plugs into it.

Each plug-in is a class found through an entry-point group (``carosac.controllers``,
``carosac.estimators``, ``carosac.drivers``) or as ``module:Class``, and is made by its classmethod
``build(robot, settings=None, *, seed=0)``, `settings` being its own dataclass ``Settings``.
Drivers get the plant robot, controllers and estimators the nominal one. A staticmethod
``check_settings(settings)``, where a class has one, refuses before a study begins what `build`
would refuse for any robot, such as a file that is not there.

A driver needs the members of `Driver`. What else it can do are capabilities, one small protocol
each: the guard uses those that it finds, and the conformance checks refuse one that does not fit.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

from carosac_toolkit.loop.drive_state import Fault
from carosac_toolkit.loop.values import Belief, Command, Measurement, Reference, State


class Estimator(Protocol):
    """Estimator of the platform state from applied commands and measurements.

    One that takes B robots at once, gives each row what it would have alone, and draws nothing from
    its seed, may say so by a class attribute ``batched = True``; studies then run seeds together.
    """

    def reset(self, measurement: Measurement) -> Belief:
        """Start from a first measurement, without any earlier belief."""

    def update(self, belief: Belief, command: Command, measurement: Measurement) -> Belief:
        """Advance the belief.

        Args:
            belief: The belief after the last measurement.
            command: The command that was really applied since then.
            measurement: The new measurement.

        Returns:
            The new belief.
        """


@runtime_checkable
class SupportsMovingStart(Protocol):
    """An estimator of motion that can start away from rest."""

    def reset_moving(self, measurement: Measurement, first: Belief) -> Belief:
        """Start from a first measurement and the pose and twist at that time."""


class Controller(Protocol):
    """Controller of cable lengths from belief and reference; ``batched`` as for estimators.

    Attributes:
        period: Time between two commands [s].
        horizon: Time ahead of now that the reference must cover [s].
    """

    period: float
    horizon: float

    def reset(self, belief: Belief) -> None:
        """Forget everything; the platform is where the belief says."""

    def command(self, belief: Belief, reference: Reference) -> Command:
        """Decide what the winches are asked for until the next call."""


class Driver(Protocol):
    """A robot to measure and command: simulated, recorded or real. It moves data, no more.

    A driver on which commands change nothing has a class attribute ``replays = True``. One that
    simulates several plants at once has a classmethod ``build_batch(robots, settings, *, seeds)``.
    """

    def connect(self) -> None:
        """Make `measure` and `command` possible."""

    def measure(self) -> Measurement:
        """Return the newest samples of the sensors, by the driver's clock."""

    def command(self, command: Command) -> Command:
        """Send a command; return what was really sent after safety limits."""

    def wait(self, duration: float) -> bool:
        """Wait to the next tick of an absolute schedule; a simulation integrates meanwhile.

        Args:
            duration: Time since the last tick [s].

        Returns:
            False at the end of data or where the driver has stopped.
        """

    def stop(self, reason: str) -> None:
        """Come to a controlled stop; always safe to call, also twice."""

    def close(self) -> None:
        """Let go of everything; always safe to call."""


@runtime_checkable
class NamedPlugin(Protocol):
    """A plug-in, or its class, with a name of its own, for messages."""

    @property
    def name(self) -> str:
        """Name, such as ``ads``."""


@runtime_checkable
class RemarkSource(Protocol):
    """A controller that knows what a reader of its scores has to know, such as that it is idle."""

    @property
    def remark(self) -> str | None:
        """One clause about this robot, such as ``no mode to shape``, or None."""


@runtime_checkable
class FallbackSource(Protocol):
    """A controller that has something to fall back on, and counts how often it does."""

    @property
    def fallbacks(self) -> Mapping[str, int]:
        """Commands since the last reset that were not as computed, by reason."""


@runtime_checkable
class FeedbackSource(Protocol):
    """A controller that knows if it corrects errors, so that errors of the estimate reach it."""

    @property
    def feedback(self) -> bool:
        """False if its commands follow from the reference alone."""


@runtime_checkable
class StatusSource(Protocol):
    """A driver that knows the state of its drive system."""

    def status(self) -> str:
        """Return the state in one word, a value of `DriveState`."""


@runtime_checkable
class FaultSource(Protocol):
    """A driver that names the fault of its drive system."""

    @property
    def fault(self) -> Fault:
        """Fault that stops the drives, or `Fault.NONE`."""


@runtime_checkable
class FaultTextSource(Protocol):
    """A driver that describes its fault."""

    @property
    def fault_text(self) -> str:
        """Description of the fault, for people."""


@runtime_checkable
class LinkWatch(Protocol):
    """A driver that watches the connection to its robot."""

    @property
    def link_fault(self) -> Fault:
        """Fault of the connection itself, or `Fault.NONE`; drives may hold an older one."""


@runtime_checkable
class LinkPatience(Protocol):
    """A driver that waits for its robot for a time of its own."""

    @property
    def lost_after(self) -> float:
        """Silence after which the connection counts as lost [s]."""


@runtime_checkable
class SupportsHoming(Protocol):
    """A driver that keeps the length offsets itself; else the guard does."""

    def home(self, position: State) -> None:
        """Set the length offsets from a known pose."""


@runtime_checkable
class SupportsEnable(Protocol):
    """A driver whose drives have to be switched on."""

    def enable(self) -> None:
        """Let commands through, from where the winches stand."""


@runtime_checkable
class SupportsDisable(Protocol):
    """A driver whose drives can be switched off."""

    def disable(self) -> None:
        """Hold the winches and let no command through."""


@runtime_checkable
class SupportsFaultReset(Protocol):
    """A driver that latches faults."""

    def reset_fault(self) -> None:
        """Clear a latched fault whose cause is gone."""


@runtime_checkable
class SupportsFaultHold(Protocol):
    """A driver that can hold a fault for hosts that connect later."""

    def hold_fault(self, fault: Fault) -> None:
        """Disable, and hold a fault that the host has found, until it is reset."""


@runtime_checkable
class SupportsSetDown(Protocol):
    """A driver whose robot is simulated elsewhere and can be put somewhere, as for each case."""

    @property
    def sets_down(self) -> bool:
        """True if a guard that connects to move it clears its fault and sets its robot down."""

    def set_down(self, position: tuple[float, float, float]) -> None:
        """Put the robot at rest at a position in W [m]."""


class MotionDriver(
    Driver, StatusSource, SupportsHoming, SupportsEnable, SupportsDisable, SupportsFaultReset,
    Protocol,
):  # fmt: skip
    """A driver that can move things, with the whole lifecycle of a drive system."""


@runtime_checkable
class Supervisor(Protocol):
    """A driver that supervises estimator and controller; the loop reports to it."""

    def believe(self, belief: Belief) -> None:
        """Take the newest belief, before the controller sees it."""

    def fail(self, part: str, error: BaseException) -> None:
        """Take an error of the ``"estimator"``, ``"controller"`` or ``"program"`` around them.

        `stop` follows. The program comes last: it repeats the error of one of the two.
        """


def replays(driver: object) -> bool:
    """Return whether commands change nothing, so that tracking does not score the controller."""
    return bool(getattr(driver, "replays", False))


@runtime_checkable
class TruthSource(Protocol):
    """A driver that knows the truth. Only the loop's logger and the scoring call it."""

    def truth(self) -> State | None:
        """Return the state now, or None where it is not known at this instant."""
