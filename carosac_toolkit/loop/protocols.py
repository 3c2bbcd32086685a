"""Contracts between the loop and everything that plugs into it.

Each plug-in is a class found through an entry-point group (``carosac.controllers``,
``carosac.estimators``, ``carosac.drivers``) or as ``module:Class``, and is made by its classmethod
``build(robot, settings=None, *, seed=0)``, `settings` being its own dataclass ``Settings``.
Drivers get the plant robot, controllers and estimators the nominal one. A staticmethod
``check_settings(settings)``, where a class has one, refuses before a study begins what `build`
would refuse for any robot, such as a file that is not there.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from carosac_toolkit.loop.values import Belief, Command, Measurement, Reference, State


class Estimator(Protocol):
    """Estimator of the platform state from applied commands and measurements.

    One that takes B robots at once, gives each row what it would have alone, and draws nothing from
    its seed, may say so by a class attribute ``batched = True``; studies then run seeds together.
    """

    def reset(self, measurement: Measurement) -> Belief:
        """Start from a first measurement, without any earlier belief."""
        ...

    def update(self, belief: Belief, command: Command, measurement: Measurement) -> Belief:
        """Advance the belief.

        Args:
            belief: The belief after the last measurement.
            command: The command that was really applied since then.
            measurement: The new measurement.

        Returns:
            The new belief.
        """
        ...


class Controller(Protocol):
    """Controller of cable lengths from belief and reference; ``batched`` as for estimators.

    Attributes:
        period: Time between two commands [s].
        horizon: Time ahead of now that the reference must cover [s].
    """

    period: float
    horizon: float

    def reset(self, belief: Belief) -> None:
        """Forget everything; start from the pose of the belief."""
        ...

    def command(self, belief: Belief, reference: Reference) -> Command:
        """Decide the lengths that the winches are asked for until the next call."""
        ...


class Driver(Protocol):
    """Source of measurements and sink of commands: simulated, recorded or real. It moves data only.

    A driver on which commands change nothing has a class attribute ``replays = True``. One that
    simulates several plants at once has a classmethod ``build_batch(robots, settings, *, seeds)``.
    """

    def connect(self) -> None:
        """Make `measure` and `command` possible."""
        ...

    def measure(self) -> Measurement:
        """Return the current measurement, by the driver's clock."""
        ...

    def command(self, command: Command) -> Command:
        """Send a command; return what was really sent after safety limits."""
        ...

    def wait(self, duration: float) -> bool:
        """Wait to the next tick of an absolute schedule; a simulation integrates meanwhile.

        Args:
            duration: Time since the last tick [s].

        Returns:
            False at the end of data or where the driver has stopped.
        """
        ...

    def stop(self, reason: str) -> None:
        """Come to a controlled stop; always safe to call, also twice."""
        ...

    def close(self) -> None:
        """Release all resources; always safe to call."""
        ...


class MotionDriver(Driver, Protocol):
    """A driver that moves a robot."""

    def home(self, position: State) -> None:
        """Set the length offsets from a known pose."""
        ...

    def enable(self) -> None:
        """Let commands through, from where the winches stand."""
        ...

    def disable(self) -> None:
        """Hold the winches and let no command through."""
        ...

    def reset_fault(self) -> None:
        """Clear a latched fault whose cause is gone."""
        ...

    def status(self) -> str:
        """Return the state of the drive system in one word."""
        ...


@runtime_checkable
class Supervisor(Protocol):
    """A driver that supervises estimator and controller; the loop reports to it."""

    def believe(self, belief: Belief) -> None:
        """Receive the belief of the estimator, before the controller does."""
        ...

    def fail(self, part: str, error: BaseException) -> None:
        """Receive an error raised by the ``"estimator"``, ``"controller"`` or ``"program"``.

        `stop` follows. The program comes last: it repeats the error of one of the two.
        """
        ...


def replays(driver: object) -> bool:
    """Return True if commands change nothing, so that tracking cannot be scored."""
    return bool(getattr(driver, "replays", False))


@runtime_checkable
class TruthSource(Protocol):
    """A driver that knows the truth. Only the loop's logger and the scoring call it."""

    def truth(self) -> State | None:
        """Return the current state, or None if it is not known at this instant."""
        ...
