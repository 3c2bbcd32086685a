"""Settings of a preset, changed one by one as text: ``td3.target_rate=0.02``."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.settings import filled
from carosac_toolkit.loop.plugin_settings import SET_OPTION, check_types, put_field, value_of
from learned.presets import Stage

VARY_OPTION = "--vary"
STAGE_PARTS = ("td3", "environment")  # of a stage
LABEL_LENGTH_MAX = 90  # characters of a label

Changes = Mapping[str, Any]
"""Values as JSON has them, by path: ``td3.FIELD``, ``environment.FIELD`` or one of these behind the
name of a stage. A field of settings inside other settings is behind another dot."""


def read_changes(texts: Sequence[str], stages: Sequence[str]) -> dict[str, Any]:
    """Read ``PATH=VALUE``; a value is JSON, or text where it is none.

    Args:
        texts: One change each.
        stages: Names of all stages of the preset.

    Raises:
        InvalidField: A text of another form, or a path twice.
    """
    changes: dict[str, Any] = {}
    for text in texts:
        path, value = _read(SET_OPTION, text, stages)
        if path in changes:
            raise InvalidField(SET_OPTION, repr(text), "each field once")
        changes[path] = value
    return changes


def read_variations(
    texts: Sequence[str], stages: Sequence[str], fixed: Changes
) -> list[dict[str, Any]]:
    """Read ``PATH=[VALUE, VALUE, ...]`` and combine each value with each of the others.

    Args:
        texts: One path each.
        stages: Names of all stages of the preset.
        fixed: What is changed in all of them.

    Returns:
        The changes of each combination; one without changes if nothing is varied.

    Raises:
        InvalidField: A text of another form, a path twice, or values that are the same.
    """
    axes: dict[str, list[Any]] = {}
    for text in texts:
        path, values = _read(VARY_OPTION, text, stages)
        if path in axes or path in fixed:
            raise InvalidField(
                VARY_OPTION, repr(text), f"each field once, in {SET_OPTION} or in {VARY_OPTION}"
            )
        if not isinstance(values, list) or len(values) < 2:
            allowed = "FIELD=[VALUE, VALUE, ...], a JSON list of two or more values"
            raise InvalidField(VARY_OPTION, repr(text), allowed)
        if len({label_of({path: x}) for x in values}) < len(values):
            raise InvalidField(VARY_OPTION, repr(text), "values that differ, in letters and digits")
        axes[path] = values
    return [dict(zip(axes, values, strict=True)) for values in product(*axes.values())]


def check_changes(stages: Mapping[str, Stage], fixed: Changes, varied: Sequence[Changes]) -> None:
    """Make sure that all stages could be trained, also those that are not trained now.

    Raises:
        InvalidField: A field that is not there, or a value that is not allowed.
    """
    for some in varied:
        for name, stage in stages.items():
            changed(name, stage, {**fixed, **some})


def changed(name: str, stage: Stage, changes: Changes) -> Stage:
    """Return a stage with the changes that concern it.

    Args:
        name: Of the stage.
        stage: As the preset has it.
        changes: Those of other stages are left out.

    Raises:
        InvalidField: A field that is not there, or a value that is not allowed.
    """
    nested: dict[str, Any] = {}
    for path, value in changes.items():
        fields = path.split(".")
        if fields[0] not in STAGE_PARTS and fields.pop(0) != name:
            continue
        put_field(path, nested, fields, _with_tuples(value))
    check_types(name, stage, nested)
    changed_stage: Stage = filled(name, stage, nested)
    return changed_stage


def label_of(changes: Changes) -> str:
    """Return a short label of changes for names of folders, in the order of their paths.

    What would be too long for a file system ends in a digest of all of it.
    """
    label = "_".join(f"{_short(path)}={_plain(value)}" for path, value in sorted(changes.items()))
    if len(label) <= LABEL_LENGTH_MAX:
        return label
    return f"{label[: LABEL_LENGTH_MAX - 9]}-{hashlib.sha256(label.encode()).hexdigest()[:8]}"


def concerned(stage: str, stages: Sequence[str], changes: Changes) -> dict[str, Any]:
    """Return the changes that a stage depends on: its own, and those of stages before it.

    Args:
        stage: Its name.
        stages: All of the preset, in their order.
        changes: Of any stages.
    """
    until = stages[: stages.index(stage) + 1]
    return {
        path: value
        for path, value in changes.items()
        if path.split(".")[0] in STAGE_PARTS or path.split(".")[0] in until
    }


def _read(option: str, text: str, stages: Sequence[str]) -> tuple[str, Any]:
    """Read path and value of a change."""
    path, equals, value = text.partition("=")
    first, *rest = path.split(".")
    known = first.replace("-", "_")
    fields = rest[1:] if known in stages else rest
    part = rest[0] if known in stages and rest else first
    if not equals or part not in STAGE_PARTS or not fields or not all(fields):
        names = " or ".join(name.replace("_", "-") for name in stages)
        allowed = f"[STAGE.]td3.FIELD=VALUE or [STAGE.]environment.FIELD=VALUE, STAGE {names}"
        raise InvalidField(option, repr(text), allowed)
    path = ".".join([known if known in stages else first, *rest])
    return path, value_of(option, text, value)


def _short(path: str) -> str:
    """Return a path without the part that goes without saying."""
    return ".".join(name for name in path.split(".") if name not in STAGE_PARTS)


def _plain(value: Any) -> str:
    """Write a value in letters that every file system has."""
    text = json.dumps(value, separators=(",", ":"), sort_keys=True).replace(",", "+")
    return re.sub(r"[^A-Za-z0-9_.+-]", "", text)


def _with_tuples(value: Any) -> Any:
    """Copy a JSON value with its lists as tuples, at any depth."""
    if isinstance(value, list):
        return tuple(_with_tuples(item) for item in value)
    if isinstance(value, dict):
        return {name: _with_tuples(item) for name, item in value.items()}
    return value
