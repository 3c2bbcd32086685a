"""Robots of cdpyr (github.com/cable-robots/cdpyr): JSON or YAML of its schema.

What the file means, after cdpyr's own code: chains name frame anchor, platform anchor and cable by
number from 0; ``dcm`` of an anchor and of its pulley turn local into world axes, and the z axis of
the pulley is the direction of travel into it, about which it swivels. Gravity is not in the file,
and neither is whether the inertia is about the origin or the centre of gravity of the platform.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.rotations import from_matrix
from carosac_toolkit.base.yaml import read_yaml
from carosac_toolkit.interchange.draft import Draft
from carosac_toolkit.interchange.source_file import SourceFile, about_centre_of_mass

INERTIA_REFERENCE_POINTS = ("origin", "center_of_mass")


def read_cdpyr(path: Path, *, pulleys: bool = True, inertia_about: str | None = None) -> Draft:
    """Read a cdpyr robot.

    Args:
        path: A JSON or YAML file.
        pulleys: False: eyelets at the frame anchors.
        inertia_about: Reference point of the inertia, `origin` or `center_of_mass` of the
            platform; needed where these differ.

    Raises:
        InvalidFile: A file with faults, or no single platform with six degrees of freedom.
    """
    if inertia_about is not None and inertia_about not in INERTIA_REFERENCE_POINTS:
        raise InvalidField(
            "--inertia-about", repr(inertia_about), f"one of {INERTIA_REFERENCE_POINTS}"
        )
    file = SourceFile(path)
    data = _mapping(file, _parsed(file), "the file")
    draft = Draft(f"cdpyr, {path.name}")
    name = str(data.get("name") or path.stem)
    draft.put(("name",), name)
    draft.put(("description",), f"{name}, imported from cdpyr")
    platforms = _list(file, data.get("platforms"), "platforms")
    if len(platforms) != 1:
        raise file.refuse(f"platforms: got {len(platforms)}; allowed: one")
    platform = _mapping(file, platforms[0], "platforms[0]")
    _pattern(file, platform)
    _platform(file, platform, draft, inertia_about)
    _chains(file, data, platform, draft, pulleys)
    _home(file, data.get("home_pose") or platform.get("pose"), draft)
    draft.dropped.append("modulus, density, breaking load and colour of cables; drives and drums")
    file.check()
    return draft


def _parsed(file: SourceFile) -> object:
    """Parse the content of the file."""
    text = file.text()
    if file.path.suffix.lower() == ".json":
        try:
            return json.loads(text)
        except (ValueError, RecursionError) as error:
            raise file.refuse(f"not JSON: {error}") from error
    document = read_yaml(text)
    for line, fault in document.faults:
        file.faults.append(f"line {line}: {fault}")
    file.check()
    return document.data


def _mapping(file: SourceFile, value: object, where: str) -> dict[str, Any]:
    """Return a mapping, or refuse the value."""
    if not isinstance(value, dict):
        raise file.refuse(f"{where}: got {_short(value)}; allowed: a mapping, as cdpyr writes it")
    return value


def _list(file: SourceFile, value: object, where: str) -> list[Any]:
    """Return a list, also one inside ``data``, or refuse the value."""
    inner = value.get("data") if isinstance(value, dict) else value
    if not isinstance(inner, list):
        raise file.refuse(f"{where}: got {_short(value)}; allowed: a list, as cdpyr writes it")
    return inner


def _short(value: object) -> str:
    return "nothing" if value is None else repr(value)[:60]


def _plain(value: object, key: str) -> object:
    """Return a value, or the one of the same name inside it: older versions of cdpyr nest them."""
    return value.get(key) if isinstance(value, dict) else value


def _pattern(file: SourceFile, platform: dict[str, Any]) -> None:
    """Refuse platforms that are not free in all directions."""
    pattern = platform.get("motion_pattern", platform.get("motionpattern"))
    if isinstance(pattern, dict):
        turns, moves = pattern.get("rotation"), pattern.get("translation")
        pattern = pattern.get("name") if turns is None else f"{turns}R{moves}T".replace(".0", "")
    if str(pattern).upper().removeprefix("MP_") != "3R3T":
        raise file.refuse(
            f"platforms[0].motion_pattern: got {_short(pattern)}; allowed: '3R3T', a free body"
        )


def _vector(file: SourceFile, value: object, where: str) -> Array:
    return file.numbers(_plain(value, "position"), where, 3, "m")


def _rotation(file: SourceFile, value: object, where: str) -> Array:
    """Return a direction cosine matrix; identity if absent."""
    rows = _plain(value, "dcm")
    if rows is None:
        return np.eye(3)
    if not isinstance(rows, list) or len(rows) != 3:
        file.fault(where, _short(rows), "a rotation matrix, 3 rows of 3 numbers")
        return np.eye(3)
    matrix = np.array([file.numbers(row, f"{where}[{i}]", 3) for i, row in enumerate(rows)])
    file.rotation(matrix, where)
    return matrix


def _platform(
    file: SourceFile, platform: dict[str, Any], draft: Draft, inertia_about: str | None
) -> None:
    """Put mass, centre and inertia."""
    where = "platforms[0]"
    centre = np.zeros(3)
    stated = _plain(platform.get("center_of_gravity"), "position")
    if stated is not None:
        centre = file.numbers(stated, f"{where}.center_of_gravity", 3, "m")
        source = "center_of_gravity of the platform"
        draft.put(("platform", "center_of_mass"), centre.tolist(), source)
    link = _plain(platform.get("center_of_linkage"), "position")
    if link is not None and np.any(file.numbers(link, f"{where}.center_of_linkage", 3, "m")):
        draft.dropped.append("center_of_linkage of the platform")
    inertia = platform.get("inertia")
    if not isinstance(inertia, dict):
        return
    mass = _mass(file, inertia.get("linear"), f"{where}.inertia.linear")
    if mass is not None:
        draft.put(("platform", "mass"), mass, "linear inertia of the platform")
    if inertia.get("angular") is None:
        return
    matrix = _square(file, inertia["angular"], f"{where}.inertia.angular")
    known = centre if stated is not None else None
    _inertia(file, matrix, mass, known, draft, inertia_about)


def _inertia(
    file: SourceFile, matrix: Array, mass: float | None, centre: Array | None, draft: Draft,
    about: str | None,
) -> None:  # fmt: skip
    """Put the inertia about the centre of mass, if it can be known; `centre` is the file's."""
    if centre is not None and not centre.any():
        source = "angular inertia of the platform; origin and centre of gravity are one point"
    elif about is None:
        draft.dropped.append(
            "angular inertia of the platform: the file does not say about which point; "
            "--inertia-about origin or center_of_mass takes it"
        )
        return
    elif about == "center_of_mass":
        source = "angular inertia of the platform, said to be about its centre of mass"
    elif centre is None:
        draft.dropped.append(
            "angular inertia of the platform: without a centre of gravity in the file it "
            "cannot be moved from the origin; give platform.inertia about the centre of mass"
        )
        return
    else:
        if mass is None:
            file.fault("platforms[0].inertia.linear", "nothing", "the mass, to move the inertia")
        matrix = about_centre_of_mass(matrix, mass or np.nan, centre)
        source = "angular inertia of the platform about its origin, moved to the centre of mass"
    draft.put(("platform", "inertia"), matrix.tolist(), source)


