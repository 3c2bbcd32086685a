"""Robots of CASPR (github.com/darwinlau/CASPR): ``_bodies.xml`` with ``_cables.xml``.

What the files mean, after CASPR's own code:

* one link with a joint ``SPATIAL_EULER_XYZ``, whose coordinates are the position [m] relative to
  the location in its parent, and R = Rx(a) Ry(b) Rz(c) with angles in rad;
* attachments from the base (link 0, in the world frame) to the platform (link 1), there relative
  to the joint or to the centre of mass (`attachment_reference`);
* ``base_rotating_pulley``: the cable enters at ``fixed_location`` along ``cable_entry_vector``,
  about which the pulley swivels: our exit point and swivel axis;
* ``cable_linear_spring``: stiffness K_cable / length, so K_cable is the axial stiffness.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.rotations import from_matrix
from carosac_toolkit.base.units import is_quantity
from carosac_toolkit.interchange.draft import Draft
from carosac_toolkit.interchange.source_file import SourceFile, about_centre_of_mass

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

_SUPPORTED_JOINT = "SPATIAL_EULER_XYZ"
_DOWNWARD_AXIS = np.array([0.0, 0.0, -1.0])
_IGNORED_ELEMENTS = (
    "display_range and view_angle of the pictures, end_location, operational spaces, trajectories"
)


def read_caspr(
    bodies: Path, cables: Path, *, cable_set: str | None = None, pulleys: bool = True
) -> Draft:
    """Read a CASPR robot.

    Args:
        bodies: Its ``_bodies.xml``.
        cables: Its ``_cables.xml``.
        cable_set: Name of the cable set; None for the file's default.
        pulleys: False: eyelets at the entry points of pulleys.

    Raises:
        InvalidFile: A file with faults, or a robot that is no single platform on cables.
        InvalidField: No such cable set.
    """
    body, rope = SourceFile(bodies), SourceFile(cables)
    chosen = _chosen_set(rope, cable_set)
    title = f"CASPR, {bodies.name} and {cables.name}, cable set {chosen.get('id')!r}"
    draft = Draft(title, dropped=[_IGNORED_ELEMENTS])
    centre = _platform(body, draft)
    _cables(rope, chosen, centre, draft, pulleys)
    body.check()
    rope.check()
    return draft


def _chosen_set(file: SourceFile, asked: str | None) -> Element:
    """Return the requested cable set, or the default one."""
    root = file.xml()
    sets = {found.get("id", ""): found for found in root.findall("cable_set")}
    if not sets:
        raise file.refuse("no <cable_set> in <cables>")
    if len(sets) < len(root.findall("cable_set")):
        raise file.refuse("two cable sets of one id")
    name = asked if asked is not None else root.get("default_cable_set", "")
    if name not in sets:
        raise InvalidField("--cable-set", repr(name), f"one of {', '.join(sets)}")
    return sets[name]


def _platform(file: SourceFile, draft: Draft) -> Array:
    """Put mass, centre and inertia of the link, and its joint; return the centre of mass in P."""
    root = file.xml()
    links = root if root.tag == "links" else root.find("links")
    rigid_links = [] if links is None else list(links)
    if len(rigid_links) != 1 or rigid_links[0].tag != "link_rigid":
        tags = ", ".join(link.get("name") or link.tag for link in rigid_links) or "none"
        raise file.refuse(
            f"{len(rigid_links)} links ({tags}); allowed: one rigid link, the platform"
        )
    link = rigid_links[0]
    draft.put(("name",), (link.get("name") or file.path.stem).strip())
    draft.put(("description",), f"{link.get('name') or file.path.stem}, imported from CASPR")
    joint = link.find("joint")
    if joint is None or joint.get("type") != _SUPPORTED_JOINT:
        kind = None if joint is None else joint.get("type")
        raise file.refuse(f"link_rigid/joint@type: got {kind!r}; allowed: {_SUPPORTED_JOINT!r}")
    physical = link.find("physical")
    if physical is None:
        raise file.refuse("link_rigid: no element <physical>")
    centre = _body(file, physical, draft)
    _joint(file, link, joint, draft)
    return centre


def _body(file: SourceFile, physical: Element, draft: Draft) -> Array:
    """Put mass, centre of mass and inertia."""
    mass = file.child_number(physical, "mass", "physical", "kg")
    centre = file.numbers(physical.findtext("com_location"), "physical/com_location", 3, "m")
    draft.put(("platform", "mass"), mass, "mass of the link")
    draft.put(("platform", "center_of_mass"), centre.tolist(), "com_location of the link")
    inertia = file.child(physical, "inertia", "physical")
    if inertia is None:
        return centre
    entries = [
        file.child_number(inertia, name, "inertia", "kg m^2")
        for name in ("Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
    ]
    matrix = np.zeros((3, 3))
    matrix[np.triu_indices(3)] = entries
    matrix += np.triu(matrix, 1).T
    reference = inertia.get("ref")
    source = "inertia of the link about its centre of mass; Ixy, Ixz, Iyz are matrix entries"
    if reference == "joint":
        matrix = about_centre_of_mass(matrix, mass, centre)
        source = "inertia of the link about its joint, moved to the centre of mass"
    elif reference != "com":
        file.fault("inertia@ref", repr(reference), "'com' or 'joint'")
    draft.put(("platform", "inertia"), matrix.tolist(), source)
    if np.isfinite(matrix).all() and np.triu(matrix, 1).any():
        draft.warnings.append(
            "products of inertia are taken as entries of the matrix; some files mean the integral "
            "of xy, of the other sign"
        )
    return centre


def _joint(file: SourceFile, link: Element, joint: Element, draft: Draft) -> None:
    """Put home and workspace, where the joint has them."""
    origin = file.numbers(link.findtext("parent/location"), "parent/location", 3, "m")
    start = joint.get("q_initial")
    if start is not None:
        q = file.numbers(start, "joint@q_initial", 6)
        home = {
            "position": (origin + q[:3]).tolist(),
            "quaternion_wxyz": _euler_xyz(q[3:]).tolist(),
        }
        draft.put(("home",), home, "q_initial of the joint")
    ends = [joint.get("q_min"), joint.get("q_max")]
    if None not in ends:
        low, high = (file.numbers(end, "joint@q_min, q_max", 6)[:3] for end in ends)
        box = {"min": (origin + low).tolist(), "max": (origin + high).tolist()}
        draft.put(("workspace",), box, "q_min and q_max of the joint")
        draft.dropped.append("limits of the joint's angles (q_min, q_max)")


def _euler_xyz(angles: Array) -> Array:
    """Return the quaternion w x y z of R = Rx Ry Rz [rad]; NaN where an angle is."""
    if not np.isfinite(angles).all():
        return np.full(4, np.nan)
    from scipy.spatial.transform import Rotation

    turn: Array = Rotation.from_euler("XYZ", angles).as_matrix()
    quaternion: Array = from_matrix(turn[None])[0]
    return quaternion


def _cables(file: SourceFile, chosen: Element, centre: Array, draft: Draft, pulleys: bool) -> None:
    """Put chains, tension limits and stiffness of one cable set."""
    names: list[str] = []
    ends, limits, stiffness = [], [], []
    for i, cable in enumerate(chosen):
        name = (cable.get("name") or "").strip()
        where = f"cable {name!r}" if name else f"cable {i + 1}"
        name = f"cable {name}" if is_quantity(name) else name  # a number is no name in YAML
        if not name or name in names:
            file.fault(f"{where}@name", repr(name), "a name of its own for each cable")
            name = f"{name or 'cable'} ({i + 1})"
        names.append(name)
        ends.append(_ends(file, cable, where, centre, pulleys))
        limits.append([_optional(file, cable, tag, where) for tag in ("force_min", "force_max")])
        stiffness.append(_stiffness(file, cable, where, draft))
    if not names:
        raise file.refuse(f"no cables in cable set {chosen.get('id')!r}")
    draft.data.update(cable_types={}, winches={"winch": {}})
    kinds = _cable_types(draft, names, stiffness)
    draft.chains(
        names, [end[0] for end in ends], [end[1] for end in ends], ["winch"] * len(names), kinds
    )
    draft.provenance["frame.exit_points"] = f"{draft.source}: attachments to link 0"
    draft.provenance["platform.anchor_points"] = f"{draft.source}: attachments to link 1"
    draft.limits([pair[0] for pair in limits], [pair[1] for pair in limits], "force_min, force_max")
    if not pulleys and chosen.find(".//base_rotating_pulley") is not None:
        draft.dropped.append("pulleys, as asked for: exit points are eyelets at their entry points")


def _cable_types(draft: Draft, names: list[str], stiffness: list[float | None]) -> list[str]:
    """Put one cable type for each stiffness; return the name of each cable's."""
    kinds: dict[float | None, str] = {}
    for name, value in zip(names, stiffness, strict=True):
        if value not in kinds:
            kinds[value] = "cable" if len(set(stiffness)) == 1 else f"cable of {name}"
    for value, kind in kinds.items():
        draft.data["cable_types"][kind] = {}
        if value is not None:
            path = ("cable_types", kind, "axial_stiffness")
            draft.put(path, value, "K_cable of the cable, which is K times length")
    return [kinds[value] for value in stiffness]


