"""Lifecycle of a drive system: legal steps, and the latched fault."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.loop.drive_state import DriveState, Fault

ALLOWED_TRANSITIONS: dict[str, tuple[DriveState, ...]] = {
    "connect": (DriveState.DISCONNECTED,),
    "home": (DriveState.CONNECTED, DriveState.HOMED),
    "enable": (DriveState.HOMED,),
    "disable": (DriveState.HOMED, DriveState.ENABLED, DriveState.FOLLOWING, DriveState.STOPPING),
    "reset_fault": (DriveState.FAULT, DriveState.ESTOP),
}
UNHOMING_FAULTS = (Fault.ENCODER_JUMP, Fault.LOST_CONNECTION, Fault.CLOSURE)  # lengths are lost


class IllegalTransition(CarosacError):
    """A step of the lifecycle that is not allowed in the present state.

    Attributes:
        state: State of the drive system.
        asked: Step that was asked for.
        allowed: States in which that step is allowed.
    """

    def __init__(self, state: DriveState, asked: str, why: str = "") -> None:
        places = " or ".join(ALLOWED_TRANSITIONS[asked])
        super().__init__(f"{asked}: the drive system is {state}{why}; allowed: when {places}")
        self.state, self.asked, self.allowed = state, asked, ALLOWED_TRANSITIONS[asked]


class NotReady(CarosacError):
    """A legal step that the robot itself forbids now, such as one that needs it at rest."""


@dataclass(frozen=True, kw_only=True)
class FaultReport:
    """A latched fault.

    Attributes:
        fault: Its name.
        text: Evidence for it.
        cable: Name of the cable, or None.
        time: Time of it by the driver's clock [s].
    """

    fault: Fault
    text: str
    cable: str | None
    time: float

    def __str__(self) -> str:
        """Return name, place, evidence, meaning and remedy."""
        where = "" if self.cable is None else f" (cable '{self.cable}')"
        evidence = f"{self.fault}{where} at {self.time:.3f} s: {self.text}."
        return f"{evidence} {self.fault.meaning} {self.fault.remedy}"


class Lifecycle:
    """State of a drive system, and the fault that holds it there.

    Attributes:
        state: State now.
        fault: Fault that was latched first, or None.
        homed: Whether lengths belong to poses.
        live: Whether this host drives the winches: from `enable` until a stop is at rest.
        ended: Whether the run was stopped.
    """

    def __init__(self, tell: Callable[[str, str], None]) -> None:
        """Start disconnected; `tell` hears name and text of every change."""
        self.state = DriveState.DISCONNECTED
        self.fault: FaultReport | None = None
        self.homed = self.live = self.ended = False
        self._tell = tell

    def go(self, state: DriveState, text: str = "") -> None:
        """Change the state."""
        if state in (DriveState.DISCONNECTED, DriveState.CONNECTED, DriveState.HOMED):
            self.homed = state is DriveState.HOMED
        if state is not self.state:
            self.state = state
            self._tell(str(state), text)

    def allow(self, step: str) -> None:
        """Refuse a step that is not legal now.

        Raises:
            IllegalTransition: The state does not allow it.
        """
        if self.state not in ALLOWED_TRANSITIONS[step]:
            why = f" ({self.fault.fault})" if self.fault is not None else ""
            raise IllegalTransition(self.state, step, why)

    def latch(self, report: FaultReport) -> None:
        """Keep the first fault, where anything is connected; each fault may cost the homing."""
        if self.state is DriveState.DISCONNECTED:
            return
        self.homed = self.homed and report.fault not in UNHOMING_FAULTS
        if self.fault is not None:
            return
        self.fault = report
        if self.state is DriveState.FAULT:
            self._tell(str(DriveState.FAULT), str(report))
        self.go(DriveState.FAULT, str(report))

    def release(self) -> None:
        """Clear the fault: homed where it left the lengths known, else connected."""
        self.fault = None
        self.go(DriveState.HOMED if self.homed else DriveState.CONNECTED)
