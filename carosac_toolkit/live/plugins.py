"""Controller and estimator of a live run, by name, with the settings that were asked for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.settings import filled
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.plugin_settings import check_types
from carosac_toolkit.robot.robot import Robot


def build_controller(
    name: str, robot: Robot, chosen: Mapping[str, Any], period: float, *, seed: int
) -> Any:
    """Make a controller.

    Args:
        name: Registered, or `module:Class`.
        robot: The nominal robot.
        chosen: What `chosen_settings` found.
        period: Of the commands [s], for a controller whose period can be chosen and was not.
        seed: Of everything random in it.
    """
    return _build("controllers", name, robot, chosen, {"period": period}, seed)


def build_estimator(name: str, robot: Robot, chosen: Mapping[str, Any], *, seed: int) -> Any:
    """Make an estimator; arguments as of `build_controller`."""
    return _build("estimators", name, robot, chosen, {}, seed)


def _build(
    kind: plugins.Kind, name: str, robot: Robot, chosen: Mapping[str, Any],
    given: Mapping[str, Any], seed: int,
) -> Any:  # fmt: skip
    """Make a plug-in; `given` holds defaults of settings, as far as it has them."""
    plugin = plugins.load(kind, name)
    asked = dict(chosen[f"{kind[:-1]}_settings"].get(name, {}))
    settings = getattr(plugin, "Settings", None)
    if settings is None:
        if asked:
            raise InvalidField("--set", repr(asked), f"nothing: {name} has no Settings")
        return plugin.build(robot, None, seed=seed)
    known = {field.name for field in fields(settings)}
    wanted = {key: value for key, value in given.items() if key in known} | asked
    check_types(f"{kind[:-1]}.{name}", settings(), wanted)
    return plugin.build(robot, filled(f"{kind[:-1]}.{name}", settings(), wanted), seed=seed)
