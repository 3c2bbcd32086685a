"""Run one controller on one driver, live: along a trajectory, or after a target moved by hand.

Nothing moves without --enable: a dry run connects, estimates, computes, limits and records, and
sends nothing. With it the robot is homed at --home, where its platform must stand, goes straight to
where the trajectory begins, and follows it. The guard watches all of it. Everything is recorded as
it happens; the recording survives the process.

Ctrl-C, SIGTERM, SIGHUP (the terminal is closed) and SIGQUIT stop in good order; the exit status is
then 128 and the number of the signal, such as 130. Exit status 1 means that a fault or an error has
ended the run. A first motion of 10 cm, dry and then for real:

  carosac run --home 0.4 -1.8 2.2 --to 0.5 -1.8 2.2 --speed 0.05
  carosac run --home 0.4 -1.8 2.2 --to 0.5 -1.8 2.2 --speed 0.05 --enable
"""

from __future__ import annotations

import contextlib
import traceback
from collections.abc import Iterator
from typing import Any

import numpy as np

from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.cli.common import CommandResult, period_of_rate
from carosac_toolkit.cli.run_builder import (
    REST_S,
    make_guard,
    make_path,
    paced,
    recorded,
)
from carosac_toolkit.cli.run_options import Options
from carosac_toolkit.live.exit_reasons import Ending, ending_of
from carosac_toolkit.live.hand_target import KEYS_HELP
from carosac_toolkit.live.library_noise import without_ads_lines
from carosac_toolkit.live.messages import say
from carosac_toolkit.live.paced_path import PacedPath
from carosac_toolkit.live.real_time import RealTime, short_pauses
from carosac_toolkit.live.rehearsal import rehearse
from carosac_toolkit.live.sequence import Course
from carosac_toolkit.live.statistics import Statistics
from carosac_toolkit.live.steering import place, steered
from carosac_toolkit.loop.loop import ReferenceSource as Followed
from carosac_toolkit.loop.loop import Step
from carosac_toolkit.loop.loop import run as run_loop
from carosac_toolkit.loop.plugin_builder import build_controller, build_estimator
from carosac_toolkit.loop.plugin_settings import chosen_settings
from carosac_toolkit.physics.motion.winch import PaidOutLengths
from carosac_toolkit.recordings.crash_safe import CrashSafeRecorder
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.safety.guard import GuardedDriver


def run(options: Options) -> CommandResult:
    """Run live."""
    robot = load_robot(options.robot)
    if options.reset and not options.enable:
        return _reset(robot, options)
    chosen = chosen_settings(
        options.settings, controllers=[options.controller], estimators=[options.estimator]
    )
    period, seed = period_of_rate(options.rate), options.seed
    controller = build_controller(options.controller, robot, chosen, period, seed=seed)
    estimator = build_estimator(
        options.estimator, robot, chosen, sensors=options.sensors, seed=seed
    )
    path = make_path(robot, options)
    guard = make_guard(robot, options, chosen["driver_settings"], float(controller.period))
    rehearse(robot, estimator, controller, path, suite=options.sensors)
    statistics = Statistics(guard)
    with recorded(options) as recorder, _prepared(options, guard) as real_time:
        guard.journal = recorder
        say(_what(options, guard, recorder, path))
        with ending_of(guard, recorder.close) as ending, steered(path, guard):
            parts = (guard, estimator, controller, paced(path, options, guard))
            completed, error = _run(options, robot, *parts, statistics, real_time)
        statistics.end_line()
        whole = recorder.close()
    if guard.fault is None and error is None and (guard.unrecorded or not whole):
        text = f"the recording lacks {guard.unrecorded} rows, as the disk did not take them"
        error = CarosacError(text)
    result = _result(guard, statistics, recorder, ending, completed, error)
    _say_next_step(guard, options)
    return result


def _reset(robot: Robot, options: Options) -> CommandResult:
    """Clear the fault that the drives hold; nothing is homed, and nothing moves."""
    chosen = chosen_settings(
        options.settings, controllers=[options.controller], estimators=[options.estimator]
    )["driver_settings"]
    guard = make_guard(robot, options, chosen, period_of_rate(options.rate), reset_only=True)
    try:
        with without_ads_lines():
            guard.connect()
        cleared = guard.cleared
    finally:
        guard.close()
    message = "no fault was held" if cleared is None else f"cleared: {cleared.fault}"
    say(f"{message}; nothing has moved")
    return CommandResult({"cleared": None if cleared is None else str(cleared.fault)}, status=0)


