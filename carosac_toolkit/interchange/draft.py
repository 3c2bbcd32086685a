"""Draft of a robot file: known values of another program's files, and their omissions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.schema import ROBOT_SCHEMA

POINT_DISTANCE_MAX_M = (
    300.0  # [m] from the origin; points farther away than this are more likely in mm
)


@dataclass
class Draft:
    """Part of a robot file, with the source of each number.

    Attributes:
        source: Program and files, for people.
        data: In the layout of the robot file, as far as it is known.
        provenance: Source of each number, by path or the start of it.
        dropped: Contents of the files that a robot file cannot hold.
        warnings: Likely mistakes.
    """

    source: str
    data: dict[str, Any] = field(default_factory=lambda: {"schema": ROBOT_SCHEMA})
    provenance: dict[str, str] = field(default_factory=dict)
    dropped: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def put(self, path: Sequence[str], value: object, source: str = "") -> None:
        """Set a value, with its mappings on the way, and where it comes from.

        Args:
            path: Path of the field.
            value: Numbers in SI.
            source: Its provenance; none for a text.
        """
        place = self.data
        for part in path[:-1]:
            place = place.setdefault(part, {})
        place[path[-1]] = value
        if source:
            self.provenance[".".join(path)] = f"{self.source}: {source}"

    def chains(
        self,
        names: Sequence[str],
        exits: Sequence[tuple[Array, float, Array]],
        anchors: Iterable[Array],
        winches: Sequence[str],
        cables: Sequence[str],
    ) -> None:
        """Put exit points, anchor points and the chains that join them, one of each a cable.

        Args:
            names: Names of the cables.
            exits: Position in W [m], pulley radius [m] (0: an eyelet) and direction of travel
                into the pulley in W.
            anchors: Positions in P [m].
            winches: Name of the winch of each cable.
            cables: Name of the cable type of each cable.
        """
        frame = self.data.setdefault("frame", {}).setdefault("exit_points", {})
        platform = self.data.setdefault("platform", {}).setdefault("anchor_points", {})
        chains: list[dict[str, object]] = []
        rows = zip(names, exits, anchors, winches, cables, strict=True)
        for name, (position, radius, axis), anchor, winch, cable in rows:
            frame[name] = {"position": _numbers(position)}
            if radius > 0.0:
                frame[name]["pulley"] = {"radius": radius, "swivel_axis": _numbers(axis)}
            platform[name] = _numbers(anchor)
            ends = {"exit_point": name, "anchor_point": name, "cable": cable, "winch": winch}
            chains.append({"name": name, **ends})
            if max(abs(float(x)) for x in position) > POINT_DISTANCE_MAX_M:
                self.warnings.append(
                    f"exit point {name!r} is over {POINT_DISTANCE_MAX_M:g} m from the origin: "
                    "is the file in mm?"
                )
        self.data["chains"] = chains

    def limits(self, low: Sequence[float | None], high: Sequence[float | None], what: str) -> None:
        """Put tension limits [N]: once if all cables share them, else at each chain.

        Args:
            low: Lower limit of each cable; None if the file has none.
            high: Upper limit of each cable.
            what: Name of the limits in the file.
        """
        pairs = list(zip(low, high, strict=True))
        if len(set(pairs)) == 1:
            limits = _limits(*pairs[0])
            if limits:
                self.data["tension_limits"] = limits
                for name in limits:
                    self.provenance[f"tension_limits.{name}"] = f"{self.source}: {what}"
            return
        for i, pair in enumerate(pairs):
            self.data["chains"][i]["tension_limits"] = _limits(*pair)
            self.provenance[f"chains[{i}].tension_limits"] = f"{self.source}: {what}"


def _limits(low: float | None, high: float | None) -> dict[str, float]:
    return {k: v for k, v in (("min", low), ("max", high)) if v is not None}


def _numbers(values: Array) -> list[float]:
    return [float(value) for value in values]
