"""Journal of a guarded driver: hears of everything that happens."""

from __future__ import annotations

from typing import Protocol

from carosac_toolkit.loop.values import Belief, Command, Measurement


class Journal(Protocol):
    """A listener to every measurement, command, belief and event, from more than one thread."""

    def measured(self, measurement: Measurement) -> None:
        """Take a measurement, offsets of homing included."""

    def sent(self, asked: Command | None, sent: Command, *, really: bool) -> None:
        """Take what was asked, None in a stop, and what was sent, or would be in a dry run."""

    def believed(self, belief: Belief) -> None:
        """Take a belief of the estimator."""

    def event(self, time: float, name: str, text: str) -> None:
        """Take a change of state, a fault or a stop; `time` is the driver's [s]."""


class NoJournal:
    """A journal that keeps nothing."""

    def measured(self, measurement: Measurement) -> None:
        """Do nothing."""

    def sent(self, asked: Command | None, sent: Command, *, really: bool) -> None:
        """Do nothing."""

    def believed(self, belief: Belief) -> None:
        """Do nothing."""

    def event(self, time: float, name: str, text: str) -> None:
        """Do nothing."""
