"""Builds plug-ins with their settings, for studies, live runs, guards, emulators and validation."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import fields
from types import MappingProxyType
from typing import Any

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.settings import filled
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.plugin_errors import exit_refused
from carosac_toolkit.loop.plugin_settings import check_types
from carosac_toolkit.robot.robot import Robot

NO_SETTINGS: Mapping[str, Any] = MappingProxyType({})


def build_plugin(
    plugin: Any, robot: Robot | Sequence[Robot], *, where: str,
    asked: Mapping[str, Any] = NO_SETTINGS, offered: Mapping[str, Any] = NO_SETTINGS, seed: int = 0,
    seeds: Sequence[int] | None = None, settle: Callable[[Any], Any] | None = None,
) -> Any:  # fmt: skip
    """Build a plug-in with its own settings.

    Args:
        plugin: What `carosac_toolkit.loop.plugins.load` found.
        robot: Its robot; several for a driver that simulates a batch.
        where: Name of the settings in error messages.
        asked: Fields of its settings that the user set; they win over `offered`.
        offered: What the caller knows, for as many fields as the settings have; a switch for those
            that are switches.
        seed: Of everything random in it.
        seeds: Of a driver that simulates a batch, one for each robot.
        settle: Changes the settings before it is built, such as for the size of another robot.

    Raises:
        InvalidField: `asked` names a field that the settings do not have, or a value of another
            type.
        BadPlugin: It called `sys.exit()`.
    """
    settings = settings_of(plugin, where=where, asked=asked, offered=offered)
    if settle is not None and settings is not None:
        settings = settle(settings)
    with exit_refused(where, plugin):
        if seeds is not None:
            return plugin.build_batch(robot, settings, seeds=seeds)
        return plugin.build(robot, settings, seed=seed)


def settings_of(
    plugin: Any, *, where: str, asked: Mapping[str, Any] = NO_SETTINGS,
    offered: Mapping[str, Any] = NO_SETTINGS,
) -> Any:  # fmt: skip
    """Return the settings that a plug-in is built with, or None if it has no ``Settings``.

    Arguments and errors are those of `build_plugin`.
    """
    kind = getattr(plugin, "Settings", None)
    if kind is None:
        if asked:
            name = getattr(plugin, "__name__", repr(plugin))  # an instance has none
            raise InvalidField(where, dict(asked), f"nothing: {name} has no Settings")
        return None
    usual, names = kind(), setting_names(plugin)
    check_types(where, usual, asked)
    known = {
        name: value
        for name, value in offered.items()
        if name in names and (isinstance(getattr(usual, name), bool) or not isinstance(value, bool))
    }
    return filled(where, usual, {**known, **asked})


def setting_names(plugin: Any) -> set[str]:
    """Return the names of a plug-in's settings; none where it has no ``Settings``."""
    kind = getattr(plugin, "Settings", None)
    return {field.name for field in fields(kind)} if kind is not None else set()


def build_controller(
    name: str, robot: Robot, chosen: Mapping[str, Any], period: float, *, seed: int
) -> Any:
    """Build a controller of a live run.

    Args:
        name: Registered, or ``module:Class``.
        robot: The nominal robot.
        chosen: Result of `carosac_toolkit.loop.plugin_settings.chosen_settings`.
        period: Of the commands [s], for a controller whose period can be chosen and was not.
        seed: Of everything random in it.
    """
    asked = chosen["controller_settings"].get(name, {})
    plugin, where = plugins.load("controllers", name), f"controller.{name}"
    offered = {"period": period}
    return build_plugin(plugin, robot, where=where, asked=asked, offered=offered, seed=seed)


def build_estimator(
    name: str, robot: Robot, chosen: Mapping[str, Any], *, sensors: str, seed: int
) -> Any:
    """Build an estimator of a live run, which uses the swivel encoders and so on of the sensors.

    Args:
        name: As of `build_controller`, and so are others.
        robot: The same.
        chosen: The same.
        sensors: Suite of the driver.
        seed: The same.
    """
    asked = chosen["estimator_settings"].get(name, {})
    plugin, where = plugins.load("estimators", name), f"estimator.{name}"
    offered = uses_of(sensors.split("+"))
    return build_plugin(plugin, robot, where=where, asked=asked, offered=offered, seed=seed)


def uses_of(sensors: Collection[str], *, simulated: bool = True) -> dict[str, Any]:
    """Return settings by which estimators use some sensors where these are there.

    Load cells are not among them: their scales may be off. How an AHRS or inclinometer is mounted
    is known of simulated ones alone, which have the axes of the platform.

    Args:
        sensors: Those that are there, by their names in suites.
        simulated: Whether they are simulated.
    """
    uses: dict[str, Any] = {"swivels": "swivel" in sensors}
    if simulated and ("attitude" in sensors or "inclination" in sensors):
        uses["attitude_rotation"] = (0.0, 0.0, 0.0)
    return uses