def _stiffness(file: SourceFile, cable: Element, where: str, draft: Draft) -> float | None:
    """Return the axial stiffness [N] of a linear spring; other springs are not elastic cables."""
    if cable.tag == "cable_linear_spring":
        value = _optional(file, cable, "K_cable", where)
        if value is not None:
            return value
    if cable.tag != "cable_ideal":
        draft.dropped.append(f"spring constants of {where} (<{cable.tag}>)")
    return None


def _optional(file: SourceFile, cable: Element, tag: str, where: str) -> float | None:
    """Return a number of a cable's properties, or None if absent."""
    text = cable.findtext(f"properties/{tag}")
    return None if text is None else file.number(text, f"{where}/{tag}", "N")


def _ends(
    file: SourceFile, cable: Element, where: str, centre: Array, pulleys: bool
) -> tuple[tuple[Array, float, Array], Array]:
    """Return exit point and anchor point of a cable."""
    points = list(cable.find("attachments") or ())
    nothing = np.full(3, np.nan)
    if len(points) != 2:
        allowed = "two, at base and platform; a cable over further links is not a single platform's"
        file.fault(f"{where}/attachments", f"{len(points)} attachments", allowed)
        return (nothing, 0.0, _DOWNWARD_AXIS), nothing
    base, end = points
    if base.tag == "attachment" and (base.findtext("link") or "").strip() == "1":
        base, end = end, base
    return _exit(file, base, where, pulleys), _anchor(file, cable, end, where, centre)


