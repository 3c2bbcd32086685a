"""Robots of WireX (WireCenter, Fraunhofer IPA): ``.wcrfx``, an XML file of versions 0.31 and 0.32.

What the file means, after WireX's own code:

* a chain's ``base`` is the exit point with a frame, whose entries ``a11 a21 a31 a12 ...`` stand
  column by column; its third column is the direction of travel into the pulley of ``radius``,
  about which the pulley swivels;
* ``platform`` of a chain is the anchor point in the platform frame;
* ``cable`` has a modulus ``elasticity`` [Pa] without the area it belongs to, a ``weight`` [kg/m]
  and a ``radius`` [m]; a ``winch`` has limits. A limit of 0 is one that nobody set.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.interchange.draft import Draft
from carosac_toolkit.interchange.source_file import SourceFile

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

_MOTION_PATTERN = "3R3T"
_SUPPORTED_VERSIONS = ("0.31", "0.32")
_ROTATION_ATTRIBUTES = tuple(f"a{row}{column}" for column in "123" for row in "123")
_DEFAULT_MASS, _DEFAULT_CENTRE, _DEFAULT_RADIUS = 25.0, (0.0, 1.0, 0.2), 0.1
_WINCH_FIELDS = {
    "max_velocity": "speed_max",
    "max_acceleration": "acceleration_max",
    "l_min": "length_min",
}


def read_wirex(path: Path, *, pulleys: bool = True) -> Draft:
    """Read a WireX robot.

    Args:
        path: The ``.wcrfx`` file.
        pulleys: False: eyelets at the entry points of pulleys.

    Raises:
        InvalidFile: A file with faults, or no single robot with six degrees of freedom.
    """
    file = SourceFile(path)
    root = file.xml()
    robots = root.findall("robot")
    if root.tag != "models" or len(robots) != 1:
        allowed = "one <robot> in <models>"
        raise file.refuse(f"{len(robots)} robots in <{root.tag}>; allowed: {allowed}")
    robot = robots[0]
    if robot.get("motionpattern") != _MOTION_PATTERN:
        got = repr(robot.get("motionpattern"))
        raise file.refuse(
            f"robot@motionpattern: got {got}; allowed: {_MOTION_PATTERN!r}, a free body"
        )
    version = root.get("version")
    draft = Draft(f"WireX {version or 'of no version'}, {path.name}")
    if version not in _SUPPORTED_VERSIONS:
        draft.warnings.append(f"version {version!r}; known are {' and '.join(_SUPPORTED_VERSIONS)}")
    name = (robot.get("name") or path.stem).strip()
    draft.put(("name",), name)
    draft.put(("description",), f"{name}, imported from WireX")
    _platform(file, robot, draft)
    winches = _winches(file, root, draft)
    _cable(file, root, draft)
    _geometry(file, robot, draft, winches, pulleys)
    _limits(file, root, robot, draft)
    draft.dropped.append("motors, drums, friction, breaking load, damping (of no stated unit)")
    file.check()
    return draft


def _geometry(
    file: SourceFile, robot: Element, draft: Draft, winches: list[str], pulleys: bool
) -> None:
    """Put chains with their ends."""
    chains = robot.findall("geometry/chain")
    if not chains:
        raise file.refuse("no <chain> in <geometry>")
    names, exits, anchors, used = [], [], [], []
    for i, chain in enumerate(chains):
        identity = (chain.get("id") or "").strip()
        name = f"cable_{identity}"
        where = f"chain {identity!r}"
        if not identity or name in names:
            file.fault(f"chain[{i}]@id", repr(identity), "an id of its own for each chain")
            name = f"cable_({i + 1})"
        names.append(name)
        base, end = (file.child(chain, tag, where) for tag in ("base", "platform"))
        exits.append(_exit(file, base, where, pulleys))
        anchors.append(_point(file, end, f"{where}/platform"))
        kind = chain.get("winchtype") or ""
        used.append(kind if kind in winches else winches[0])
    draft.chains(names, exits, anchors, used, ["cable"] * len(names))
    draft.provenance["frame.exit_points"] = f"{draft.source}: base points of the chains"
    draft.provenance["platform.anchor_points"] = f"{draft.source}: platform points of the chains"
    if {radius for _, radius, _ in exits} == {_DEFAULT_RADIUS}:
        draft.warnings.append(
            f"all pulleys have radius {_DEFAULT_RADIUS} m, WireX's default: perhaps never "
            "measured (--no-pulleys takes points)"
        )
    if not pulleys:
        draft.dropped.append("pulleys, as asked for: exit points are eyelets at the base points")


def _exit(
    file: SourceFile, base: Element | None, where: str, pulleys: bool
) -> tuple[Array, float, Array]:
    """Return position, pulley radius and swivel axis of a base point."""
    position = _point(file, base, f"{where}/base")
    down = np.array([0.0, 0.0, -1.0])
    if base is None or base.get("radius") is None or not pulleys:
        return position, 0.0, down
    radius = file.attribute(base, "radius", f"{where}/base", "m")
    if radius < 0.0:
        file.fault(f"{where}/base@radius", f"{radius:g}", ">= 0")
    entries = [file.attribute(base, entry, f"{where}/base") for entry in _ROTATION_ATTRIBUTES]
    frame = np.array(entries).reshape(3, 3).T
    file.rotation(frame, f"{where}/base, a11 ... a33")
    return position, radius, frame[:, 2]


def _point(file: SourceFile, element: Element | None, where: str) -> Array:
    """Return x, y, z of a point."""
    if element is None:
        return np.full(3, np.nan)
    return np.array([file.attribute(element, axis, where, "m") for axis in "xyz"])


def _platform(file: SourceFile, robot: Element, draft: Draft) -> None:
    """Put mass, centre of mass and inertia, where the file has all of each."""
    platform = robot.find("platform")
    if platform is None:
        return
    mass = _value(file, platform, "mass", "platform")
    if mass is not None:
        draft.put(("platform", "mass"), mass, "mass of the platform")
    gravity = platform.find("centerofgravity")
    centre = None
    if gravity is not None:
        centre = _point(file, gravity, "platform/centerofgravity").tolist()
        draft.put(("platform", "center_of_mass"), centre, "centerofgravity of the platform")
    if mass == _DEFAULT_MASS and tuple(centre or ()) == _DEFAULT_CENTRE:
        draft.warnings.append(
            f"mass {_DEFAULT_MASS:g} kg with centre of gravity (0, 1, 0.2) m are WireX's defaults: "
            "probably never measured; give your own with --complete"
        )
    inertia = platform.find("inertiatensor")
    if inertia is not None:
        _inertia(file, inertia, draft)


def _inertia(file: SourceFile, element: Element, draft: Draft) -> None:
    """Put the inertia, if the file has all of it."""
    known = {key: file.attribute(element, key, "inertiatensor") for key in element.keys()}
    if not {"Ixx", "Iyy", "Izz"} <= set(known):
        draft.dropped.append(f"inertiatensor with {', '.join(known) or 'nothing'} alone")
        return
    matrix = np.zeros((3, 3))
    for i, j in zip(*np.triu_indices(3), strict=True):
        entry = f"I{'xyz'[i]}{'xyz'[j]}"
        matrix[i, j] = matrix[j, i] = known.get(entry, 0.0)
    source = "inertiatensor of the platform, taken as about its centre of mass"
    draft.put(("platform", "inertia"), matrix.tolist(), source)


def _value(file: SourceFile, element: Element | None, name: str, where: str) -> float | None:
    """Return a number; one that is 0 or missing counts as unset."""
    if element is None or element.get(name) is None:
        return None
    return file.attribute(element, name, where) or None


def _cable(file: SourceFile, root: Element, draft: Draft) -> None:
    """Put the cable type; chains do not name theirs, so that there may be only one."""
    cables = root.findall("cable")
    if len(cables) > 1:
        names = ", ".join(repr(cable.get("name")) for cable in cables)
        raise file.refuse(
            f"{len(cables)} cable types ({names}); allowed: one, as no chain names it"
        )
    kind: dict[str, float] = {}
    draft.data["cable_types"] = {"cable": kind}
    if not cables:
        return
    cable = cables[0]
    density = _value(file, cable, "weight", "cable")
    if density is not None:
        draft.put(("cable_types", "cable", "linear_density"), density, "weight of the cable, kg/m")
    radius = _value(file, cable, "radius", "cable")
    if radius is not None:
        source = "twice the radius of the cable"
        draft.put(("cable_types", "cable", "diameter"), 2.0 * radius, source)
    modulus = _value(file, cable, "elasticity", "cable")
    if modulus is not None:
        source = "elasticity of the cable, Pa; the file does not say of which area"
        draft.put(("cable_types", "cable", "youngs_modulus"), modulus, source)


def _winches(file: SourceFile, root: Element, draft: Draft) -> list[str]:
    """Return winches by name, with their known values."""
    names: list[str] = []
    draft.data["winches"] = {}
    for i, winch in enumerate(root.findall("winch")):
        name = (winch.get("name") or f"winch_{i + 1}").strip()
        if name in names:
            file.fault("winch@name", repr(name), "a name of its own for each winch")
        names.append(name)
        draft.data["winches"][name] = {}
        cable = winch.find("cable")
        for known, ours in _WINCH_FIELDS.items():
            value = _value(file, cable, known, f"winch {name!r}/cable")
            if value is not None:
                draft.put(("winches", name, ours), value, f"{known} of the winch's cable")
    if not names:
        draft.data["winches"]["winch"] = {}
    return names or ["winch"]


def _limits(file: SourceFile, root: Element, robot: Element, draft: Draft) -> None:
    """Put the tension limits of the application, else of the winch."""
    needs = robot.find("application")
    low = _value(file, needs, "min_cable_load", "application")
    high = _value(file, needs, "max_cable_load", "application")
    source = "cable loads of the application"
    if low is None and high is None:
        low = _value(file, root.find("cable"), "minimum_load", "cable")
        high = _value(file, root.find("winch/cable"), "f_max", "winch/cable")
        source = "minimum_load of the cable, f_max of the winch"
    count = len(draft.data["chains"])
    draft.limits([low] * count, [high] * count, source)
