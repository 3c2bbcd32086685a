"""Parts of ``carosac run``: guard, path, recording."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from carosac_toolkit import trajectories
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.files import check_writable, missing_folders, remove_empty
from carosac_toolkit.base.settings import filled
from carosac_toolkit.cli.common import sensors_named
from carosac_toolkit.cli.run_options import DEFAULT_TRAJECTORY, Options
from carosac_toolkit.live.hand_target import HandTarget
from carosac_toolkit.live.keyboard import check_input
from carosac_toolkit.live.paced_path import PacedPath
from carosac_toolkit.live.sequence import START_TOLERANCE_M, with_approach
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.loop import ReferenceSource as Followed
from carosac_toolkit.loop.plugin_settings import check_types
from carosac_toolkit.loop.protocols import NamedPlugin, replays
from carosac_toolkit.recordings.crash_safe import CrashSafeRecorder
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.safety.guard import GuardedDriver, GuardSettings
from carosac_toolkit.studies.run.run_case import own_settings
from carosac_toolkit.trajectories import Trajectory
from carosac_toolkit.trajectories.resting import onto_rest

WINCH_RATE_RATIO = 1.5  # of a winch to the platform: 1 by geometry, 1.11 with the tilt at rest
# anywhere in the boxes of the bundled robots, the rest for controllers that damp sway
TENSION_CHECK_SPEED_MAX = 0.05  # [m/s], up to which tensions show a wrong sign
TENSION_SHIFT_MAX = 0.15  # sway at that speed shifts tensions by under 0.1
REST_S = 1.0  # before each part of the way, and after the last
GUARD_KEY = "guard"  # of the guard's settings among those of the driver
PLC_DRIVER = "ads"
FIRST_WAY_KEPT = "no other value: a new home starts slowly and watched"
RESERVED_SETTINGS = {
    "motion": "--enable",
    "period": "--rate, or controller.NAME.period",
    "real_time": "no other value: a live run takes the time of the wall",
    "home_anew": "--home-anew",
    "home_confirmed": "--home-confirmed",
    "home_change_max": "--home-anew, for a pose that was measured",
    "reset_at_once": "--reset",
    "first_way": FIRST_WAY_KEPT,
    "first_speed": FIRST_WAY_KEPT,
    "first_shift_max": FIRST_WAY_KEPT,
}  # which --set may not change, and the option that does


def make_guard(
    robot: Robot, options: Options, chosen: dict[str, Any], period: float, *,
    reset_only: bool = False,
) -> GuardedDriver:  # fmt: skip
    """Make the driver and the guard around it; `reset_only`: clear a fault, enable nothing."""
    plugin = plugins.load("drivers", options.driver)
    if replays(plugin):
        allowed = "a driver that moves; for a recording: carosac compare --driver replay"
        raise InvalidField("--driver", repr(options.driver), allowed)
    guarded = isinstance(plugin, type) and issubclass(plugin, GuardedDriver)
    kind = plugin if guarded else GuardedDriver
    own = own_settings(options.driver, chosen)
    asked = dict(own.pop(GUARD_KEY, {}))
    if guarded:
        asked |= own
    else:
        asked |= {"driver": options.driver, "inner": own}
    settings: GuardSettings = kind.Settings()
    _refuse_reserved(asked)
    if (
        options.enable
        and options.home is None
        and isinstance(plugin, NamedPlugin)
        and (plugin.name == PLC_DRIVER)
    ):
        allowed = "--home X Y Z, where the platform stands: homing relies on it"
        raise InvalidField("--home", "none", allowed)
    check_types("driver.guard", settings, asked)
    slow = options.speed <= TENSION_CHECK_SPEED_MAX
    home = options.home or tuple(float(x) for x in robot.home_position)
    wanted = {
        "period": period, "suite": options.sensors, "motion": options.enable or reset_only,
        "start_position": home, "home_anew": options.home_anew,
        "home_confirmed": options.home_confirmed,
        "rehearse": options.home is not None and not reset_only, "enable_at_once": not reset_only,
        "reset_at_once": options.reset, "real_time": True,
        "speed_max": WINCH_RATE_RATIO * options.speed,
        "tension_shift_max": TENSION_SHIFT_MAX if slow else None,
        "first_shift_max": TENSION_SHIFT_MAX,
        **asked,
    }  # fmt: skip
    with sensors_named():
        made = filled("driver.guard", settings, wanted)
        return kind.build(robot, made, seed=options.seed)


def _refuse_reserved(asked: dict[str, Any]) -> None:
    """Refuse settings of the guard, or of the driver behind it, that belong to an option."""
    inner = asked.get("inner", {})
    inner = inner if isinstance(inner, Mapping) else {}
    for name, option in RESERVED_SETTINGS.items():
        for values in (asked, inner):
            if name in values:
                raise InvalidField("--set", f"driver ... {name}={values[name]!r}", option)
    if "start_position" in asked:
        raise InvalidField("--set", "start_position of the guard", "--home X Y Z")


def make_path(robot: Robot, options: Options) -> Followed:
    """Return what is followed, from where the platform stands."""
    start = np.asarray(options.home or robot.home_position, dtype=float)
    limits = {"speed_max": options.speed, "acceleration_max": options.acceleration}
    for name, value in {**limits, "duration": options.duration}.items():
        if value is not None and not 0.0 < value < np.inf:
            raise InvalidField(f"--{name.removesuffix('_max')}", str(value), "> 0, finite")
    if options.to is not None and (options.by_hand or options.trajectory != DEFAULT_TRAJECTORY):
        raise InvalidField("--to", "also --by-hand or --trajectory", "one of the three")
    if options.by_hand:
        check_input("--by-hand")
        return HandTarget(robot, start, **limits)
    if options.to is not None:
        return with_approach(_move(robot, start, options.to, limits), start, rest=REST_S, **limits)
    path = trajectories.build(options.trajectory, robot, options.seed, **limits)
    return with_approach(path, start, rest=REST_S, **limits)


def paced(path: Followed, options: Options, guard: GuardedDriver) -> PacedPath:
    """Return the path by cycles, slow while the guard watches the first way after a new home."""
    if options.speed <= TENSION_CHECK_SPEED_MAX or not guard.settings.motion:
        return PacedPath(path)
    return PacedPath(
        path, slow=lambda: guard.monitor.checks.first_way, slow_speed=TENSION_CHECK_SPEED_MAX,
        speed=options.speed, acceleration=options.acceleration,
    )  # fmt: skip


def _move(
    robot: Robot, start: Array, end: tuple[float, float, float], limits: dict[str, float]
) -> Trajectory:
    """Return a straight move between positions [m]; only its start may be outside the box."""
    goal = np.asarray(end, dtype=float)
    low, high = robot.workspace_min, robot.workspace_max
    got = " ".join(f"{x:g}" for x in end) + " m"
    if not ((goal >= low) & (goal <= high)).all():
        box = " to ".join(f"({', '.join(f'{x:g}' for x in corner)})" for corner in (low, high))
        raise InvalidField("--to", got, f"{box} m, the workspace box")
    if np.linalg.norm(goal - start) < START_TOLERANCE_M:
        raise InvalidField("--to", got, "another place than where the platform stands (--home)")
    return onto_rest(robot, trajectories.minimum_snap(np.stack([start, goal]), **limits))


@contextlib.contextmanager
def recorded(options: Options) -> Iterator[CrashSafeRecorder]:
    """Yield the recorder of the run; nothing is left of it where nothing was measured."""
    path = options.output
    check_writable("--output", path, (".jsonl",))
    made: list[Path] = []
    if path is None:
        folder = Path("carosac-results/run")
        made = missing_folders(folder)
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / time.strftime("%Y%m%d-%H%M%S.jsonl")
    words = f"{options.controller} with {options.estimator} on {options.driver}"
    recorder = CrashSafeRecorder(path, robot=options.robot, description=words)
    try:
        yield recorder
    except BaseException:
        if recorder.samples == 0:
            recorder.discard()
            remove_empty(made)
        raise
    finally:
        recorder.close()
