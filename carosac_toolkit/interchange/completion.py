"""Completion of a draft to a robot file: additions of the user, missing fields, the file's text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from carosac_toolkit.base.errors import CarosacError, InvalidField, InvalidFile
from carosac_toolkit.base.yaml import Document, FieldPath, dump_yaml, format_path, read_yaml, walk
from carosac_toolkit.interchange.draft import Draft
from carosac_toolkit.robot.file import document_faults, fields_to_give, parse_robot
from carosac_toolkit.robot.robot import Robot

_SECTION_ORDER = (
    "schema", "name", "description", "licence", "gravity", "frame", "platform", "cable_types",
    "winches", "chains", "tension_limits", "workspace", "home",
)  # fmt: skip
_TEXT_SECTIONS = ("schema", "name", "description", "licence")
_FIELD_HINTS: dict[FieldPath, str] = {
    ("licence",): "a text: under which licence the numbers may be used",
    ("workspace", "min"): "3 numbers in m, the lowest corner of the box of platform positions",
    ("workspace", "max"): "3 numbers in m, the highest corner of that box",
    ("home", "position"): "3 numbers in m, inside the workspace",
    ("home", "rpy_deg"): "3 numbers in degrees: roll, pitch, yaw",
}
_STIFFNESS_HINT = (
    "EA, a force in N (or mN, kN, MN), > 0; or youngs_modulus with area or material_density"
)
_MODULUS_HINT = (
    "a force in N (or mN, kN, MN), > 0, instead of the file's youngs_modulus; or, to that, the "
    "load-bearing area (m^2 or mm^2; not pi d^2/4 of a rope), or material_density (kg/m^3)"
)


@dataclass(frozen=True)
class Completed:
    """Draft with the additions of the user.

    Attributes:
        draft: With the additions in it.
        missing: Fields that a robot file needs, with what they allow.
        replaced: Paths whose value in the file gave way to the user's.
    """

    draft: Draft
    missing: tuple[tuple[FieldPath, str], ...]
    replaced: tuple[str, ...]


def complete(
    draft: Draft, *, fragment: str = "", name: str = "", pairs: Sequence[str] = ()
) -> Completed:
    """Add to a draft what its format does not hold.

    Args:
        draft: Draft of the file; it is changed.
        fragment: YAML in the layout of the robot file, of any of its fields. Empty ones do not
            count, so that a form may be filled in bit by bit.
        name: Name of the fragment in messages and provenance.
        pairs: ``PATH=VALUE``, single fields.

    Raises:
        InvalidFile: A fragment with faults.
        InvalidField: A pair that is none.
    """
    document = read_yaml(fragment) if fragment.strip() else Document(data={})
    if document.faults or not isinstance(document.data, dict):
        faults = [f"line {line}: {what}" for line, what in document.faults]
        raise InvalidFile(name, faults or ["not a mapping of fields of a robot file"])
    replaced: list[str] = []
    own = document.data.pop("provenance", None) or {}
    if not isinstance(own, dict):
        line = document.lines.get(("provenance",))
        where = "provenance" if line is None else f"line {line}: provenance"
        raise InvalidFile(name, [f"{where}: got {own!r}; allowed: a mapping from fields to texts"])
    _merge(draft, document.data, own, f"given in {Path(name).name}", replaced)
    for pair in pairs:
        _merge(draft, _nested(pair), {}, "given on the command line", replaced)
    draft.provenance.update({str(path): str(source) for path, source in own.items()})
    missing, wrong = _sorted_faults(draft)
    if wrong:
        raise InvalidFile(name or draft.source, [_located(fault, document) for fault in wrong])
    return Completed(draft, tuple(missing), tuple(replaced))


def robot_and_text(completed: Completed) -> tuple[Robot, str]:
    """Return the robot and the text of its file.

    Raises:
        CarosacError: Something is missing.
    """
    if completed.missing:
        raise CarosacError("\n".join([*missing_lines(completed)]))
    data = {key: completed.draft.data[key] for key in _SECTION_ORDER if key in completed.draft.data}
    rest = {key: value for key, value in completed.draft.data.items() if key not in _SECTION_ORDER}
    content = {**data, **rest, "provenance": _needed(completed.draft)}
    text = dump_yaml({key: _styled(value) for key, value in content.items()})
    return parse_robot(text, source="imported robot"), text


def missing_lines(completed: Completed) -> Iterator[str]:
    """Return one line for each missing field."""
    for path, allowed in completed.missing:
        yield f"{format_path(path)}: {allowed}"


def form(completed: Completed) -> str:
    """Return a YAML fragment with the missing fields, to be filled in."""
    tree: dict[str | int, Any] = {}
    for path, allowed in completed.missing:
        place = tree
        for part in path[:-1]:
            place = place.setdefault(part, {})
        place[path[-1]] = allowed
    lines = [
        "# What the file does not hold, to be filled in. Units may be written: 4 mm, 10 g/m.",
        *_form_lines(tree, 0),
        "provenance:  # where numbers come from, as in `platform.mass: weighed`",
        "",
    ]
    return "\n".join(lines)


def _form_lines(tree: dict[str | int, Any], depth: int) -> Iterator[str]:
    """Return indented keys; leaves with what they allow."""
    for key, value in tree.items():
        start = f"{'  ' * depth}{_key(key)}:"
        if isinstance(value, dict):
            yield start
            yield from _form_lines(value, depth + 1)
        else:
            yield f"{start}  # {value}"


def _key(part: str | int) -> str:
    """Return a key of YAML."""
    text = str(part)
    return text if text.replace("_", "a").isalnum() and not text.isdigit() else f'"{text}"'


def _nested(pair: str) -> dict[str, Any]:
    """Parse ``a.b=1 mm`` to nested mappings."""
    path, equals, value = pair.partition("=")
    parts = [part.strip() for part in path.split(".")]
    if not equals or not value.strip() or not all(parts):
        raise InvalidField("--set", repr(pair), "PATH=VALUE, such as gravity=9.81")
    document = read_yaml(value)
    if document.faults:
        raise InvalidField("--set", repr(pair), "PATH=VALUE with a value as in YAML")
    result: Any = document.data
    for part in reversed(parts):
        result = {part: result}
    return dict(result)


def _merge(
    draft: Draft,
    additions: Mapping[str, Any],
    own: Mapping[str, Any],
    source: str,
    replaced: list[str],
) -> None:
    """Put the leaves of a mapping into the draft."""
    for path, value in _leaves((), additions):
        if value is None:
            continue
        place: Any = draft.data
        for part in path[:-1]:
            place = place.setdefault(part, {})
            if not isinstance(place, dict):
                raise InvalidField(format_path(path), "a field of it", "the whole field")
        name = format_path(path)
        if path[-1] in place and path[0] not in _TEXT_SECTIONS:
            replaced.append(name)
        _instead(place, path)
        place[path[-1]] = value
        if path[0] in _TEXT_SECTIONS:
            continue
        for known in [p for p in draft.provenance if _covers(name, p)]:
            del draft.provenance[known]
        if not any(_covers(str(known), name) for known in own):
            draft.provenance[name] = source


def _instead(place: dict[str, Any], path: FieldPath) -> None:
    """Remove values that a new value excludes."""
    if path[0] == "cable_types" and path[-1] == "axial_stiffness":
        for other in ("youngs_modulus", "area", "material_density"):
            place.pop(other, None)
    if path[0] == "cable_types" and path[-1] == "youngs_modulus":
        place.pop("axial_stiffness", None)
    if path[0] == "home" and path[-1] in ("rpy_deg", "quaternion_wxyz"):
        place.pop("rpy_deg", None)
        place.pop("quaternion_wxyz", None)
    if path[0] == "workspace" and len(path) == 2:
        ways = (("min", "max"), ("center", "size"))
        for other in ways[1] if path[-1] in ways[0] else ways[0]:
            place.pop(other, None)


def _leaves(path: FieldPath, value: Any) -> Iterator[tuple[FieldPath, Any]]:
    """Yield the fields below a path; a list is one field."""
    if isinstance(value, dict) and value:
        for key, entry in value.items():
            yield from _leaves((*path, key), entry)
    elif path and value != {}:
        yield path, value


def _covers(path: str, other: str) -> bool:
    """Return whether a path is another path, or its start."""
    return other == path or other.startswith((f"{path}.", f"{path}["))


def _sorted_faults(
    draft: Draft,
) -> tuple[list[tuple[FieldPath, str]], list[tuple[FieldPath, str]]]:
    """Return missing fields one by one, and other faults."""
    data = {**draft.data, "provenance": _needed(draft)}
    missing: list[tuple[FieldPath, str]] = []
    faults: list[tuple[FieldPath, str]] = []
    kinds = data.get("cable_types")
    for name, kind in (kinds if isinstance(kinds, dict) else {}).items():
        ways = ("axial_stiffness", "area", "material_density")
        if isinstance(kind, dict) and not any(way in kind for way in ways):
            allowed = _MODULUS_HINT if "youngs_modulus" in kind else _STIFFNESS_HINT
            missing.append((("cable_types", name, "axial_stiffness"), allowed))
    for path, what in document_faults(data):
        known = [known for known, _ in missing]
        if what.startswith(("missing", "rotation missing")):
            rotation = what.startswith("rotation")
            for leaf in [((*path, "rpy_deg"), what)] if rotation else fields_to_give(path):
                missing += [leaf] if leaf[0] not in known else []
        elif path not in known:
            faults.append((path, what))
    missing.sort(key=lambda entry: _SECTION_ORDER.index(str(entry[0][0])))
    return [(path, _FIELD_HINTS.get(path, allowed)) for path, allowed in missing], faults


def _needed(draft: Draft) -> dict[str, str]:
    """Return the provenance of the fields present."""
    paths = {format_path(path) for path, _ in walk((), draft.data)}
    return {path: source for path, source in draft.provenance.items() if path in paths}


def _located(fault: tuple[FieldPath, str], document: Document) -> str:
    """Return a fault with the line of the fragment, if it is in there."""
    path, what = fault
    line = f"line {document.lines[path]}: " if path in document.lines else ""
    return f"{line}{format_path(path)}: {what}"


def _styled(value: Any, inside: bool = False) -> Any:
    """Set vectors, matrices and chains on one line each."""
    from ruamel.yaml.comments import CommentedMap, CommentedSeq

    if isinstance(value, dict):
        styled = CommentedMap({key: _styled(entry) for key, entry in value.items()})
        if inside:
            styled.fa.set_flow_style()
        return styled
    if isinstance(value, list):
        row = CommentedSeq([_styled(entry, inside=True) for entry in value])
        if not any(isinstance(entry, dict) for entry in value):
            row.fa.set_flow_style()
        return row
    return value