def _mass(file: SourceFile, value: object, where: str) -> float | None:
    """Return the mass from m times the unit matrix."""
    if value is None:
        return None
    matrix = _square(file, value, where)
    if np.isfinite(matrix).all() and not np.allclose(matrix, matrix[0, 0] * np.eye(3)):
        file.fault(where, _short(value), "a mass times the unit matrix")
    return float(matrix[0, 0])


def _square(file: SourceFile, value: object, where: str) -> Array:
    """Return a 3x3 matrix, also from its diagonal."""
    if isinstance(value, list) and len(value) == 3 and not isinstance(value[0], list):
        return np.diag(file.numbers(value, where, 3))
    rows = value if isinstance(value, list) and len(value) == 3 else None
    if rows is None:
        file.fault(where, _short(value), "3 numbers or a 3x3 matrix")
        return np.full((3, 3), np.nan)
    return np.array([file.numbers(row, f"{where}[{i}]", 3) for i, row in enumerate(rows)])


def _chains(
    file: SourceFile, data: dict[str, Any], platform: dict[str, Any], draft: Draft, pulleys: bool
) -> None:
    """Put chains from their numbers."""
    frames = _list(file, _mapping(file, data.get("frame"), "frame").get("anchors"), "frame.anchors")
    anchors = _list(file, platform.get("anchors"), "platforms[0].anchors")
    cables = _list(file, data.get("cables"), "cables")
    chains = _list(file, data.get("kinematic_chains"), "kinematic_chains")
    if not chains:
        raise file.refuse("kinematic_chains: got none; allowed: one for each cable")
    names, exits, points, kinds = [], [], [], []
    labels = _cable_types(file, cables, draft)
    for i, entry in enumerate(chains):
        where = f"kinematic_chains[{i}]"
        chain = _mapping(file, entry, where)
        _index(file, chain.get("platform", 0), f"{where}.platform", 1)
        at = _index(file, chain.get("frame_anchor"), f"{where}.frame_anchor", len(frames))
        to = _index(file, chain.get("platform_anchor"), f"{where}.platform_anchor", len(anchors))
        by = _index(file, chain.get("cable"), f"{where}.cable", len(cables))
        if at is None or to is None or by is None:
            continue
        names.append(f"cable_{i + 1}")
        exits.append(_exit(file, frames[at], f"frame.anchors[{at}]", pulleys))
        anchor = _mapping(file, anchors[to], f"platforms[0].anchors[{to}]")
        points.append(_vector(file, anchor.get("position"), f"platforms[0].anchors[{to}].position"))
        kinds.append(labels[by])
    file.check()
    draft.data["winches"] = {"winch": {}}
    draft.chains(names, exits, points, ["winch"] * len(names), kinds)
    draft.data["cable_types"] = {k: draft.data["cable_types"][k] for k in dict.fromkeys(kinds)}
    draft.provenance["frame.exit_points"] = f"{draft.source}: anchors of the frame"
    draft.provenance["platform.anchor_points"] = f"{draft.source}: anchors of the platform"
    if not pulleys:
        draft.dropped.append("pulleys, as asked for: exit points are eyelets at the frame anchors")


