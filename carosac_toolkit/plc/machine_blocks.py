"""Structures that only the emulated PLC has: injected faults, its counters, and the truth."""

from __future__ import annotations

from enum import IntEnum

from carosac_toolkit.drivers.ads_block import Block, Field

CONTROL = "Emulator.control"
DIAGNOSIS = "Emulator.diagnosis"
TRUTH = "Emulator.truth"


class Injection(IntEnum):
    """What can be done to the emulated machine; a value of 0 takes a lasting one away."""

    NONE = 0
    TRIP = 1  # drive of `axis`, from 1
    JUMP = 2  # encoder of `axis`, by `value` [m]
    FREEZE_COUNTER = 3
    FREEZE_DATA = 4
    NETWORK = 5  # answers come `value` later and up to `second` more [s]
    ESTOP = 6
    PLACE = 7  # set the platform down at rest at `position`; drives off
    CLEAR = 8  # all but JUMP and PLACE


def control() -> Block:
    """What a client asks of the emulator."""
    return Block("ST_EmulatorControl", "written to inject a fault", (
        Field("number", "UDINT", "one more at each request"),
        Field("kind", "UDINT", "what to do"),
        Field("axis", "UDINT", "cable, from 1"),
        Field("spare", "UDINT", "0"),
        Field("value", "LREAL", "how much"),
        Field("second", "LREAL", "how much more"),
        Field("position", "LREAL", "platform origin in W [m]", 3),
    ))  # fmt: skip


COUNTS = (
    "cycles", "overruns", "commands", "lost", "not_finite", "over_length", "over_speed",
    "over_acceleration", "over_jerk", "jumps", "ignored", "foreign", "torn", "watchdog",
    "beyond_ends",
)  # fmt: skip


def diagnosis(n: int) -> Block:
    """What the PLC counted."""
    return Block("ST_Diagnosis", "counters of the PLC", (
        Field("control_done", "ULINT", "number of the newest request carried out"),
        Field("control_refused", "ULINT", "number of the newest request refused"),
        *(Field(name, "ULINT", "count") for name in COUNTS),
        Field("lost_time", "LREAL", "time for which the PLC did not run [s]"),
        *(Field(f"worst_{x}", "LREAL", "largest share of the limit commanded")
          for x in ("speed", "acceleration", "jerk")),
        Field("set_speed", "LREAL", "set velocity now [unit/s]", n),
        Field("speed_peak", "LREAL", "largest set velocity [unit/s]", n),
        Field("acceleration_peak", "LREAL", "largest set acceleration [unit/s^2]", n),
    ))  # fmt: skip


def truth(n: int) -> Block:
    """The state of the simulated robot; for scoring only."""
    return Block("ST_Truth", "state of the simulated robot", (
        Field("time", "LREAL", "clock of the PLC [s]"),
        Field("position", "LREAL", "platform origin in W [m]", 3),
        Field("rotation", "LREAL", "from P to W, by rows", 9),
        Field("twist", "LREAL", "in W at the platform origin [m/s, rad/s]", 6),
        Field("length", "LREAL", "unstrained lengths [m]", n),
        Field("tension", "LREAL", "at the platform [N]", n),
    ))  # fmt: skip
