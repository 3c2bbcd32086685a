"""Run one controller on one driver, live: along a trajectory, or after a target moved by hand.

Nothing moves without --enable: a dry run connects, estimates, computes, limits and records, and
sends nothing. With it the robot is homed at --home, where its platform must stand, goes straight to
where the trajectory begins, and follows it. The guard watches all of it. Everything is recorded as
it happens; the recording survives the process.

Ctrl-C and SIGTERM stop in good order (exit status 130 and 143). Exit status 1 means that a fault or
an error has ended the run.
"""

from __future__ import annotations

import contextlib
import sys
import time
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from carosac_toolkit import registry, trajectories
from carosac_toolkit.cli.common import CommandResult, CommonOptions, OutputFile
from carosac_toolkit.cli.place import Place
from carosac_toolkit.cli.plc import take_priority
from carosac_toolkit.crash_safe import CrashSafeRecorder
from carosac_toolkit.drivers.guard_settings import GuardSettings
from carosac_toolkit.drivers.guarded import GuardedDriver
from carosac_toolkit.errors import CarosacError, InvalidField
from carosac_toolkit.filled_settings import filled
from carosac_toolkit.live.course import with_approach
from carosac_toolkit.live.ending import Ending, ending_of
from carosac_toolkit.live.hand_target import HELP, HandTarget
from carosac_toolkit.live.keyboard import listening
from carosac_toolkit.live.plugins import build_controller, build_estimator
from carosac_toolkit.live.rehearsal import rehearse
from carosac_toolkit.live.statistics import Statistics
from carosac_toolkit.loop import Path as Followed
from carosac_toolkit.loop import run as run_loop
from carosac_toolkit.protocols import replays
from carosac_toolkit.robot import Robot
from carosac_toolkit.robot_file import load_robot
from carosac_toolkit.studies.chosen_settings import check_types, chosen_settings
from carosac_toolkit.studies.run_case import own_settings

REST = 1.0  # [s] before each part of the way, and after the last
GUARD = "guard"
PLC = "ads"
OPTIONS = {
    "motion": "--enable",
    "period": "--rate, or controller.NAME.period",
    "real_time": "no other value: a live run takes the time of the wall",
}  # what no setting may say behind an option's back
SWITCH = 1e-3  # [s] after which a thread lets the others run


@dataclass(frozen=True, kw_only=True)
class Options(CommonOptions):
    """Options of ``carosac run``."""

    robot: str = "carosac"
    """Bundled robot or YAML file."""
    driver: str = "simulator"
    """What is driven: `simulator`, `ads` (a PLC), or `module:Class`; the guard is put around it."""
    controller: str = "kinematic_solver"
    """Controller by name, or `module:Class`."""
    estimator: str = "kinematic_solver"
    """Estimator by name, or `module:Class`."""
    suite: str = "lengths"
    """Sensor suite of the driver."""
    trajectory: str = "line"
    """Trajectory of the catalogue."""
    by_hand: tyro.conf.FlagCreatePairsOff[bool] = False
    """Follow a target moved by keys, or by lines `x y z` [m] of the standard input, instead."""
    enable: tyro.conf.FlagCreatePairsOff[bool] = False
    """Let the winches move; without it the run is dry."""
    home: Place = None
    """Where the platform stands at the start [m]; by default the home position of the robot, and
    asked for where --enable moves a robot behind a PLC."""
    reset: tyro.conf.FlagCreatePairsOff[bool] = False
    """With --enable, first clear a fault that the PLC holds from an earlier run, once you know why
    it came; the platform is homed anew."""
    home_anew: tyro.conf.FlagCreatePairsOff[bool] = False
    """Home also where that changes an offset by more than 0.1 m; only at a pose that was
    measured."""
    speed: float = 0.3
    """Largest speed of the platform [m/s]."""
    acceleration: float = 0.3
    """Largest acceleration of the platform [m/s^2]."""
    duration: float | None = None
    """How long the run lasts [s]; by default to the end of the trajectory."""
    rate: float = 100.0
    """Commands a second, for a controller whose period can be chosen."""
    priority: tyro.conf.FlagCreatePairsOff[bool] = False
    """Run before all ordinary processes; on Linux, and with the right to it."""
    settings: Annotated[
        tuple[str, ...], tyro.conf.arg(name="set", metavar="SETTING"), tyro.conf.UseAppendAction
    ] = ()
    """Setting of a plug-in: controller.NAME.FIELD=VALUE, estimator.NAME.FIELD=VALUE,
    driver.FIELD=VALUE, or driver.guard.FIELD=VALUE for the guard around a driver that has none of
    its own; may be given several times."""
    recording: OutputFile = None
    """Where the run is recorded, ending in .jsonl; by default a new file in carosac-results/run."""


def run(options: Options) -> CommandResult:
    """Run live."""
    robot = load_robot(options.robot)
    chosen = chosen_settings(
        options.settings, controllers=[options.controller], estimators=[options.estimator]
    )
    period = 1.0 / _rate(options)
    controller = build_controller(options.controller, robot, chosen, period, seed=options.seed)
    estimator = build_estimator(options.estimator, robot, chosen, seed=options.seed)
    guard = _guard(robot, options, chosen["driver_settings"], float(controller.period))
    path = _path(robot, options)
    rehearse(robot, estimator, controller, path, suite=options.suite)
    recorder = _recorder(options)
    guard.journal = recorder
    print(_what(options, guard, recorder), flush=True)
    statistics = Statistics(guard)
    usual = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH)
    if options.priority:
        take_priority()
    try:
        with ending_of(guard, recorder.close) as ending, _steered(path, guard):
            completed, error = _run(options, guard, estimator, controller, path, statistics)
    finally:
        sys.setswitchinterval(usual)
        recorder.close()
        statistics.end_line()
    return _result(guard, statistics, recorder, ending, completed, error)


