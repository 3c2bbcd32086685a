"""The robot file: YAML of schema ``carosac-robot/1`` becomes a `Robot`, or one message.

All faults of a file come at once, each with its line, field, value and allowed values. Quantities
are bare SI numbers or carry a unit. Nothing physical has a default that hides its absence.
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args, get_origin

from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from carosac_toolkit.base.errors import (
    InvalidField,
    InvalidFile,
    MissingFile,
    did_you_mean,
    nearest_name,
)
from carosac_toolkit.base.units import InvalidQuantity
from carosac_toolkit.base.yaml import CHARACTERS_MAX, FieldPath, format_path, read_yaml
from carosac_toolkit.robot.build import build_robot
from carosac_toolkit.robot.bundled_names import list_robots
from carosac_toolkit.robot.checks import cross_faults
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.robot.schema import Reads, RobotFile

_ROBOT_SUFFIXES = (".yaml", ".yml")
_VALUE_LENGTH_SHOWN = 80
_FAULTS_SHOWN = 50
_ERRORS_MAX = 1000  # of the schema that are worded
_USUAL_FIELDS: dict[FieldPath, tuple[str, ...]] = {  # of the ways to give a section, the usual one
    ("workspace",): ("min", "max"), ("home",): ("position", "rpy_deg"),
}  # fmt: skip
_SECTION_ORDER = (
    "frame", "platform", "cable_types", "winches", "chains", "tension_limits", "workspace", "home",
    "sensors", "hardware",
)  # fmt: skip


def load_robot(name_or_path: str | Path) -> Robot:
    """Load a robot.

    Args:
        name_or_path: A bundled name such as ``carosac``, or a path to a YAML file: anything that
            ends in ``.yaml`` or ``.yml`` or has a folder in it.

    Returns:
        The robot, with every number checked.

    Raises:
        InvalidField: No bundled robot has this name.
        MissingFile: There is no such file.
        InvalidFile: The file has faults; the message lists them all.
    """
    return parse_robot(robot_text(name_or_path), source=str(name_or_path))


def robot_text(name_or_path: str | Path) -> str:
    """Read the YAML text of a robot, unchecked; arguments and errors as `load_robot`."""
    path = robot_path(name_or_path)
    if not path.exists():
        bundled = f"bundled robots are {', '.join(list_robots())}"
        raise MissingFile(path, bundled + did_you_mean(path.stem, list(list_robots())))
    try:
        with path.open(encoding="utf-8-sig") as stream:
            return stream.read(CHARACTERS_MAX + 1)  # `read_yaml` refuses more
    except UnicodeDecodeError as error:
        raise InvalidFile(path, [f"not UTF-8 text (byte {error.start})"]) from error
    except OSError as error:
        raise InvalidFile(path, [f"cannot be read: {error.strerror}"]) from error


def robot_path(name_or_path: str | Path) -> Path:
    """Return the path of a robot file, also of one that does not exist; arguments as `load_robot`.

    Raises:
        InvalidField: No bundled robot has this name.
    """
    text = str(name_or_path)
    if not isinstance(name_or_path, str) or _looks_like_path(text):
        return Path(name_or_path)
    names = list_robots()
    if text not in names:
        allowed = f"one of {list(names)}, or a path to a .yaml file"
        raise InvalidField("robot", f"'{text}'", allowed + did_you_mean(text, list(names)))
    return Path(str(files("carosac_toolkit.robot") / "bundled" / f"{text}.yaml"))


def parse_robot(text: str, *, source: str = "robot") -> Robot:
    """Turn the text of a robot file into a robot.

    Args:
        text: YAML of schema ``carosac-robot/1``.
        source: Name in messages, usually its path.

    Raises:
        InvalidFile: The text has faults; the message lists them all.
    """
    return parse_file(text, source=source)[0]


def parse_file(text: str, *, source: str = "robot") -> tuple[Robot, RobotFile]:
    """Turn the text of a robot file into a robot, and keep the file as it was written.

    The file has more than the arrays of the robot: payloads, and parts that no chain uses.
    Arguments and errors as `parse_robot`.
    """
    document = read_yaml(text)
    faults = list(document.faults)
    if document.data is None or not isinstance(document.data, dict):
        if not faults:
            faults = [(1, f"got {_shown(document.data)}; allowed: {_allowed(RobotFile, ())}")]
        raise InvalidFile(source, _sorted(faults))
    model, problems = _check(document.data)
    faults += [(document.line(path), f"{format_path(path)}: {what}") for path, what in problems]
    if faults or model is None:
        raise InvalidFile(source, _sorted(faults))
    try:
        return build_robot(model), model
    except InvalidField as error:
        raise InvalidFile(source, [str(error)]) from error


def document_faults(data: dict[str, Any]) -> list[tuple[FieldPath, str]]:
    """Find the faults of a robot file given as plain data: paths and messages.

    Messages on absent fields start with ``missing``.
    """
    return _check(data)[1]


def fields_to_give(path: FieldPath) -> list[tuple[FieldPath, str]]:
    """List the single fields that are required at a path, each with its allowed values."""
    model = _model_of(_annotation_at(RobotFile, path))
    if model is None:
        return [(path, _allowed(RobotFile, path))]
    required = [
        field.alias or name for name, field in model.model_fields.items() if field.is_required()
    ]
    names = _USUAL_FIELDS.get(path, ()) or required or list(model.model_fields)
    return [leaf for name in names for leaf in fields_to_give((*path, name))]


def _check(data: dict[str, Any]) -> tuple[RobotFile | None, list[tuple[FieldPath, str]]]:
    """Check plain data, field by field and against each other."""
    model, parts, errors = _validate(data)
    errors = errors[:_ERRORS_MAX]
    unknown = _unknown_keys(errors)
    repaired = _repaired(data, unknown)
    if isinstance(sources := repaired.get("provenance"), dict):
        repaired["provenance"] = _repaired_sources(sources, unknown)
    return model, _schema_faults(errors, unknown) + cross_faults(repaired, parts)


def _looks_like_path(text: str) -> bool:
    """Return True for a path, False for a bundled name."""
    return text.endswith(_ROBOT_SUFFIXES) or "/" in text or "\\" in text


def _sorted(faults: list[tuple[int, str]]) -> list[str]:
    """Order faults by line and put the line in front."""
    texts = [f"line {line}: {what}" for line, what in sorted(set(faults))]
    more = len(texts) - _FAULTS_SHOWN
    return [*texts[:_FAULTS_SHOWN], f"and {more} more"] if more > 0 else texts


def _validate(
    data: dict[str, Any],
) -> tuple[RobotFile | None, SimpleNamespace, list[ErrorDetails]]:
    """Check against the schema.

    Returns:
        The model or None; the sections that are right by themselves (None where one is not), so
        that they can be checked against each other; the errors.
    """
    try:
        model = RobotFile.model_validate(data)
        return model, SimpleNamespace(**{name: getattr(model, name) for name in _SECTION_ORDER}), []
    except ValidationError as error:
        errors = error.errors(include_url=False)
    faulty = {details["loc"][0] for details in errors if details["loc"]}
    parts: dict[str, Any] = dict.fromkeys(_SECTION_ORDER)
    for name in _SECTION_ORDER:
        if name in data and name not in faulty:
            adapter: TypeAdapter[Any] = TypeAdapter(_annotation_at(RobotFile, (name,)))
            parts[name] = adapter.validate_python(data[name])
    return None, SimpleNamespace(**parts), errors


def _unknown_keys(errors: list[ErrorDetails]) -> dict[FieldPath, str | None]:
    """List paths of keys that the schema does not know, each with a similar known key, if any."""
    return {
        details["loc"]: nearest_name(details["loc"][-1], _keys(RobotFile, details["loc"][:-1]))
        for details in errors
        if details["type"] == "extra_forbidden"
    }


def _repaired(value: Any, unknown: dict[FieldPath, str | None], path: FieldPath = ()) -> Any:
    """Copy plain data with misspelt keys put right and unknown ones left out."""
    if isinstance(value, list):
        return [_repaired(entry, unknown, (*path, i)) for i, entry in enumerate(value)]
    if not isinstance(value, dict):
        return value
    result = {}
    for key, entry in value.items():
        here = (*path, key)
        correction = unknown.get(here, key)
        if correction is not None and (correction == key or correction not in value):
            result[correction] = _repaired(entry, unknown, here)
    return result


def _repaired_sources(
    sources: dict[str, Any], unknown: dict[FieldPath, str | None]
) -> dict[str, Any]:
    """Let sources follow the misspelt keys that they name, and leave out those of unknown keys."""
    repaired = dict(sources)
    for path, correction in unknown.items():
        misspelt = format_path(path)
        for name in list(repaired):
            if name == misspelt or name.startswith((f"{misspelt}.", f"{misspelt}[")):
                source = repaired.pop(name)
                if correction is not None:
                    right = format_path((*path[:-1], correction)) + name[len(misspelt) :]
                    repaired.setdefault(right, source)
    return repaired


def _schema_faults(
    errors: list[ErrorDetails], unknown: dict[FieldPath, str | None]
) -> list[tuple[FieldPath, str]]:
    """Word the errors of the schema; a misspelt key counts once, not as missing as well."""
    faults: list[tuple[FieldPath, str]] = []
    absent = [details["loc"] for details in errors if details["type"] == "missing"]
    missing = {path[-1]: path for path in absent}
    for path, correction in unknown.items():
        keys = ", ".join(_keys(RobotFile, path[:-1]))
        ending = ", which is missing" if (*path[:-1], correction) in absent else ""
        hint = f"; did you mean '{correction}'{ending}?" if correction else ""
        if path[-1] in missing:
            hint = f"; {format_path(missing[path[-1]])} is missing: is the indentation right?"
        faults.append((path, f"unknown key; allowed: {keys}{hint}"))
    misspelt = {(*path[:-1], correction) for path, correction in unknown.items()}
    for details in errors:
        path = details["loc"]
        cause = details.get("ctx", {}).get("error")
        if path in unknown or (details["type"] == "missing" and path in misspelt):
            continue
        if isinstance(cause, InvalidQuantity):
            faults.append((path, f"got {_shown(cause.value)}; allowed: {cause.allowed}"))
        elif isinstance(cause, InvalidField):
            field = (*path, *cause.field.split("."))
            faults.append((field, f"got {cause.value}; allowed: {cause.allowed}"))
        elif details["type"] == "missing":
            faults.append((path, f"missing; allowed: {_allowed(RobotFile, path)}"))
        else:
            shown = _shown(details["input"])
            faults.append((path, f"got {shown}; allowed: {_allowed(RobotFile, path)}"))
    return faults


def _shown(value: object) -> str:
    """Show a value as its author wrote it, cut where it is long."""
    if value is None:
        return "nothing"
    if isinstance(value, dict):
        return "a mapping"
    if isinstance(value, float):
        return f"{value:.12g}"
    text = f"[{', '.join(map(_shown, value))}]" if isinstance(value, list) else repr(value)
    return text if len(text) <= _VALUE_LENGTH_SHOWN else text[: _VALUE_LENGTH_SHOWN - 3] + "..."


def _keys(annotation: Any, path: FieldPath) -> list[str]:
    """Return the keys that the model at a path knows."""
    model = _model_of(_annotation_at(annotation, path))
    if model is None:
        return []
    return [field.alias or name for name, field in model.model_fields.items()]


def _allowed(annotation: Any, path: FieldPath) -> str:
    """Describe the values that the schema allows at a path."""
    return _describe(_annotation_at(annotation, path))


def _annotation_at(annotation: Any, path: FieldPath) -> Any:
    """Walk the annotations of the schema along a path."""
    for part in path:
        annotation = _plain(annotation)
        if get_origin(annotation) in (list, dict):
            annotation = get_args(annotation)[-1]
            continue
        model = _model_of(annotation)
        if model is None:
            return annotation
        for name, field in model.model_fields.items():
            if part == (field.alias or name):
                readers = [item for item in field.metadata if isinstance(item, Reads)]
                annotation = readers[0] if readers else field.annotation
    return annotation


def _plain(annotation: Any) -> Any:
    """Drop ``| None``."""
    options = [option for option in get_args(annotation) if option is not type(None)]
    return options[0] if type(None) in get_args(annotation) else annotation


def _model_of(annotation: Any) -> type[BaseModel] | None:
    """Return the model of an annotation, if it is one."""
    annotation = _plain(annotation)
    is_model = isinstance(annotation, type) and issubclass(annotation, BaseModel)
    return annotation if is_model else None


def _describe(annotation: Any) -> str:
    """Describe the values that an annotation accepts."""
    annotation = _plain(annotation)
    if isinstance(annotation, Reads):
        return annotation.allowed
    readers = [item for item in getattr(annotation, "__metadata__", ()) if isinstance(item, Reads)]
    if readers:
        return readers[0].allowed
    model = _model_of(annotation)
    if model is not None:
        keys = ", ".join(field.alias or name for name, field in model.model_fields.items())
        return f"a mapping with {keys}"
    inner = _describe(get_args(annotation)[-1]) if get_args(annotation) else "a value"
    if get_origin(annotation) is list:
        return f"a list, each entry {inner}"
    if get_origin(annotation) is dict:
        return f"a mapping from names, each to {inner}"
    return f"one of {', '.join(map(repr, get_args(annotation)))}" if get_args(annotation) else inner