def _exit(file: SourceFile, base: Element, where: str, pulleys: bool) -> tuple[Array, float, Array]:
    """Return position, pulley radius and swivel axis at the base."""
    if base.tag == "base_rotating_pulley":
        position = file.numbers(base.findtext("fixed_location"), f"{where}/fixed_location", 3, "m")
        radius = file.child_number(base, "pulley_radius", where, "m")
        axis = file.numbers(base.findtext("cable_entry_vector"), f"{where}/cable_entry_vector", 3)
        length = float(np.linalg.norm(axis))
        if length == 0.0:
            file.fault(f"{where}/cable_entry_vector", "0 0 0", "a direction")
            return position, 0.0, _DOWNWARD_AXIS
        if radius < 0.0:
            file.fault(f"{where}/pulley_radius", f"{radius:g}", ">= 0")
        return position, radius if pulleys else 0.0, axis / length
    link = (base.findtext("link") or "").strip()
    if base.tag != "attachment" or link != "0":
        got = f"<{base.tag}> at link {link or 'nothing'}"
        file.fault(f"{where}/attachments", got, "an attachment or base_rotating_pulley at link 0")
        return np.full(3, np.nan), 0.0, _DOWNWARD_AXIS
    return file.numbers(base.findtext("location"), f"{where}/location", 3, "m"), 0.0, _DOWNWARD_AXIS


def _anchor(file: SourceFile, cable: Element, end: Element, where: str, centre: Array) -> Array:
    """Return the anchor point in P."""
    link = (end.findtext("link") or "").strip()
    if end.tag != "attachment" or link != "1":
        got = f"<{end.tag}> at link {link or 'nothing'}"
        file.fault(f"{where}/attachments", got, "an attachment at link 1")
        return np.full(3, np.nan)
    location = file.numbers(end.findtext("location"), f"{where}/location", 3, "m")
    reference = cable.get("attachment_reference")
    if reference not in ("joint", "com"):
        file.fault(f"{where}@attachment_reference", repr(reference), "'joint' or 'com'")
    return location + centre if reference == "com" else location
