"""Settings of plug-ins and driver, chosen one by one as text: ``controller.mpc.horizon=0.5``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from carosac_toolkit.errors import InvalidField

OPTION = "--set"
FORMS = "controller.NAME.FIELD=VALUE, estimator.NAME.FIELD=VALUE or driver.FIELD=VALUE"


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
    chosen: dict[str, Any] = {f"{kind}_settings": {} for kind in ("controller", "estimator")}
    chosen["driver_settings"] = {}
    for text in texts:
        path, equals, value = text.partition("=")
        kind, dot, rest = path.partition(".")
        if not equals or not dot or f"{kind}_settings" not in chosen:
            raise InvalidField(OPTION, repr(text), FORMS)
        into, fields = chosen[f"{kind}_settings"], rest
        if kind != "driver":
            name = _name(text, kind, rest, controllers if kind == "controller" else estimators)
            into, fields = into.setdefault(name, {}), rest[len(name) + 1 :]
        _put(text, into, fields.split("."), _value(text, value))
    return chosen


def _name(text: str, kind: str, rest: str, names: Sequence[str]) -> str:
    """The plug-in that is meant: the longest name that fits."""
    found = [name for name in names if rest.startswith(f"{name}.")]
    if not found:
        allowed = f"{kind}.NAME.FIELD=VALUE with a NAME of {list(names)}"
        raise InvalidField(OPTION, repr(text), allowed)
    return max(found, key=len)


def _put(text: str, into: dict[str, Any], fields: Sequence[str], value: Any) -> None:
    """Put a value where its fields lead."""
    *outer, last = fields
    if not all(fields):
        raise InvalidField(OPTION, repr(text), FORMS)
    for field in outer:
        into = into.setdefault(field, {})
        if not isinstance(into, dict):
            raise InvalidField(OPTION, repr(text), "each field once")
    if last in into:
        raise InvalidField(OPTION, repr(text), "each field once")
    into[last] = value


def _value(whole: str, text: str) -> Any:
    """JSON, or the text itself."""

    def refuse(constant: str) -> None:
        raise InvalidField(OPTION, repr(whole), f"finite numbers, not {constant}")

    try:
        return json.loads(text, parse_constant=refuse)
    except json.JSONDecodeError:
        return text