def _run(
    options: Options, guard: GuardedDriver, estimator: Any, controller: Any, path: Followed,
    statistics: Statistics,
) -> tuple[bool, Exception | None]:  # fmt: skip
    """Run the loop; whether it came to its end, and an error after the connection stood."""
    duration = options.duration
    if duration is None:
        duration = path.duration + REST
    try:
        log = run_loop(
            guard, estimator, controller, path, duration=duration, watch=statistics, keep=1
        )  # fmt: skip
    except Exception as error:
        if guard.fault is None and statistics.cycles == 0:
            raise
        if not isinstance(error, CarosacError):
            traceback.print_exc()
        return False, error
    return log.completed, None


def _rate(options: Options) -> float:
    """Commands a second."""
    if not 0.0 < options.rate < np.inf:
        raise InvalidField("--rate", f"{options.rate} Hz", "> 0 Hz, finite")
    return options.rate


def _guard(robot: Robot, options: Options, chosen: dict[str, Any], period: float) -> GuardedDriver:
    """The driver, guarded."""
    plugin = registry.load("drivers", options.driver)
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
        "period": period, "suite": options.suite, "motion": options.enable,
        "start_position": home, "home_anew": options.home_anew,
        "reset_at_once": options.reset, "real_time": True, **asked,
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


def _path(robot: Robot, options: Options) -> Followed:
    """What is followed."""
    start = np.asarray(options.home or robot.home_position, dtype=float)
    limits = {"speed_max": options.speed, "acceleration_max": options.acceleration}
    for name, value in limits.items():
        if not 0.0 < value < np.inf:
            raise InvalidField(f"--{name.removesuffix('_max')}", str(value), "> 0, finite")
    if options.by_hand:
        return HandTarget(robot, start, **limits)
    path = trajectories.build(options.trajectory, robot, options.seed, **limits)
    return with_approach(path, start, rest=REST, **limits)


def _recorder(options: Options) -> CrashSafeRecorder:
    """Where the run is recorded."""
    path = options.recording
    if path is None:
        folder = Path("carosac-results/run")
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / time.strftime("%Y%m%d-%H%M%S.jsonl")
    words = f"{options.controller} with {options.estimator} on {options.driver}"
    return CrashSafeRecorder(path, robot=options.robot, description=words)


def _what(options: Options, guard: GuardedDriver, recorder: CrashSafeRecorder) -> str:
    """What is about to happen, by the settings of the guard."""
    settings, period = guard.settings, guard.settings.period
    how = "the winches move" if settings.motion else "dry run: nothing is sent; --enable moves"
    if settings.motion and not settings.enable_at_once:
        how = "dry run: nothing is sent, as enable_at_once is false"
    what = HELP if options.by_hand else f"trajectory {options.trajectory}"
    return (
        f"{options.robot} on {options.driver}: {options.controller} with {options.estimator} at "
        f"{1.0 / period:g} Hz; {how}\n{what}\nrecording: {recorder.path}"
    )


@contextlib.contextmanager
def _steered(path: Followed, guard: GuardedDriver) -> Any:
    """Let somebody steer, where that is what is followed."""
    if not isinstance(path, HandTarget):
        yield
        return

    def heard(word: str) -> None:
        if not path.obey(word):
            print(f"carosac: {word!r}: got no key or place; {HELP}", file=sys.stderr)
        if path.over:
            guard.end("the end was asked for")

    def ended() -> None:
        while not path.arrived and guard.ending is None:
            time.sleep(0.05)
        guard.end("the input has ended")

    with listening(heard, ended):
        yield


def _result(
    guard: GuardedDriver, statistics: Statistics, recorder: CrashSafeRecorder, ending: Ending,
    completed: bool, error: Exception | None,
) -> CommandResult:  # fmt: skip
    """Say how it ended."""
    fault = guard.fault
    asked = guard.ending is not None and ending.signal is None
    good = fault is None and error is None and (completed or asked)
    reason = guard.ending or ("end of the trajectory" if completed else "the driver has stopped")
    if fault is not None:
        reason = f"fault: {fault}"
    elif error is not None:
        reason = f"{type(error).__name__}: {error}"
    data = {
        "completed": good,
        "reason": reason,
        "fault": None if fault is None else str(fault.fault),
        "cable": None if fault is None else fault.cable,
        "home_change_m": None if guard.home_change is None else guard.home_change.tolist(),
        "would_be_faults": guard.refused,
        **statistics.data(guard.settings.period),
        "recording": str(recorder.path),
        "rows": recorder.rows,
    }
    print(f"{reason}\n{statistics.cycles} cycles, {guard.overruns} late; limited: "
          f"{dict(statistics.limits) or 'none'}")  # fmt: skip
    if ending.signal is not None and fault is None and error is None:
        return CommandResult(data, status=128 + ending.signal)
    return CommandResult(data, status=0 if good else 1)