@contextlib.contextmanager
def _prepared(options: Options, guard: GuardedDriver) -> Iterator[RealTime | None]:
    """Keep pauses short, prepare for real time if asked, and keep the ADS library silent."""
    with contextlib.ExitStack() as stack:
        real_time = None
        stack.enter_context(short_pauses())
        if options.priority:
            real_time = stack.enter_context(RealTime("carosac run", lambda: guard.at_rest))
        stack.enter_context(without_ads_lines())
        yield real_time


def _run(
    options: Options, robot: Robot, guard: GuardedDriver, estimator: Any, controller: Any,
    path: PacedPath, statistics: Statistics, real_time: RealTime | None,
) -> tuple[bool, BaseException | None]:  # fmt: skip
    """Run the loop; return whether it came to its end, and an error once it was connected."""
    duration = path.duration + REST_S if options.duration is None else options.duration

    def watch(step: Step) -> None:
        statistics(step)
        if real_time is not None:
            real_time.cycle()
        if options.duration is None and path.past_end >= REST_S:
            guard.end("end of the trajectory")

    try:
        log = run_loop(
            guard, estimator, controller, path, duration=duration, watch=watch, keep=1,
            by_clock=options.duration is not None,  # else to the end of the path, by cycles
            paid_out=PaidOutLengths.of(robot),
        )  # fmt: skip
    except BaseException as error:
        if guard.fault is None and (statistics.cycles == 0 or isinstance(error, KeyboardInterrupt)):
            raise
        if not isinstance(error, CarosacError):
            traceback.print_exc()
        return False, error
    return log.completed, None


def _what(
    options: Options, guard: GuardedDriver, recorder: CrashSafeRecorder, path: Followed
) -> str:
    """Return what is about to happen, by the settings of the guard."""
    settings, period = guard.settings, guard.settings.period
    how = "the winches move" if settings.motion else "dry run: nothing is sent; --enable moves"
    if settings.motion and not settings.enable_at_once:
        how = "dry run: nothing is sent, as enable_at_once is false"
    what = KEYS_HELP if options.by_hand else f"trajectory {options.trajectory}"
    if options.to is not None:
        what = f"straight to {place(np.array(options.to))}"
    if isinstance(path, Course) and path.moved > 0.0:
        what += f", moved by up to {path.moved:.3g} m to where two cables let the platform rest"
    if settings.motion and settings.speed_max is not None:
        how += f", at {settings.speed_max:g} m/s of cable at most"
    return (
        f"{options.robot} on {options.driver}: {options.controller} with {options.estimator} at "
        f"{1.0 / period:g} Hz; {how}\n{what}\nrecording: {recorder.path}"
    )


def _say_next_step(guard: GuardedDriver, options: Options) -> None:
    """Say what clears the fault that the drives hold now, if any."""
    if guard.held is None:
        return
    words = f"carosac run --driver {options.driver} --robot {options.robot} --reset"
    fault = guard.held.fault
    say(f"The drives hold a fault, {fault}, and move for nobody until it is cleared: {words}")


def _result(
    guard: GuardedDriver, statistics: Statistics, recorder: CrashSafeRecorder, ending: Ending,
    completed: bool, error: BaseException | None,
) -> CommandResult:  # fmt: skip
    """Say how the run ended, and return it."""
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
        **statistics.data(),
        "recording": str(recorder.path),
        "rows": recorder.rows,
        "unrecorded_rows": guard.unrecorded,
        "commands_before_row": guard.monitor.unwritten,
    }
    where = "" if statistics.position is None else f"platform at {place(statistics.position)}\n"
    say(f"{reason}\n{where}{statistics.cycles} cycles, {statistics.timing()}; limited: "
        f"{dict(statistics.limits) or 'none'}")  # fmt: skip
    if ending.signal is not None and fault is None and error is None:
        return CommandResult(data, status=128 + ending.signal)
    return CommandResult(data, status=0 if good else 1)