def _index(file: SourceFile, value: object, where: str, count: int) -> int | None:
    """Return an index of a list, from 0; None with a fault if it is invalid."""
    number = -1
    if isinstance(value, int | float) and not isinstance(value, bool) and value % 1 == 0:
        number = int(value)
    if not 0 <= number < count:
        file.fault(where, _short(value), f"a number from 0 to {count - 1}")
        return None
    return number


def _exit(file: SourceFile, entry: object, where: str, pulleys: bool) -> tuple[Array, float, Array]:
    """Return position, pulley radius and swivel axis of a frame anchor."""
    anchor = _mapping(file, entry, where)
    position = _vector(file, anchor.get("position"), f"{where}.position")
    pulley = anchor.get("pulley")
    axis = np.array([0.0, 0.0, -1.0])
    if not isinstance(pulley, dict) or not pulleys:
        return position, 0.0, axis
    radius = file.number(pulley.get("radius"), f"{where}.pulley.radius", "m")
    if radius < 0.0:
        file.fault(f"{where}.pulley.radius", f"{radius:g}", ">= 0")
    turn = _rotation(file, anchor.get("dcm"), f"{where}.dcm")
    turn = turn @ _rotation(file, pulley.get("dcm"), f"{where}.pulley.dcm")
    return position, radius, turn[:, 2]


def _cable_types(file: SourceFile, cables: list[Any], draft: Draft) -> list[str]:
    """Put cable types, equal ones once; return the name of each cable's."""
    kinds: dict[tuple[str, float], str] = {}
    labels = []
    draft.data["cable_types"] = {}
    for i, entry in enumerate(cables):
        cable = _mapping(file, entry, f"cables[{i}]")
        diameter = file.number(cable.get("diameter"), f"cables[{i}].diameter", "m")
        name = str(cable.get("name") or cable.get("material") or "cable").strip()
        key = (name, diameter)
        if key not in kinds:
            label = name if name not in kinds.values() else f"{name}_{i + 1}"
            kinds[key] = label
            draft.put(("cable_types", label, "diameter"), diameter, f"diameter of cable {i}")
        labels.append(kinds[key])
    return labels


def _home(file: SourceFile, pose: object, draft: Draft) -> None:
    """Put the home pose, if it is one in a supported form."""
    if not isinstance(pose, dict):
        return
    linear, angular = pose.get("linear", pose), pose.get("angular", pose)
    position, dcm = _plain(linear, "position"), _plain(angular, "dcm")
    if not (isinstance(position, list) and len(position) == 3 and isinstance(dcm, list)):
        draft.dropped.append("pose of the platform, in an unsupported layout")
        return
    home = {"position": file.numbers(position, "pose.position", 3, "m").tolist()}
    turn = _rotation(file, dcm, "pose.dcm")
    if np.isfinite(turn).all():
        home["quaternion_wxyz"] = from_matrix(turn[None])[0].tolist()
    draft.put(("home",), home, "pose of the platform")
