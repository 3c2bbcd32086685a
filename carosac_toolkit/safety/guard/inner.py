"""The driver behind a guard: how it is built, what it says of itself, and lengths of a pose."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array, frozen_array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.settings import filled
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.drive_state import DriveState, Fault
from carosac_toolkit.loop.protocols import replays
from carosac_toolkit.loop.values import State
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.safety.guard.checks import FREE, Finding
from carosac_toolkit.safety.guard.settings import GuardSettings

HANDED_ON = ("motion", "period", "suite", "wind_force", "wind_time")
SET_DOWN = "start_position"  # of a simulated robot; no real one is set down anywhere
OFF = (DriveState.DISCONNECTED, DriveState.CONNECTED, DriveState.HOMED)  # nothing follows there


def build_inner(robot: Robot, settings: GuardSettings, seed: int) -> tuple[Any, bool]:
    """Make the driver behind a guard, and say whether its time is that of the wall."""
    plugin = plugins.load("drivers", settings.driver)
    if replays(plugin) or plugin.__module__ == "carosac_toolkit.safety.guard.guard":
        raise InvalidField("driver", repr(settings.driver), "a driver that moves, and no guard")
    kind = getattr(plugin, "Settings", None)
    if kind is None:
        if settings.inner:
            raise InvalidField("inner", repr(settings.inner), f"nothing: {settings.driver} has no "
                               "Settings")  # fmt: skip
        return plugin.build(robot, None, seed=seed), settings.real_time is not False
    known = {field.name for field in fields(kind)}
    wanted = {name: getattr(settings, name) for name in HANDED_ON if name in known}
    real_time = settings.real_time is not False
    if "real_time" in known:
        real_time = bool(settings.real_time)
        wanted["real_time"] = real_time
        if SET_DOWN in known:
            wanted[SET_DOWN] = settings.start_position
    chosen = filled("inner", kind(), {**wanted, **settings.inner})
    return plugin.build(robot, chosen, seed=seed), real_time


def holds_fault(inner: Any) -> bool:
    """Whether the drives hold a fault, or their emergency stop is open, by a live connection."""
    status = getattr(inner, "status", None)
    if status is None or getattr(inner, "link_fault", Fault.NONE) is not Fault.NONE:
        return False
    return status() in (DriveState.FAULT, DriveState.ESTOP)


def inner_finding(inner: Any, *, following: bool = False) -> Finding | None:
    """What a driver that knows its own state says is wrong; `following`: it should be driving."""
    status = getattr(inner, "status", None)
    if status is None:
        return None
    said = status()
    if said == DriveState.ESTOP:
        return Finding(fault=Fault.DRIVE_TRIP, text="the emergency stop is open")
    if said == DriveState.FAULT:
        fault = getattr(inner, "fault", None)
        known = fault if isinstance(fault, Fault) else Fault.UNKNOWN
        told = str(getattr(inner, "fault_text", "")).removesuffix(known.meaning)
        told = told.removeprefix(str(known)).strip(": ")
        return Finding(fault=known, text=told or "the drives hold it")
    if following and said in OFF:
        text = f"the drives no longer follow: they are {said}, and nobody here switched them off"
        return Finding(fault=Fault.DRIVE_TRIP, text=text)
    return None


def error_finding(error: Exception) -> Finding:
    """What an error of a driver means: an impossible number, or a connection that is lost."""
    if isinstance(error, InvalidField):
        length = "length" in error.field
        text = f"a measurement that cannot be: {error}"
        return Finding(fault=Fault.ENCODER_JUMP if length else Fault.UNKNOWN, text=text)
    return Finding(fault=Fault.LOST_CONNECTION, text=described(error))


def described(error: Exception) -> str:
    """An error in words, with its kind where it is none of this toolkit."""
    return str(error) if isinstance(error, CarosacError) else f"{type(error).__name__}: {error}"


def homing_lengths(robot: Robot, position: State) -> Array:
    """Lengths of a pose of rest [m], shape (n,).

    Raises:
        InvalidField: More than one pose, or none at rest there.
    """
    if len(position.position) != 1:
        raise InvalidField("position", f"{len(position.position)} poses", "one pose")
    if position.unstrained_length is not None:
        lengths = frozen_array("unstrained_length", position.unstrained_length, (1, robot.n))
        return np.array(lengths[0])
    rotation = position.rotation if robot.n >= FREE else None
    found = statics.inverse_kinematics(robot, position.position, rotation)
    if not found.converged[0]:
        where = np.round(position.position[0], 4).tolist()
        raise InvalidField("position", f"{where} m", "a pose at which the platform can rest")
    return np.array(found.unstrained_length[0])
