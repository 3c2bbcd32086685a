"""States and faults of a robot that moves: the words that driver, guard and PLC share.

The PLC sends their numbers: a state or a fault is the place of its name in its list, from 0.
"""

from __future__ import annotations

from enum import StrEnum


class DriveState(StrEnum):
    """State of the drive system; only `FOLLOWING` moves on command."""

    DISCONNECTED = "disconnected"  # nothing is known
    CONNECTED = "connected"  # measures; no length is known to belong to a pose
    HOMED = "homed"  # the offset of each cable is known; nothing moves
    ENABLED = "enabled"  # the drives hold; the first command may come
    FOLLOWING = "following"  # the winches follow commands
    STOPPING = "stopping"  # a ramp to rest
    FAULT = "fault"  # latched: at rest or on a ramp to it, until reset
    ESTOP = "estop"  # the hard-wired circuit is open; status only

    @property
    def number(self) -> int:
        """Number that the PLC sends."""
        return list(DriveState).index(self)

    @property
    def moves(self) -> bool:
        """True if the winches may turn."""
        return self in (DriveState.FOLLOWING, DriveState.STOPPING)


class Fault(StrEnum):
    """Reason why the winches were stopped."""

    NONE = "none"
    DRIVE_TRIP = "drive_trip"
    ENCODER_JUMP = "encoder_jump"
    STALE_DATA = "stale_data"
    FOLLOWING_ERROR = "following_error"
    CLOSURE = "closure"
    TENSION = "tension"
    HEARTBEAT_LOST = "heartbeat_lost"
    LOST_CONNECTION = "lost_connection"
    CONTROLLER = "controller"
    ESTIMATOR = "estimator"
    COMMAND = "command"
    OVERRUN = "overrun"
    OVER_LIMIT = "over_limit"
    OWNER = "owner"
    UNKNOWN = "unknown"
    WORKSPACE = "workspace"  # what only hosts see stands last: numbers of a PLC program stay
    RECORDING = "recording"

    @property
    def number(self) -> int:
        """Number that the PLC sends."""
        return list(Fault).index(self)

    @property
    def meaning(self) -> str:
        """Cause, in one sentence."""
        return _FAULT_TEXTS[self][0]

    @property
    def remedy(self) -> str:
        """Remedy, in one sentence."""
        return _FAULT_TEXTS[self][1]


def state_of(number: int) -> DriveState:
    """Return the state for a number of the PLC; `FAULT` for a number that has no name."""
    states = list(DriveState)
    return states[number] if 0 <= number < len(states) else DriveState.FAULT


def fault_of(number: int) -> Fault:
    """Return the fault for a number of the PLC; `UNKNOWN` for a number that has no name."""
    faults = list(Fault)
    return faults[number] if 0 <= number < len(faults) else Fault.UNKNOWN


_FAULT_TEXTS: dict[Fault, tuple[str, str]] = {
    Fault.NONE: ("No fault.", "Nothing to do."),
    Fault.DRIVE_TRIP: (
        "The drive of a winch switched itself off.",
        "Read the drive's own error, remove its cause, then reset.",
    ),
    Fault.ENCODER_JUMP: (
        "A length changed faster than its winch can turn.",
        "Check the encoder and its cable, home again, then reset.",
    ),
    Fault.STALE_DATA: (
        "The measurements no longer advance.",
        "Check that the PLC program runs and the network answers, then reset.",
    ),
    Fault.FOLLOWING_ERROR: (
        "A winch does not follow its command.",
        "Look for a blocked drum, an overload or a wrong sign or scale, then reset.",
    ),
    Fault.CLOSURE: (
        "The lengths do not belong to one pose of the platform.",
        "Look for a slipped encoder or a cable off its pulley, home again, then reset.",
    ),
    Fault.TENSION: (
        "A cable tension is outside its limits.",
        "Free or unload the platform, check payload and limits, then reset.",
    ),
    Fault.HEARTBEAT_LOST: (
        "The PLC heard no heartbeat or no command in time and ramped the winches to rest.",
        "Check that the host program runs and the network answers, then reset.",
    ),
    Fault.LOST_CONNECTION: (
        "The PLC no longer answers.",
        "Check cable, address and PLC, wait until it answers, then reset.",
    ),
    Fault.CONTROLLER: (
        "The controller raised an error or gave no command in time.",
        "Read the error, repair the controller, then reset.",
    ),
    Fault.ESTIMATOR: (
        "The estimator raised an error or its belief is impossible.",
        "Read the error, check home pose and calibration, then reset.",
    ),
    Fault.COMMAND: (
        "A command was not a number or far outside the limits; it was not sent.",
        "Repair the controller, then reset.",
    ),
    Fault.OVERRUN: (
        "The control cycle missed its time too often.",
        "Lower the rate or the load of the host, then reset.",
    ),
    Fault.OVER_LIMIT: (
        "A command exceeded the limits of the PLC, which ramped to rest.",
        "Make the limits of the robot file no wider than those of the PLC, then reset.",
    ),
    Fault.OWNER: (
        "The PLC obeys another host.",
        "Close the other host, then connect again.",
    ),
    Fault.UNKNOWN: (
        "An unknown fault.",
        "Look its number up in the PLC program, if it came from there, then reset.",
    ),
    Fault.WORKSPACE: (
        "The platform is outside its workspace box.",
        "Bring it back with the panel of the PLC, check path and home pose, then reset.",
    ),
    Fault.RECORDING: (
        "The run could no longer be recorded.",
        "Free the disk or record on a local one, then reset.",
    ),
}
