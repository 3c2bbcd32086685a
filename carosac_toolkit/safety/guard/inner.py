"""Driver behind a guard: building it, and reading what it reports of itself."""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.drive_state import DriveState, Fault
from carosac_toolkit.loop.plugin_builder import build_plugin, setting_names
from carosac_toolkit.loop.protocols import (
    Driver,
    FaultSource,
    FaultTextSource,
    LinkPatience,
    LinkWatch,
    StatusSource,
    SupportsFaultReset,
    replays,
)
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.safety.guard.checks import Finding
from carosac_toolkit.safety.guard.lifecycle import NotReady
from carosac_toolkit.safety.guard.settings import GuardSettings
from carosac_toolkit.safety.limiter import LimitSettings

SHARED_SETTINGS = ("motion", "period", "suite", "limits")  # of the guard, and of drivers with them
START_SETTING = "start_position"  # of a simulated robot; a real one starts where it is
FAULTS_OF_FIELDS = {  # of a measurement with an impossible number
    "unstrained_length": Fault.ENCODER_JUMP,
    "length": Fault.ENCODER_JUMP,
    "length_rate": Fault.ENCODER_JUMP,
    "set_length": Fault.FOLLOWING_ERROR,
    "tension": Fault.TENSION,
    "time": Fault.STALE_DATA,
}
STATES_OFF = (DriveState.DISCONNECTED, DriveState.CONNECTED, DriveState.HOMED)


def build_inner(
    robot: Robot, settings: GuardSettings, seed: int, *, guard: type
) -> tuple[Driver, bool]:
    """Make the driver behind a guard, and return whether its time is wall-clock time.

    Args:
        robot: Robot description.
        settings: Settings of the guard, which name the driver.
        seed: Seed of everything random in the driver.
        guard: Class of guards, none of which may stand behind another.

    Raises:
        InvalidField: A driver that replays or is a guard, or settings that it does not have.
    """
    plugin = plugins.load("drivers", settings.driver)
    if replays(plugin) or (isinstance(plugin, type) and issubclass(plugin, guard)):
        raise InvalidField("driver", repr(settings.driver), "a driver that moves, and no guard")
    real_time = settings.real_time is not False
    offered = {name: getattr(settings, name) for name in SHARED_SETTINGS} | dict(settings.scene)
    offered["limits"] = _own_limits(plugin, settings.limits)
    if "real_time" in setting_names(plugin):
        real_time = bool(settings.real_time)
        offered |= {"real_time": real_time, START_SETTING: settings.start_position}
    inner: Driver = build_plugin(
        plugin, robot, where="inner", asked=settings.inner, offered=offered, seed=seed
    )
    return inner, real_time


def _own_limits(plugin: Any, limits: LimitSettings) -> Any:
    """Return the limits of a driver by default, with those of the guard where it has no numbers."""
    usual = getattr(plugin.Settings(), "limits", None) if hasattr(plugin, "Settings") else None
    if not isinstance(usual, LimitSettings):
        return usual
    jerk_max = limits.jerk_max if usual.jerk_max is None else usual.jerk_max
    jump_max = limits.jump_max if usual.jump_max is None else usual.jump_max
    return replace(usual, jerk_max=jerk_max, jump_max=jump_max)


def link_patience(inner: Driver) -> float:
    """Return how long a driver waits for its robot [s]; 0 where it does not say."""
    return inner.lost_after if isinstance(inner, LinkPatience) else 0.0


def holds_fault(inner: Driver) -> bool:
    """Return whether the drives hold a fault, or their emergency stop is open, by a live link."""
    if not isinstance(inner, StatusSource):
        return False
    if isinstance(inner, LinkWatch) and inner.link_fault is not Fault.NONE:
        return False
    return inner.status() in (DriveState.FAULT, DriveState.ESTOP)


def inner_finding(inner: Driver, *, following: bool = False) -> Finding | None:
    """Return what a driver says is wrong with itself; `following`: it should be driving."""
    if not isinstance(inner, StatusSource):
        return None
    state = inner.status()
    if state == DriveState.ESTOP:
        return Finding(fault=Fault.DRIVE_TRIP, text="the emergency stop is open")
    if state == DriveState.FAULT:
        fault = inner.fault if isinstance(inner, FaultSource) else Fault.UNKNOWN
        fault = fault if isinstance(fault, Fault) else Fault.UNKNOWN  # whatever a driver says
        text = str(inner.fault_text) if isinstance(inner, FaultTextSource) else ""
        text = text.removesuffix(fault.meaning).removeprefix(str(fault)).strip(": ")
        return Finding(fault=fault, text=text or "the drives hold it")
    if following and state in STATES_OFF:
        text = f"the drives no longer follow: they are {state}, and this host did not disable them"
        return Finding(fault=Fault.DRIVE_TRIP, text=text)
    return None


def reset_held_fault(inner: Driver, tell: Callable[[str, str], None]) -> Finding | None:
    """Clear the fault that a driver holds from an earlier run, and return it; `tell` journals it.

    The robot must be homed afterwards.
    """
    held = inner_finding(inner)
    if held is None or not isinstance(inner, SupportsFaultReset):
        return None
    tell("reset", f"{held.fault}: {held.text}")
    inner.reset_fault()
    return held


def check_no_fault_held(inner: Driver) -> None:
    """Refuse to move drives that hold a fault, as one of an earlier run or case.

    Raises:
        NotReady: They hold one.
    """
    held = inner_finding(inner) if holds_fault(inner) else None
    if held is not None:
        raise NotReady(
            f"enable: the drives hold a fault of before: {held.fault}: {held.text}. "
            f"{held.fault.meaning} Find out why, then reset it (--reset, reset_at_once=True)"
        )


def plugin_finding(part: str, error: BaseException) -> Finding:
    """Return what an error of the estimator, the controller or the program means."""
    fault = Fault.ESTIMATOR if part == "estimator" else Fault.CONTROLLER
    field = error.field.partition("[")[0] if isinstance(error, InvalidField) else ""
    if part != "estimator" and field in ("unstrained_length", "length_rate"):
        fault = Fault.COMMAND
    return Finding(fault=fault, text=f"the {part} raised {type(error).__name__}: {error}")


def interrupted_by_operator(ending: str | None) -> bool:
    """Return whether a `KeyboardInterrupt` can be the operator's, and not that of a plug-in.

    Python itself raises it at Ctrl-C, anywhere in the program; a program with a handler of its own,
    such as ``carosac run``, does so only where an end was asked for already (`ending`).
    """
    return ending is not None or signal.getsignal(signal.SIGINT) is signal.default_int_handler


def error_finding(error: Exception) -> Finding:
    """Return what an error of a driver means: an impossible number, or a lost connection."""
    if isinstance(error, InvalidField):
        fault = FAULTS_OF_FIELDS.get(error.field.partition("[")[0], Fault.UNKNOWN)
        return Finding(fault=fault, text=f"an impossible measurement: {error}")
    return Finding(fault=Fault.LOST_CONNECTION, text=described(error))


def described(error: Exception) -> str:
    """Return the text of an error, with its kind where it is not one of this toolkit."""
    return str(error) if isinstance(error, CarosacError) else f"{type(error).__name__}: {error}"
