"""Who hears of everything that happens on a guarded driver."""

from __future__ import annotations

from typing import Protocol

from carosac_toolkit.loop.values import Belief, Command, Measurement


class Journal(Protocol):
    """Told of every measurement, command, belief and event, from more than one thread."""

    def measured(self, measurement: Measurement) -> None:
        """What the sensors said, offsets of homing included."""
        ...

    def sent(self, asked: Command | None, sent: Command, *, really: bool) -> None:
        """What was asked, None in a stop, and what was sent, or would have been in a dry run."""
        ...

    def believed(self, belief: Belief) -> None:
        """What the estimator said."""
        ...

    def event(self, time: float, name: str, text: str) -> None:
        """A change of state, a fault, a stop; `time` is the driver's [s]."""
        ...


class Silence:
    """The journal of who wants none."""

    def measured(self, measurement: Measurement) -> None:
        """Nothing."""

    def sent(self, asked: Command | None, sent: Command, *, really: bool) -> None:
        """Nothing."""

    def believed(self, belief: Belief) -> None:
        """Nothing."""

    def event(self, time: float, name: str, text: str) -> None:
        """Nothing."""
