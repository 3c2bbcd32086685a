"""Faults and moves injected into an emulated PLC, over any connection that moves its blocks."""

from __future__ import annotations

import time
from typing import Any, Protocol

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.plc import blocks
from carosac_toolkit.plc.blocks import CONTROL, DIAGNOSIS, Injection

INJECTION_TIMEOUT_S = (
    2.0  # a PLC cycle takes 5 ms, but the emulator may have to wait for a busy host
)
POLL_PERIOD_S = 0.002


class BlockAccess(Protocol):
    """Reads and writes whole blocks by name."""

    def read(self, block: str, size: int) -> bytes:
        """Return the bytes of a block."""

    def write(self, block: str, data: bytes) -> None:
        """Replace the bytes of a block."""


def read_diagnosis(plc: BlockAccess, n: int) -> dict[str, Any]:
    """Return the counters of an emulated PLC with n cables."""
    block = blocks.diagnosis(n)
    return block.unpack(plc.read(DIAGNOSIS, block.size))


def inject(
    plc: BlockAccess, n: int, kind: Injection, axis: int = 0, value: float = 1.0,
    second: float = 0.0, position: Any = (0.0, 0.0, 0.0),
) -> None:  # fmt: skip
    """Do something to an emulated machine and wait until it is done.

    Args:
        plc: Connection to the emulated PLC.
        n: Number of cables.
        kind: Kind of fault or move.
        axis: Cable, from 1.
        value: Size, in the unit that `Injection` names.
        second: Second number of `Injection.NETWORK` [s].
        position: Platform origin in W [m].

    Raises:
        CarosacError: The PLC refused, or did not answer.
    """
    number = int(read_diagnosis(plc, n)["control_done"]) + 1
    values = {
        "number": number, "kind": int(kind), "axis": axis, "value": value, "second": second,
        "position": position,
    }  # fmt: skip
    plc.write(CONTROL, blocks.control().pack(values))
    end = time.monotonic() + INJECTION_TIMEOUT_S
    while time.monotonic() < end:
        counters = read_diagnosis(plc, n)
        if counters["control_refused"] == number:
            raise CarosacError(f"plc: refused {kind.name.lower()} of axis {axis}, {value:g}")
        if counters["control_done"] >= number:
            return
        time.sleep(POLL_PERIOD_S)
    raise CarosacError(f"plc: {kind.name.lower()} was not carried out in {INJECTION_TIMEOUT_S:g} s")
