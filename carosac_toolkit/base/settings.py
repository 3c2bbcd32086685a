"""Settings dataclasses with some fields replaced by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any

from carosac_toolkit.base.errors import InvalidField, did_you_mean


def filled(where: str, settings: Any, values: Mapping[str, Any]) -> Any:
    """Replace some fields of settings; fields that are settings themselves are filled too."""
    known = {field.name for field in fields(settings)}
    chosen: dict[str, Any] = {}
    for name, value in values.items():
        if name not in known:
            allowed = f"one of {sorted(known)}{did_you_mean(name, sorted(known))}"
            raise InvalidField(f"{where}.{name}", repr(value), allowed)
        inner = getattr(settings, name)
        nested = is_dataclass(inner) and isinstance(value, Mapping)
        chosen[name] = filled(f"{where}.{name}", inner, value) if nested else value
    return replace(settings, **chosen)
