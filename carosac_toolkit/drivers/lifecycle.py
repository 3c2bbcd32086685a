"""Which steps of the lifecycle are legal where, and what a latched fault says."""

from __future__ import annotations

from dataclasses import dataclass

from carosac_toolkit.drivers.drive_state import DriveState, Fault
from carosac_toolkit.errors import CarosacError

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
