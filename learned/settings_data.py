"""Settings of an environment from the plain data that a policy keeps."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from carosac_toolkit.base.errors import InvalidField
from learned.environment import EnvironmentSettings
from learned.moving_worlds import MovingSettings
from learned.observation import SCALED_PARTS, ObservationUnits
from learned.target_paths import PathSettings

_PARTS = {"path": PathSettings, "moving": MovingSettings, "units": ObservationUnits}


def environment_settings(settings: dict[str, Any]) -> EnvironmentSettings:
    """Read the entry ``environment`` of a training's settings.

    Its reward is left out: what a policy was rewarded for does not change what it does, and terms
    of a user's own need not be known.

    Raises:
        InvalidField: It is not there, or has fields that this version does not know.
    """
    data = settings.get("environment")
    if not isinstance(data, dict):
        raise InvalidField("settings.environment", data, "the settings of an environment")
    if "units" not in data and SCALED_PARTS & set(data.get("observation", ())):
        allowed = "the units of the observation, which old policies lack: train it again"
        raise InvalidField("settings.environment.units", None, allowed)
    values = {name: _tuple(value) for name, value in data.items() if name != "reward"}
    for name, kind in _PARTS.items():
        part = {key: _tuple(value) for key, value in data.get(name, {}).items()}
        _check_names(f"settings.environment.{name}", part, kind)
        values[name] = kind(**part)
    _check_names("settings.environment", values, EnvironmentSettings)
    return EnvironmentSettings(**values)


def _check_names(where: str, values: dict[str, Any], kind: Any) -> None:
    """Refuse fields that a settings class does not have."""
    known = {f.name for f in fields(kind)}
    for name in values:
        if name not in known:
            raise InvalidField(f"{where}.{name}", values[name], f"fields of {sorted(known)}")


def _tuple(value: Any) -> Any:
    """Convert lists of JSON to tuples."""
    return tuple(value) if isinstance(value, list) else value
