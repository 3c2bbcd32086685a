"""Checks of what a study names: plug-ins that exist, settings they have, numbers in range."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from carosac_toolkit.base.errors import CarosacError, InvalidField, did_you_mean
from carosac_toolkit.base.settings import filled
from carosac_toolkit.drivers.sensor_suite import check_pulleys
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.plugin_settings import check_types
from carosac_toolkit.loop.protocols import replays
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.studies.run.run_case import plugin_name

RECORDED_TRAJECTORY = "recorded"  # the path of a recording, the only one on a driver that replays


def check_positive(name: str, value: Any, unit: str) -> None:
    """Refuse anything but a positive finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InvalidField(name, repr(value), f"a number [{unit}]")
    if not (value > 0.0 and np.isfinite(value)):
        raise InvalidField(name, f"{value} {unit}", f"{name} > 0, finite")


def check_known(field: str, names: Any, allowed: Sequence[str], *, more: str = "") -> None:
    """Refuse names that are not in a list; `more` says what else is allowed."""
    for name in names:
        if name not in allowed:
            choices = f"one of {list(allowed)}{more}{did_you_mean(name, allowed)}"
            raise InvalidField(field, repr(name), choices)


def find_plugin(kind: Any, name: str) -> Any:
    """Import a plug-in; whatever its import raises becomes one message.

    Raises:
        CarosacError: Its label is empty, it is not there, cannot be imported or has no `build`.
    """
    _, at, label = name.partition("@")
    if at and not label:
        raise InvalidField(kind[:-1], repr(name), "NAME, or NAME@LABEL with a label")
    try:
        plugin = plugins.load(kind, plugin_name(name))
    except InvalidField as error:
        if kind != "estimators":
            raise
        allowed = f"'truth' of a simulated driver, {error.allowed}{did_you_mean(name, ['truth'])}"
        raise InvalidField(error.field, error.value, allowed) from error
    except CarosacError:
        raise
    except Exception as error:
        raise CarosacError(
            f"{kind[:-1]} '{name}': its import raised {type(error).__name__}: {error}"
        ) from error
    if not callable(getattr(plugin, "build", None)):
        raise InvalidField(kind[:-1], repr(name), "a class with build(robot, settings, *, seed)")
    return plugin


def check_sensors(driver: Any, name: str, sensors: Sequence[str]) -> None:
    """Refuse sensors that the driver does not have."""
    kinds = getattr(driver, "Settings", None)
    has_choice = is_dataclass(kinds) and "suite" in {field.name for field in fields(kinds)}
    for suite in sensors:
        if not has_choice and suite != "lengths":
            allowed = f"'lengths': driver {name} has no choice of sensors"
            raise InvalidField("sensors", repr(suite), allowed)
        if has_choice:
            try:
                replace(kinds(), suite=suite)  # type: ignore[misc]
            except InvalidField as error:
                raise InvalidField("sensors", error.value, error.allowed) from error


def check_swivels(robots: Sequence[Robot], sensors: Sequence[str]) -> None:
    """Refuse swivel encoders on simulated robots without pulleys."""
    for robot, suite in product(robots, sensors):
        if "swivel" in suite.split("+"):
            check_pulleys(robot, "sensors", repr(suite), "one without swivel")


def check_settings(field: str, name: str, plugin: Any, wanted: Mapping[str, Any]) -> None:
    """Refuse settings that a plug-in does not have."""
    check = getattr(plugin, "check_settings", None)
    if not wanted and check is None:
        return
    kinds = getattr(plugin, "Settings", None)
    if not is_dataclass(kinds):
        raise InvalidField(field, repr(dict(wanted)), f"nothing: {name} has no settings")
    where, usual = f"{field} of {name}", kinds()  # type: ignore[operator]
    check_known(where, wanted, sorted(item.name for item in fields(kinds)))
    check_types(where, usual, wanted)
    try:
        chosen = filled(where, usual, wanted)
    except TypeError as error:
        raise InvalidField(field, repr(dict(wanted)), f"settings of {name}: {error}") from error
    if check is not None:
        _ask(name, check, chosen)


def _ask(name: str, check: Any, chosen: Any) -> None:
    """Let a plug-in check its settings; whatever that raises becomes one message."""
    try:
        check(chosen)
    except CarosacError:
        raise
    except Exception as error:
        message = f"{name}: check_settings raised {type(error).__name__}: {error}"
        raise CarosacError(message) from error


def check_truth(driver: Any, name: str) -> None:
    """Refuse the estimator `truth` where the driver knows no truth."""
    if replays(driver) or not callable(getattr(driver, "truth", None)):
        raise InvalidField("estimator", "'truth'", f"another one: driver {name} knows no truth")
