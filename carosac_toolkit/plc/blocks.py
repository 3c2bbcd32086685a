"""The memory that host and PLC share: blocks of the same layout on both sides, whatever the wire.

Every 8-byte number starts at a multiple of 8 bytes and every block is a multiple of 8 bytes long,
so that the layout is the same under every ``pack_mode`` of TwinCAT. Little-endian. Lengths, rates
and the period are in the PLC's units of length and in seconds; `Hardware` converts them.

Every PLC has the blocks `FROM_HOST`, `TO_HOST` and `MACHINE`. Only an emulated one has `CONTROL`,
through which faults are injected, `DIAGNOSIS`, its counters, and `TRUTH`, the state of its robot.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np

from carosac_toolkit.base.errors import CarosacError

BLOCK_LAYOUT = 3  # version of the layout; both sides refuse another one
FROM_HOST = "from_host"  # names of the blocks; over ADS the robot file names three symbols
TO_HOST = "to_host"
MACHINE = "machine"
CONTROL = "Emulator.control"
DIAGNOSIS = "Emulator.diagnosis"
TRUTH = "Emulator.truth"


class Request(IntEnum):
    """Request of the host, obeyed once for each new ``request_number``."""

    NONE = 0
    ENABLE = 1  # obey this session from now on; the drives hold
    STOP = 2  # ramp to rest; the drives hold then
    DISABLE = 3  # ramp to rest, switch the drives off, release the session
    RESET = 4  # clear a latched fault whose cause is gone
    HOLD = 5  # as disable, and latch a fault that the host has seen


class Answer(IntEnum):
    """Answer of the PLC to a request."""

    NONE = 0
    DONE = 1
    NOT_OWNER = 2  # it obeys another session
    WRONG_STATE = 3  # not in this state
    CAUSE_REMAINS = 4  # the cause of the fault is still there
    UNKNOWN = 5  # no such request
    ANOTHER_ROBOT = 6  # the host has the file of another robot


class DriveStatus(IntEnum):
    """Status of a single drive."""

    OFF = 0
    HOLDING = 1
    MOVING = 2
    TRIPPED = 3


class WrongBlock(CarosacError):
    """Data of another layout, size or number of cables."""


@dataclass(frozen=True)
class Field:
    """A member of a structure.

    Attributes:
        name: As in the PLC program.
        kind: IEC type, ``UDINT``, ``ULINT``, ``LREAL`` or ``STRING(31)``.
        comment: Meaning and unit, as in the PLC program.
        count: 0 for a single number, else the length of the array.
    """

    name: str
    kind: str
    comment: str
    count: int = 0


_TYPES = {"UDINT": "<u4", "ULINT": "<u8", "LREAL": "<f8", "STRING(31)": "S32"}


@dataclass(frozen=True)
class Block:
    """The layout of one structure.

    Attributes:
        name: Name of the type in the PLC program.
        comment: Meaning, as in the PLC program.
        fields: Members in their order.
    """

    name: str
    comment: str
    fields: tuple[Field, ...]

    @cached_property
    def dtype(self) -> np.dtype[Any]:
        """Layout for numpy, without gaps."""
        parts = [(f.name, _TYPES[f.kind], (f.count,) if f.count else ()) for f in self.fields]
        return np.dtype(parts)

    @property
    def size(self) -> int:
        """Size [bytes]."""
        return self.dtype.itemsize

    def pack(self, values: Mapping[str, Any]) -> bytes:
        """Return the bytes of some values; members not named are 0."""
        record = np.zeros((), self.dtype)
        for name, value in values.items():
            record[name] = value
        return record.tobytes()

    def unpack(self, data: bytes) -> dict[str, Any]:
        """Return numbers and arrays by name.

        Raises:
            WrongBlock: The data have another size.
        """
        if len(data) != self.size:
            raise WrongBlock(f"{self.name}: got {len(data)} bytes; allowed: {self.size}")
        record = np.frombuffer(data, self.dtype)[0]
        return {f.name: np.array(record[f.name]) if f.count else record[f.name].item()
                for f in self.fields}  # fmt: skip

    def structured_text(self) -> str:
        """Return the type as a PLC programmer declares it."""
        width = max(len(f.name) for f in self.fields)
        lines = [f"(* {self.comment} *)", f"TYPE {self.name} :", "STRUCT"]
        for f in self.fields:
            kind = f"ARRAY[1..{f.count}] OF {f.kind}" if f.count else f.kind
            lines.append(f"    {f.name:<{width}} : {kind}; (* {f.comment} *)")
        return "\n".join([*lines, "END_STRUCT", "END_TYPE"])


def from_host(n: int) -> Block:
    """Return the block that the host writes, for n cables."""
    return Block("ST_FromHost", "written by the host once a cycle", (
        Field("layout", "UDINT", f"version of this layout, {BLOCK_LAYOUT}"),
        Field("cables", "UDINT", "number of cables"),
        Field("sequence", "UDINT", "heartbeat: one more at each write"),
        Field("host_number", "UDINT", "public number of the host; owner shows it"),
        Field("request", "UDINT", "0 none, 1 enable, 2 stop, 3 disable, 4 reset, 5 hold a fault"),
        Field("request_number", "UDINT", "one more at each new request"),
        Field("follow", "UDINT", "1: length and rate are to be followed"),
        Field("command", "UDINT", "one more at each new command"),
        Field("session", "ULINT", "secret number that the host drew; the PLC obeys one"),
        Field("machine", "ULINT", "hash of the robot file; the PLC enables only with its own"),
        Field("period", "LREAL", "time between two commands [s]"),
        Field("length", "LREAL", "set position [unit]", n),
        Field("rate", "LREAL", "set velocity [unit/s]", n),
        Field("sequence_end", "UDINT", "as sequence: the data are of one write"),
        Field("fault", "UDINT", "with request 5: number of the fault"),
    ))  # fmt: skip


def to_host(n: int) -> Block:
    """Return the block that the host reads, for n cables."""
    return Block("ST_ToHost", "written by the PLC once a cycle", (
        Field("layout", "UDINT", f"version of this layout, {BLOCK_LAYOUT}"),
        Field("cables", "UDINT", "number of cables"),
        Field("sequence", "UDINT", "heartbeat: one more each PLC cycle"),
        Field("echo", "UDINT", "newest sequence seen from the session it obeys"),
        Field("owner", "UDINT", "host_number of the session that it obeys; 0: nobody"),
        Field("state", "UDINT", "1 off, 3 enabled, 4 following, 5 stopping, 6 fault, 7 estop"),
        Field("fault", "UDINT", "0 none, else the number of the fault"),
        Field("fault_axis", "UDINT", "0 none, else the cable, from 1"),
        Field("answered", "UDINT", "request_number of the newest request answered"),
        Field("answer", "UDINT", "1 done, 2 not owner, 3 wrong state, 4 cause remains, 5 unknown, "
              "6 another robot"),
        Field("command_echo", "UDINT", "newest command followed"),
        Field("has_tension", "UDINT", "1: tension is measured"),
        Field("time", "LREAL", "when length was measured, by the clock of the PLC [s]"),
        Field("length", "LREAL", "position [unit]", n),
        Field("rate", "LREAL", "velocity [unit/s]", n),
        Field("set_length", "LREAL", "set position that the drives hold or follow [unit]", n),
        Field("tension", "LREAL", "at the platform [N]", n),
        Field("drive_status", "ULINT", "0 off, 1 holding, 2 moving, 3 tripped", n),
        Field("sequence_end", "UDINT", "as sequence: the data are of one cycle"),
        Field("boot", "UDINT", "another number at each start of the PLC program"),
    ))  # fmt: skip


MACHINE_HEAD = Block("ST_Machine", "its members that do not depend on the number of cables", (
    Field("layout", "UDINT", f"version of this layout, {BLOCK_LAYOUT}"),
    Field("cables", "UDINT", "number of cables"),
    Field("hash", "ULINT", "of all numbers of the robot file that describe the machine"),
    Field("mass", "LREAL", "platform with payloads [kg]"),
))  # fmt: skip


def machine(n: int) -> Block:
    """Return the block of constants in which PLC and robot file must agree, for n cables."""
    return Block("ST_Machine", "constants of the machine, for one robot file", (
        *MACHINE_HEAD.fields,
        Field("sign", "LREAL", "1: the number grows as cable is paid out, else -1", n),
        Field("scale", "LREAL", "length of the unit [m]", n),
        Field("length_min", "LREAL", "shortest unstrained length [unit]", n),
        Field("length_max", "LREAL", "longest unstrained length [unit]", n),
        Field("speed_max", "LREAL", "speed limit [unit/s]", n),
        Field("acceleration_max", "LREAL", "acceleration limit [unit/s^2]", n),
        Field("name", "STRING(31)", "start of the name of the chain, in ASCII", n),
    ))  # fmt: skip


def whole(block: Block, values: Mapping[str, Any], n: int) -> bool:
    """Return whether unpacked data are of one write.

    Raises:
        WrongBlock: The data have another layout or number of cables.
    """
    for name, allowed in (("layout", BLOCK_LAYOUT), ("cables", n)):
        if values[name] != allowed:
            raise WrongBlock(f"{block.name}.{name}: got {values[name]}; allowed: {allowed}")
    return bool(values["sequence"] == values["sequence_end"])


class Injection(IntEnum):
    """Fault or move of the emulated machine; a value of 0 ends one that lasts."""

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
    """Return the block through which a client injects a fault."""
    return Block("ST_EmulatorControl", "written to inject a fault", (
        Field("number", "UDINT", "one more at each request"),
        Field("kind", "UDINT", "what to do"),
        Field("axis", "UDINT", "cable, from 1"),
        Field("spare", "UDINT", "0"),
        Field("value", "LREAL", "how much"),
        Field("second", "LREAL", "how much more"),
        Field("position", "LREAL", "platform origin in W [m]", 3),
    ))  # fmt: skip


COUNTER_FIELDS = (
    "cycles", "overruns", "commands", "lost", "not_finite", "over_length", "over_speed",
    "over_acceleration", "over_jerk", "jumps", "ignored", "foreign", "torn", "watchdog",
    "beyond_ends",
)  # fmt: skip


def diagnosis(n: int) -> Block:
    """Return the block of what the PLC counted, for n cables."""
    return Block("ST_Diagnosis", "counters of the PLC", (
        Field("control_done", "ULINT", "number of the newest request carried out"),
        Field("control_refused", "ULINT", "number of the newest request refused"),
        *(Field(name, "ULINT", "count") for name in COUNTER_FIELDS),
        Field("lost_time", "LREAL", "time for which the PLC did not run [s]"),
        *(Field(f"worst_{x}", "LREAL", "largest share of the limit commanded")
          for x in ("speed", "acceleration", "jerk")),
        Field("set_speed", "LREAL", "set velocity now [unit/s]", n),
        Field("speed_peak", "LREAL", "largest set velocity [unit/s]", n),
        Field("acceleration_peak", "LREAL", "largest set acceleration [unit/s^2]", n),
    ))  # fmt: skip


def truth(n: int) -> Block:
    """Return the block of the robot's true state, for n cables; for scoring only."""
    return Block("ST_Truth", "state of the simulated robot", (
        Field("time", "LREAL", "clock of the PLC [s]"),
        Field("position", "LREAL", "platform origin in W [m]", 3),
        Field("rotation", "LREAL", "from P to W, by rows", 9),
        Field("twist", "LREAL", "in W at the platform origin [m/s, rad/s]", 6),
        Field("length", "LREAL", "unstrained lengths [m]", n),
        Field("tension", "LREAL", "at the platform [N]", n),
    ))  # fmt: skip
