"""Agreement of PLC and robot file on the machine: the block `ST_Machine` from both sides."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from carosac_toolkit.plc import blocks
from carosac_toolkit.plc.blocks import BLOCK_LAYOUT, MACHINE, MACHINE_HEAD
from carosac_toolkit.plc.link import LinkError, PlcLink
from carosac_toolkit.robot.differences import SAME_VALUE_TOLERANCE
from carosac_toolkit.robot.hardware import Hardware
from carosac_toolkit.robot.identity import SIGNIFICANT_DIGITS, machine_hash
from carosac_toolkit.robot.robot import Robot

NAME_LENGTH_MAX = 31  # of a STRING(31)


def machine_values(robot: Robot) -> dict[str, Any]:
    """Return the members of `blocks.machine` of a robot, lengths in the units of its PLC.

    Lengths are unstrained lengths over the scale, whatever the sign and the offset, which homing
    sets.
    """
    hardware = robot.hardware or Hardware.loopback(robot.n)
    scale = np.array(hardware.scale)
    limits = ("length_min", "length_max", "speed_max", "acceleration_max")
    return {
        "layout": BLOCK_LAYOUT, "cables": robot.n, "hash": machine_hash(robot),
        "mass": robot.mass, "sign": np.array(hardware.sign), "scale": scale,
        **{name: getattr(robot, name) / scale for name in limits},
        "name": np.array([_plain(name).encode()[:NAME_LENGTH_MAX] for name in robot.cable_names]),
    }  # fmt: skip


def read_machine(link: PlcLink, n: int) -> dict[str, Any]:
    """Read the block of the PLC; only its head if that has another layout or number of cables.

    Args:
        link: Connected link.
        n: Number of cables of the robot file.

    Raises:
        LinkError: No answer, or a block of another size than its head says.
        WrongBlock: As `LinkError`, of links that pass other sizes on.
    """
    block = blocks.machine(n)
    try:
        return block.unpack(link.read(MACHINE, block.size))
    except (LinkError, blocks.WrongBlock):
        head = MACHINE_HEAD.unpack(link.read(MACHINE, MACHINE_HEAD.size)[: MACHINE_HEAD.size])
        if (head["layout"], head["cables"]) == (BLOCK_LAYOUT, n):
            raise
        return head


def refusal(plc: Mapping[str, Any], file: Mapping[str, Any]) -> str | None:
    """Say why this host must not command this PLC: every difference, with both values.

    Args:
        plc: What `read_machine` returned.
        file: What `machine_values` returned for the robot file.

    Returns:
        None if both mean the same machine. The hash is named only if it is all that differs.
    """
    found = _differences(plc, file)
    if not found:
        return None
    return (
        f"the PLC is of another robot: {'; '.join(found)}. Use the file of this robot; if it is "
        "right, renew ST_Machine in the PLC: carosac plc ROBOT --print-machine"
    )


def declaration(robot: Robot) -> str:
    """Return the variable `machine` of a PLC program for a robot, in Structured Text."""
    values = machine_values(robot)
    lines = [f"    {f.name} := {_literal(f, values[f.name])}"
             for f in blocks.machine(robot.n).fields]  # fmt: skip
    return "machine : ST_Machine := (\n" + ",\n".join(lines) + ");"


def hash_text(value: int) -> str:
    """Return a hash as Structured Text writes it."""
    return f"16#{value:016X}"


def _differences(plc: Mapping[str, Any], file: Mapping[str, Any]) -> list[str]:
    """Return a text for each member that differs; of each array the first cable."""
    for name in ("layout", "cables"):
        if plc[name] != file[name]:
            return [_both(name, plc[name], file[name])]
    chains, theirs = (_names(side["name"]) for side in (file, plc))
    found = []
    if theirs != chains:
        found.append(_both("chains", ", ".join(theirs), ", ".join(chains)))
    for field in blocks.machine(file["cables"]).fields:
        if field.kind != "LREAL":
            continue
        one, other = np.atleast_1d(plc[field.name]), np.atleast_1d(file[field.name])
        equal = np.isclose(one, other, rtol=SAME_VALUE_TOLERANCE, atol=0.0)
        for i in np.flatnonzero(~equal)[:1]:
            where = f"{field.name} of {chains[i]}" if field.count else field.name
            unit = "".join(field.comment.partition(" [")[1:])
            found.append(_both(where, f"{one[i]:.12g}", f"{other[i]:.12g}{unit}"))
    if not found and plc["hash"] != file["hash"]:
        reason = ": geometry, cables, drums, inertia, drag, tension limits or workspace differ"
        found.append(_both("hash", hash_text(plc["hash"]), hash_text(file["hash"]) + reason))
    return found


def _both(name: str, plc: object, file: object) -> str:
    return f"{name}: the PLC has {plc}, the robot file {file}"


def _names(texts: Any) -> list[str]:
    """Return names from their bytes; what follows the end of a text of the PLC is no part of it."""
    return [_plain(text.split(b"\0")[0].decode("latin-1")) for text in texts]


def _plain(text: str) -> str:
    """Return text in printable ASCII, with a question mark for anything else."""
    return "".join(x if " " <= x <= "~" else "?" for x in text)


def _literal(field: blocks.Field, value: Any) -> str:
    """Return a value as Structured Text writes it."""
    if field.count:
        return f"[{', '.join(_literal(replace(field, count=0), x) for x in value)}]"
    if field.kind == "LREAL":
        rounded = float(f"{value:.{SIGNIFICANT_DIGITS}g}")
        return str(np.format_float_positional(rounded, trim="0"))
    if field.kind.startswith("STRING"):
        return "'" + str(value.decode()).replace("$", "$$").replace("'", "$'") + "'"
    return hash_text(value) if field.name == "hash" else str(value)
