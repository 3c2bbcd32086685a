"""Consistency of several fields of a robot file: references, limits, geometry, provenance.

Every check works on the valid parts, so that one fault does not hide another.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

from carosac_toolkit.base.errors import did_you_mean
from carosac_toolkit.base.units import is_quantity
from carosac_toolkit.base.yaml import FieldPath, format_path, walk

if TYPE_CHECKING:
    from carosac_toolkit.robot.schema import RobotFile

Fault = tuple[FieldPath, str]

_REFERENCED_SECTIONS: dict[str, FieldPath] = {
    "exit_point": ("frame", "exit_points"),
    "anchor_point": ("platform", "anchor_points"),
    "cable": ("cable_types",),
    "winch": ("winches",),
}
_PHYSICAL_SECTIONS = (
    "gravity", "frame", "platform", "cable_types", "winches", "chains", "tension_limits",
    "workspace", "home", "sensors", "calibration", "model_error",
)  # fmt: skip


CHAINS_MIN = 2
ONE_CABLE = (
    "under a single cable a platform hangs below the exit point only, and turns freely about the "
    "cable"
)


def cross_faults(data: dict[str, Any], parts: Any) -> list[Fault]:
    """Find the faults that concern several fields.

    Args:
        data: The file as plain data.
        parts: Its sections by attribute, each checked by itself, None where one has faults.
    """
    return [
        *_chain_faults(data),
        *_limit_faults(data, parts),
        *_all_or_none(parts),
        *_home_faults(data, parts),
        *_sensor_faults(parts),
        *_provenance_faults(data),
    ]


def unused_parts(file: RobotFile) -> list[str]:
    """Name the points, cable types and winches that no chain uses: often a forgotten chain."""
    parts: dict[str, Any] = {
        "exit_point": file.frame.exit_points,
        "anchor_point": file.platform.anchor_points,
        "cable": file.cable_types,
        "winch": file.winches,
    }
    unused = []
    for key, known in parts.items():
        used = {getattr(chain, key) for chain in file.chains}
        unused += [
            format_path((*_REFERENCED_SECTIONS[key], name)) for name in known if name not in used
        ]
    return unused


def _chain_faults(data: dict[str, Any]) -> Iterator[Fault]:
    """Find references to parts that do not exist, and duplicate cables."""
    chains = data.get("chains")
    if not isinstance(chains, list):
        return
    if len(chains) < CHAINS_MIN:
        count = "an empty list" if not chains else "one chain"
        yield ("chains",), f"got {count}; allowed: at least two: {ONE_CABLE}"
    names: dict[object, int] = {}
    ends: dict[tuple[object, object], int] = {}
    for i, chain in enumerate(chains):
        if not isinstance(chain, dict):
            continue
        for key, where in _REFERENCED_SECTIONS.items():
            yield from _reference(data, ("chains", i, key), chain.get(key), where)
        name = chain.get("name")
        if isinstance(name, str) and names.setdefault(name, i) != i:
            path: FieldPath = ("chains", i, "name")
            yield path, f"got {name!r}; allowed: a unique name; chains[{names[name]}] has it"
        pair = (chain.get("exit_point"), chain.get("anchor_point"))
        if all(isinstance(end, str) for end in pair) and ends.setdefault(pair, i) != i:
            yield (
                ("chains", i),
                f"got exit point {pair[0]!r} and anchor point {pair[1]!r}; allowed: another pair; "
                f"chains[{ends[pair]}] already joins these two",
            )


def _reference(
    data: dict[str, Any], path: FieldPath, name: object, where: FieldPath
) -> list[Fault]:
    """Check one reference of a chain."""
    target: Any = data
    for part in where:
        target = target.get(part) if isinstance(target, dict) else None
    if not isinstance(target, dict) or not isinstance(name, str | float) or isinstance(name, bool):
        return []
    word = f"{name:g}" if isinstance(name, float) else name.strip()
    if word in target or not word:
        return []
    known = list(target)
    allowed = f"a name in {format_path(where)}: {', '.join(known)}"
    return [(path, f"got {word!r}; allowed: {allowed}{did_you_mean(word, known)}")]


def _limit_faults(data: dict[str, Any], parts: Any) -> Iterator[Fault]:
    """Find chains without tension limits."""
    if parts.chains is None or data.get("tension_limits") is not None:
        return
    for i, chain in enumerate(parts.chains):
        if chain.tension_limits is None:
            allowed = "min and max here, or in tension_limits of the file"
            yield ("chains", i, "tension_limits"), f"missing; allowed: {allowed}"


def _all_or_none(parts: Any) -> Iterator[Fault]:
    """Find fields that some cables have and others lack."""
    if parts.frame is not None:
        points = parts.frame.exit_points
        known = [p.sigma is not None or p.covariance is not None for p in points.values()]
        for name, has in zip(points, known, strict=True):
            if any(known) and not has:
                yield (
                    ("frame", "exit_points", name),
                    "sigma missing; allowed: sigma or covariance at all exit points or at none",
                )
    if parts.winches is not None:
        for name, winch in parts.winches.items():
            if winch.drum is None and any(w.drum is not None for w in parts.winches.values()):
                yield ("winches", name), "drum missing; allowed: a drum in all winches or in none"
            if winch.drum is not None and winch.drum.gear is None and _any_gear(parts.winches):
                allowed = "a gear in all drums or in none"
                yield ("winches", name, "drum"), f"gear missing; allowed: {allowed}"
            if winch.drum is not None and winch.length_max is not None:
                line = (winch.drum.advantage or 1.0) * winch.length_max
                most = winch.drum.radius**2 / line
                if winch.drum.buildup >= most:
                    yield (
                        ("winches", name, "drum", "buildup"),
                        f"got {winch.drum.buildup:g} m; allowed: below radius^2 / (advantage * "
                        f"length_max) = {most:g} m, so that the drum pays out "
                        f"{winch.length_max:g} m",
                    )


def _any_gear(winches: Any) -> bool:
    """Return True if any drum has a gear."""
    return any(w.drum is not None and w.drum.gear is not None for w in winches.values())


def _home_faults(data: dict[str, Any], parts: Any) -> Iterator[Fault]:
    """Find a home pose that the robot cannot have."""
    home, chains = parts.home, data.get("chains")
    if home is None:
        return
    free = home.quaternion_wxyz is None and home.rpy_deg is None
    if isinstance(chains, list) and len(chains) >= 6 and free:
        yield (
            ("home",),
            f"rotation missing; allowed: quaternion_wxyz or rpy_deg, as {len(chains)} cables hold "
            "the orientation",
        )
    if parts.workspace is not None:
        for i, (value, low, high) in enumerate(
            zip(home.position, *parts.workspace.corners, strict=True)
        ):
            if not low <= value <= high:
                allowed = f"inside the workspace box, from {low:g} to {high:g} m"
                yield ("home", "position", i), f"got {value:g} m; allowed: {allowed}"


def _sensor_faults(parts: Any) -> Iterator[Fault]:
    """Find sensors or PLC numbers of unknown cables, or of some cables only."""
    if parts.chains is None:
        return
    chains = [chain.name for chain in parts.chains]
    sensors, hardware = parts.sensors, parts.hardware
    if sensors is not None and sensors.lengths is not None:
        yield from _all_chains(("sensors", "lengths", "cables"), sensors.lengths.cables, chains)
    if hardware is not None:
        yield from _all_chains(("hardware", "cables"), hardware.cables, chains)


def _all_chains(path: FieldPath, known: Iterable[str], chains: list[str]) -> Iterator[Fault]:
    """Find entries that are not one for each chain."""
    for name in known:
        if name not in chains:
            yield (*path, name), f"no such chain; allowed: {', '.join(chains)}"
    for name in chains:
        if name not in known:
            yield path, f"{name} missing; allowed: all chains, {', '.join(chains)}"


def _provenance_faults(data: dict[str, Any]) -> Iterator[Fault]:
    """Find numbers without a source, and sources of nothing."""
    sources = data.get("provenance")
    if not isinstance(sources, dict):
        return
    for name in _PHYSICAL_SECTIONS:
        for path in _uncovered((name,), data.get(name), list(sources)) or ():
            allowed = "an entry in provenance for it, or for the start of its path"
            yield path, f"no provenance; allowed: {allowed}"
    known = [
        format_path(path) for path, _ in walk((), {k: data.get(k) for k in _PHYSICAL_SECTIONS})
    ]
    for source in sources:
        if source not in known:
            allowed = "the path of a field of this file, or the start of one"
            yield (
                ("provenance", source),
                f"no such field; allowed: {allowed}{did_you_mean(source, known)}",
            )


def _uncovered(path: FieldPath, value: Any, sources: list[str]) -> list[FieldPath] | None:
    """Find the numbers below a path that no source covers, as few paths as possible.

    Returns:
        The paths; None where there is no number at all.
    """
    if format_path(path) in sources:
        return []
    if isinstance(value, dict):
        children = [_uncovered((*path, key), entry, sources) for key, entry in value.items()]
    elif isinstance(value, list) and any(isinstance(entry, dict | list) for entry in value):
        children = [_uncovered((*path, i), entry, sources) for i, entry in enumerate(value)]
    else:
        numbers = value if isinstance(value, list) else [value]
        return [path] if any(map(is_quantity, numbers)) else None
    covered = [child for child in children if child is not None]
    if not covered:
        return None
    nothing_covered = not any(format_path(path) == s[: len(format_path(path))] for s in sources)
    return [path] if nothing_covered and all(covered) else [p for child in covered for p in child]
