"""Which steps of the lifecycle are legal where, and what a latched fault says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.loop.drive_state import DriveState, Fault

ALLOWED: dict[str, tuple[DriveState, ...]] = {
    "connect": (DriveState.DISCONNECTED,),
    "home": (DriveState.CONNECTED, DriveState.HOMED),
    "enable": (DriveState.HOMED,),
    "disable": (DriveState.HOMED, DriveState.ENABLED, DriveState.FOLLOWING, DriveState.STOPPING),
    "reset_fault": (DriveState.FAULT, DriveState.ESTOP),
}
UNHOMED = (Fault.ENCODER_JUMP, Fault.LOST_CONNECTION, Fault.CLOSURE)  # lengths are not known after


class IllegalTransition(CarosacError):
    """A step of the lifecycle that is not allowed where the drive system stands.

    Attributes:
        state: Where it stands.
        asked: The step that was asked for.
        allowed: Where that step is allowed.
    """

    def __init__(self, state: DriveState, asked: str, why: str = "") -> None:
        places = " or ".join(ALLOWED[asked])
        super().__init__(f"{asked}: the drive system is {state}{why}; allowed: when {places}")
        self.state, self.asked, self.allowed = state, asked, ALLOWED[asked]


class NotReady(CarosacError):
    """A legal step that the robot itself forbids now, such as one that needs it at rest."""


@dataclass(frozen=True, kw_only=True)
class FaultReport:
    """A latched fault.

    Attributes:
        fault: Its name.
        text: What was found.
        cable: Name of the cable, or None.
        time: When, by the driver's clock [s].
    """

    fault: Fault
    text: str
    cable: str | None
    time: float

    def __str__(self) -> str:
        """Name, place, what was found, what it means and what to do."""
        where = "" if self.cable is None else f" (cable '{self.cable}')"
        told = f"{self.fault}{where} at {self.time:.3f} s: {self.text}."
        return f"{told} {self.fault.meaning} {self.fault.remedy}"


class Lifecycle:
    """Where a drive system stands, and the fault that holds it there.

    Attributes:
        state: Where it stands.
        fault: What was latched first, or None.
        homed: Whether lengths belong to poses.
    """

    def __init__(self, tell: Callable[[str, str], None]) -> None:
        """Start disconnected; `tell` hears name and text of every change."""
        self.state = DriveState.DISCONNECTED
        self.fault: FaultReport | None = None
        self.homed = False
        self._tell = tell

    def go(self, state: DriveState, text: str = "") -> None:
        """Change the state."""
        if state in (DriveState.DISCONNECTED, DriveState.CONNECTED, DriveState.HOMED):
            self.homed = state is DriveState.HOMED
        if state is not self.state:
            self.state = state
            self._tell(str(state), text)

    def allow(self, step: str) -> None:
        """Refuse a step that is not legal here.

        Raises:
            IllegalTransition: It is not.
        """
        if self.state not in ALLOWED[step]:
            why = f" ({self.fault.fault})" if self.fault is not None else ""
            raise IllegalTransition(self.state, step, why)

    def latch(self, report: FaultReport) -> None:
        """Keep a fault, unless there is one or nothing is connected; each may cost the homing."""
        if self.state is DriveState.DISCONNECTED:
            return
        self.homed = self.homed and report.fault not in UNHOMED
        if self.fault is not None:
            return
        self.fault = report
        if self.state is DriveState.FAULT:
            self._tell(str(DriveState.FAULT), str(report))
        self.go(DriveState.FAULT, str(report))

    def release(self) -> None:
        """Go where the latched fault has left the lengths."""
        self.fault = None
        self.go(DriveState.HOMED if self.homed else DriveState.CONNECTED)
