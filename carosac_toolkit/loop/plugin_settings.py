"""Settings of plug-ins and driver, chosen one by one as text: ``controller.mpc.stages=20``."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import is_dataclass
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from carosac_toolkit.base.errors import InvalidField

SET_OPTION = "--set"
SETTING_FORMS = "controller.NAME.FIELD=VALUE, estimator.NAME.FIELD=VALUE or driver.FIELD=VALUE"


def chosen_settings(
    texts: Sequence[str], *, controllers: Sequence[str], estimators: Sequence[str]
) -> dict[str, Any]:
    """Read settings.

    Args:
        texts: One setting each. A field of a settings dataclass inside another one is written with
            a dot. Values are JSON; what is not is text.
        controllers: Names that may be meant; they may have dots in them.
        estimators: The same.

    Returns:
        ``controller_settings`` and ``estimator_settings`` by name, and ``driver_settings``.

    Raises:
        InvalidField: A text of another form, a plug-in that is not in the study, or a field twice.
    """
    kinds = ("controller", "estimator", "driver")
    chosen: dict[str, Any] = {f"{kind}_settings": {} for kind in kinds}
    for text in texts:
        path, equals, value = text.partition("=")
        kind, dot, rest = path.partition(".")
        if not equals or not dot or f"{kind}_settings" not in chosen:
            raise InvalidField(SET_OPTION, repr(text), SETTING_FORMS)
        into, fields = chosen[f"{kind}_settings"], rest
        if kind != "driver":
            name = _name(text, kind, rest, controllers if kind == "controller" else estimators)
            into, fields = into.setdefault(name, {}), rest[len(name) + 1 :]
        names = fields.split(".")
        if not all(names):
            raise InvalidField(SET_OPTION, repr(text), SETTING_FORMS)
        put_field(text, into, names, value_of(SET_OPTION, text, value))
    return chosen


def _name(text: str, kind: str, rest: str, names: Sequence[str]) -> str:
    """Return the plug-in named at the start of a setting: the longest name that fits."""
    fitting = [name for name in names if rest.startswith(f"{name}.")]
    if not fitting:
        allowed = f"{kind}.NAME.FIELD=VALUE with a NAME of {list(names)}"
        raise InvalidField(SET_OPTION, repr(text), allowed)
    return max(fitting, key=len)


def put_field(text: str, into: dict[str, Any], fields: Sequence[str], value: Any) -> None:
    """Put a value where its fields lead.

    Args:
        text: What was asked, for messages.
        into: Settings by field, nested; changed.
        fields: Names, the outermost first.
        value: What the last one becomes.

    Raises:
        InvalidField: The field has a value already, or one on the way to it has.
    """
    *outer, last = fields
    for field in outer:
        into = into.setdefault(field, {})
        if not isinstance(into, dict):
            raise InvalidField(SET_OPTION, repr(text), "each field once")
    if last in into:
        raise InvalidField(SET_OPTION, repr(text), "each field once")
    into[last] = value


def value_of(option: str, whole: str, text: str) -> Any:
    """Return the value behind the equals sign: JSON, or the text itself.

    Args:
        option: For messages.
        whole: All of the setting, for messages.
        text: The value.

    Raises:
        InvalidField: A number that is not finite.
    """

    def refuse(constant: str) -> None:
        raise InvalidField(option, repr(whole), f"finite numbers, not {constant}")

    try:
        return json.loads(text, parse_constant=refuse)
    except (ValueError, RecursionError):  # too many digits or brackets are text too
        return text


def check_types(where: str, settings: Any, values: Mapping[str, Any]) -> None:
    """Refuse values of another kind than their fields, before anybody calculates with them.

    Fields that are not there are left to others, as are fields of a kind that is not known here.

    Args:
        where: What the fields belong to, for messages.
        settings: Instance of a settings dataclass.
        values: By field; a mapping for a settings dataclass inside.

    Raises:
        InvalidField: A value is of another kind.
    """
    try:
        hints = get_type_hints(type(settings))
    except (NameError, TypeError):  # types that only a type checker sees: the default must do
        hints = {}
    for name, value in values.items():
        if not hasattr(settings, name):
            continue
        usual, field = getattr(settings, name), f"{where}.{name}"
        if is_dataclass(usual) and isinstance(value, Mapping):
            check_types(field, usual, value)
            continue
        hint = hints.get(name, type(usual))
        if not _fits(value, hint, usual):
            raise InvalidField(field, repr(value), _kind(hint, usual))


_SIMPLE_TYPES = {bool: "true or false", int: "a whole number", float: "a number", str: "text",
           NoneType: "null"}  # fmt: skip


def _fits(value: Any, hint: Any, usual: Any) -> bool:
    """Return whether a value is of a kind; `usual` is the default, with the shape of arrays."""
    origin, parts = get_origin(hint), get_args(hint)
    if hint in _SIMPLE_TYPES:
        return _simple(value, hint)
    if origin in (Union, UnionType):
        return any(_fits(value, part, usual) for part in parts)
    if origin is Literal:
        return any(type(value) is type(part) and value == part for part in parts)
    if origin is tuple:
        return _is_list(value) and _items_fit(list(value), parts)
    if np.ndarray in (hint, origin):
        return _is_list(value) and _shape(value) == np.shape(usual)
    return isinstance(value, hint) if isinstance(hint, type) else True


def _simple(value: Any, hint: Any) -> bool:
    """Return whether a value is of a simple kind; true is no number, and 2 is a float too."""
    truth = isinstance(value, bool | np.bool_)
    if hint is float or hint is int:
        return not truth and isinstance(value, Real if hint is float else Integral)
    return truth if hint is bool else isinstance(value, hint)


def _items_fit(items: list[Any], parts: tuple[Any, ...]) -> bool:
    """Return whether items fit the parts of a tuple."""
    if len(parts) == 2 and parts[1] is Ellipsis:
        return all(_fits(item, parts[0], None) for item in items)
    return len(items) == len(parts) and all(
        _fits(item, part, None) for item, part in zip(items, parts, strict=True)
    )


def _is_list(value: Any) -> bool:
    return isinstance(value, list | tuple | np.ndarray)


def _shape(value: Any) -> tuple[int, ...] | None:
    """Return the shape of nested lists of numbers; None of anything else."""
    try:
        array = np.asarray(value)
    except ValueError:  # rows of several lengths
        return None
    return array.shape if array.dtype.kind in "iuf" else None


def _kind(hint: Any, usual: Any) -> str:
    """Describe what would have been accepted."""
    origin, parts = get_origin(hint), get_args(hint)
    if hint in _SIMPLE_TYPES:
        return _SIMPLE_TYPES[hint]
    if origin in (Union, UnionType):
        return " or ".join(_kind(part, usual) for part in parts)
    if origin is Literal:
        return f"one of {list(parts)}"
    if origin is tuple and parts[-1:] == (Ellipsis,):
        return f"a list, each of it {_kind(parts[0], None)}"
    if origin is tuple:
        return f"a list: [{', '.join(_kind(part, None) for part in parts)}]"
    if np.ndarray in (hint, origin):
        return f"{' x '.join(map(str, np.shape(usual)))} numbers, as [...]"
    if is_dataclass(usual):
        return "fields of it, each by its own name"
    return str(getattr(hint, "__name__", hint))
