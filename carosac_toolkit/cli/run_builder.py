"""What ``carosac run`` is made of: guard, path, recording."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from carosac_toolkit import trajectories
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.settings import filled
from carosac_toolkit.drivers.guard_settings import GuardSettings
from carosac_toolkit.drivers.guarded import GuardedDriver
from carosac_toolkit.live.hand_target import HandTarget
from carosac_toolkit.live.keyboard import check_input
from carosac_toolkit.live.sequence import NEAR, with_approach
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.loop import ReferenceSource as Followed
from carosac_toolkit.loop.plugin_settings import check_types
from carosac_toolkit.loop.protocols import replays
from carosac_toolkit.output_files import missing_folders, remove_empty
from carosac_toolkit.recordings.crash_safe import CrashSafeRecorder
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.studies.run.run_case import own_settings
from carosac_toolkit.trajectories import Trajectory

if TYPE_CHECKING:
    from carosac_toolkit.cli.run import Options

WINCH = 1.5  # rate of a winch over the speed of the platform: 1 by geometry, 1.11 with the tilt at
# rest anywhere in the boxes of the bundled robots, the rest for controllers that damp sway
SLOW, SHIFT = 0.05, 0.15  # [m/s] up to which tensions show a wrong sign, by this share
REST = 1.0  # [s] before each part of the way, and after the last
LINE = "line"  # trajectory without --trajectory
GUARD = "guard"
PLC = "ads"
OPTIONS = {
    "motion": "--enable",
    "period": "--rate, or controller.NAME.period",
    "real_time": "no other value: a live run takes the time of the wall",
}  # what no setting may say behind an option's back


def make_guard(
    robot: Robot, options: Options, chosen: dict[str, Any], period: float, *,
    reset_only: bool = False,
) -> GuardedDriver:  # fmt: skip
    """The driver, guarded; `reset_only`: it clears a fault and is not enabled."""
    plugin = plugins.load("drivers", options.driver)
    if replays(plugin):
        allowed = "a driver that moves; for a recording: carosac compare --driver replay"
        raise InvalidField("--driver", repr(options.driver), allowed)
    guarded = isinstance(plugin, type) and issubclass(plugin, GuardedDriver)
    kind = plugin if guarded else GuardedDriver
    own = own_settings(options.driver, chosen)
    asked = dict(own.pop(GUARD, {}))
    if guarded:
        asked |= own
    else:
        asked |= {"driver": options.driver, "inner": own}
    settings: GuardSettings = kind.Settings()
    _refuse_reserved(asked)
    if options.enable and options.home is None and getattr(plugin, "name", "") == PLC:
        allowed = "--home X Y Z, where the platform stands: homing believes it"
        raise InvalidField("--home", "none", allowed)
    check_types("driver.guard", settings, asked)
    home = options.home or tuple(float(x) for x in robot.home_position)
    wanted = {
        "period": period, "suite": options.suite, "motion": options.enable or reset_only,
        "start_position": home, "home_anew": options.home_anew,
        "rehearse": options.home is not None and not reset_only, "enable_at_once": not reset_only,
        "reset_at_once": options.reset, "real_time": True, "speed_max": WINCH * options.speed,
        "tension_shift_max": SHIFT if options.speed <= SLOW else None,
        **asked,
    }  # fmt: skip
    made = filled("driver.guard", settings, wanted)
    guard: GuardedDriver = kind.build(robot, made, seed=options.seed)
    return guard


def _refuse_reserved(asked: dict[str, Any]) -> None:
    """Refuse settings of the guard, or of the driver behind it, that are an option's to say."""
    inner = asked.get("inner", {})
    inner = inner if isinstance(inner, Mapping) else {}
    for name, option in OPTIONS.items():
        for values in (asked, inner):
            if name in values:
                raise InvalidField("--set", f"driver ... {name}={values[name]!r}", option)
    if "start_position" in asked:
        raise InvalidField("--set", "start_position of the guard", "--home X Y Z")


def make_path(robot: Robot, options: Options) -> Followed:
    """What is followed, from where the platform stands."""
    start = np.asarray(options.home or robot.home_position, dtype=float)
    limits = {"speed_max": options.speed, "acceleration_max": options.acceleration}
    for name, value in limits.items():
        if not 0.0 < value < np.inf:
            raise InvalidField(f"--{name.removesuffix('_max')}", str(value), "> 0, finite")
    if options.to is not None and (options.by_hand or options.trajectory != LINE):
        raise InvalidField("--to", "also --by-hand or --trajectory", "one of the three")
    if options.by_hand:
        check_input("--by-hand")
        return HandTarget(robot, start, **limits)
    if options.to is not None:
        return with_approach(_move(robot, start, options.to, limits), start, rest=REST, **limits)
    path = trajectories.build(options.trajectory, robot, options.seed, **limits)
    return with_approach(path, start, rest=REST, **limits)


def _move(
    robot: Robot, start: Array, end: tuple[float, float, float], limits: dict[str, float]
) -> Trajectory:
    """Straight from one place to another [m]; the start may be outside the box, the end not."""
    goal = np.asarray(end, dtype=float)
    low, high = robot.workspace_min, robot.workspace_max
    got = " ".join(f"{x:g}" for x in end) + " m"
    if not ((goal >= low) & (goal <= high)).all():
        allowed = f"{low.tolist()} to {high.tolist()} m, the workspace box"
        raise InvalidField("--to", got, allowed)
    if np.linalg.norm(goal - start) < NEAR:
        raise InvalidField("--to", got, "another place than where the platform stands (--home)")
    return trajectories.minimum_snap(np.stack([start, goal]), **limits)


@contextlib.contextmanager
def recorded(options: Options) -> Iterator[CrashSafeRecorder]:
    """Where the run is recorded; nothing is left of it where nothing was measured."""
    path = options.recording
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
