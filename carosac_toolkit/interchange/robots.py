"""Detection of the program that wrote a robot's files, and reading them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from carosac_toolkit.base.errors import InvalidField, MissingFile
from carosac_toolkit.interchange.caspr import read_caspr
from carosac_toolkit.interchange.cdpyr import read_cdpyr
from carosac_toolkit.interchange.draft import Draft
from carosac_toolkit.interchange.source_file import SourceFile
from carosac_toolkit.interchange.wirex import read_wirex

_BODIES, _CABLES = "bodies", "cables"
_ROBOT_FILE_KINDS = (
    "CASPR's _bodies.xml with its _cables.xml, WireX's .wcrfx, or cdpyr's .json or .yaml"
)
_PARTNER_SUFFIXES = {_BODIES: ("_bodies", "_cables"), _CABLES: ("_cables", "_bodies")}


def read_robot(
    paths: Sequence[Path],
    *,
    cable_set: str | None = None,
    pulleys: bool = True,
    inertia_about: str | None = None,
) -> Draft:
    """Read the robot of another program.

    Args:
        paths: One file, or the two of CASPR, of which one finds the other by its name.
        cable_set: For CASPR; see `read_caspr`.
        pulleys: False: eyelets instead of pulleys.
        inertia_about: For cdpyr; see `read_cdpyr`.

    Raises:
        InvalidField: Files that do not go together, or an option of another format.
        InvalidFile: A file with faults.
    """
    kinds = {kind_of(path): path for path in paths}
    caspr = set(kinds) & {_BODIES, _CABLES}
    for option, value, fits in (
        ("--cable-set", cable_set, bool(caspr)),
        ("--inertia-about", inertia_about, "cdpyr" in kinds),
    ):
        if value is not None and not fits:
            raise InvalidField(option, repr(value), f"nothing for a file of {next(iter(kinds))}")
    if len(kinds) < len(paths) or (len(kinds) > 1 and len(caspr) < len(kinds)):
        raise InvalidField("FILE", ", ".join(map(str, paths)), _ROBOT_FILE_KINDS)
    if not caspr:
        (kind, path), *_ = kinds.items()
        if kind == "WireX":
            return read_wirex(path, pulleys=pulleys)
        return read_cdpyr(path, pulleys=pulleys, inertia_about=inertia_about)
    for kind in {_BODIES, _CABLES} - caspr:
        kinds[kind] = _partner(*kinds.items())
    return read_caspr(kinds[_BODIES], kinds[_CABLES], cable_set=cable_set, pulleys=pulleys)


def kind_of(path: Path) -> str:
    """Tell which program wrote a file, and which of CASPR's files it is."""
    suffix = path.suffix.lower()
    if suffix in (".json", ".yaml", ".yml"):
        return "cdpyr"
    if suffix not in (".xml", ".wcrfx"):
        raise InvalidField("FILE", repr(str(path)), _ROBOT_FILE_KINDS)
    file = SourceFile(path)
    tag = file.xml().tag
    roots = {"models": "WireX", "bodies_system": _BODIES, "links": _BODIES, "cables": _CABLES}
    if tag not in roots:
        raise file.refuse(f"XML with root <{tag}>; allowed: {_ROBOT_FILE_KINDS}")
    return roots[tag]


def _partner(known: tuple[str, Path]) -> Path:
    """Return the other file of a CASPR robot, beside the known one."""
    kind, path = known
    own, other = _PARTNER_SUFFIXES[kind]
    partner = path.with_name(path.name.replace(own, other))
    if own not in path.name or not partner.exists():
        raise MissingFile(partner, "give both files of the robot: X_bodies.xml and X_cables.xml")
    return partner
