"""A session of the guide: which robot is moved by what, for as long as it lasts."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calibration.guide.drivers import (
    SUITE,
    enable_where_it_is,
    guard_limits,
    guarded,
    simulated_driver,
)
from calibration.guide.hand import HandMover
from calibration.guide.mover import DriverMover, Mover
from calibration.guide.progress import request
from calibration.guide.rest import Periods
from calibration.guide.settings import GuideSettings
from calibration.guide.simulated import SimulatedHand, draw_true_robot
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.cli import run_options
from carosac_toolkit.cli.run_builder import GUARD_KEY, make_guard
from carosac_toolkit.live.exit_reasons import Ending, ending_of
from carosac_toolkit.live.library_noise import without_ads_lines
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.plugin_settings import chosen_settings
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.safety.guard import GuardedDriver

SIMULATED = "quasi_static"  # the driver whose robot may differ from its file


@dataclass(frozen=True, kw_only=True)
class Session:
    """A robot that can be moved.

    Attributes:
        mover: What moves it.
        true_position: Returns the true position [m], shape (3,); None where nobody knows it.
        true_robot: The simulated one, or None.
        ending: End by a signal, where the driver moves it.
    """

    mover: Mover
    true_position: Callable[[], Array] | None = None
    true_robot: Robot | None = None
    ending: Ending | None = None


@contextlib.contextmanager
def simulated(
    robot: Robot, true_robot: str | None, settings: GuideSettings, *, by_hand: bool, seed: int
) -> Iterator[Session]:
    """Simulate a robot that differs from its file.

    Args:
        robot: As in its file.
        true_robot: File of the true one, or None: drawn.
        settings: Of the guide.
        by_hand: Whether a simulated person moves it, who is told where to and waits for Enter.
        seed: Of the true robot and of noise.
    """
    rng = np.random.default_rng(seed)
    true = draw_true_robot(robot, rng) if true_robot is None else load_robot(true_robot)
    if true.cable_names != robot.cable_names:
        allowed = f"a robot with cables {list(robot.cable_names)}"
        raise InvalidField("--true-robot", f"cables {list(true.cable_names)}", allowed)
    if by_hand:
        hand = SimulatedHand(robot, true, rng)

        def ask(start: Array, end: Array) -> None:
            _prompt(robot, start, end)
            hand.place(start, end)

        yield Session(
            mover=HandMover(ask, hand.read),
            true_position=lambda: hand.position,
            true_robot=true,
        )
        return
    driver = simulated_driver(robot, true, settings, seed=seed)
    guard = guarded(driver, robot, settings)
    with _enabled(guard, robot) as ending:
        mover = DriverMover(guard, robot, settings, real_time=False)
        yield Session(
            mover=mover,
            true_position=lambda: np.asarray(driver.truth().position[0]),
            true_robot=true,
            ending=ending,
        )


@contextlib.contextmanager
def real(
    robot: Robot, name: str, driver: str, settings: GuideSettings, texts: Sequence[str], *,
    by_hand: bool, enable: bool, reset: bool,
) -> Iterator[Session]:  # fmt: skip
    """Connect a real robot behind the guard; where it is by hand, nothing is sent to it.

    Args:
        robot: As in its file.
        name: Of that file.
        driver: As ``carosac run --driver``.
        settings: Of the guide.
        texts: Settings of the driver, as ``--set``.
        by_hand: Whether a person moves it.
        enable: Whether the winches may move.
        reset: Whether to clear a fault that the drives hold.

    Raises:
        InvalidField: Neither by hand nor enabled.
    """
    if not by_hand and not enable:
        allowed = "--enable, with people out of reach of the robot; or --by-hand"
        raise InvalidField("--enable", "not given, so that nothing moves", allowed)
    chosen = chosen_settings(texts, controllers=[], estimators=[])["driver_settings"]
    plugin = plugins.load("drivers", driver)
    is_guard = isinstance(plugin, type) and issubclass(plugin, GuardedDriver)
    into = chosen if is_guard else chosen.setdefault(GUARD_KEY, {})
    for field, value in guard_limits(robot, settings).items():
        into.setdefault(field, value)
    x, y, z = (float(v) for v in robot.home_position)
    asked = run_options.Options(
        robot=name, driver=driver, enable=not by_hand,
        home=None if by_hand else (x, y, z),  # by hand it may be anywhere, and nothing is homed
        speed=settings.speed, sensors=SUITE, reset=reset and not by_hand,
    )  # fmt: skip
    with without_ads_lines():
        if by_hand:
            with contextlib.closing(_connected(robot, asked, chosen, settings)) as guard:
                periods = Periods(guard, settings)
                read = functools.partial(periods.rest, None)
                yield Session(mover=HandMover(_asking(robot), read, _ask_again))
            return
        guard = make_guard(robot, asked, chosen, settings.period)
        with _enabled(guard, robot) as ending:
            mover = DriverMover(guard, robot, settings, real_time=guard.real_time)
            yield Session(mover=mover, ending=ending)


def _connected(
    robot: Robot, asked: run_options.Options, chosen: dict[str, Any], settings: GuideSettings
) -> GuardedDriver:
    """Connect to read only: with tensions where the driver has them, else lengths alone."""
    try:
        guard = make_guard(robot, asked, deepcopy(chosen), settings.period)
        guard.connect()
    except InvalidField as error:
        if not error.field.endswith("suite") or asked.sensors == "lengths":
            raise
        return _connected(robot, replace(asked, sensors="lengths"), chosen, settings)
    return guard


@contextlib.contextmanager
def _enabled(guard: GuardedDriver, robot: Robot) -> Iterator[Ending]:
    """Let commands through; come to rest at the end, and at a signal."""
    with contextlib.closing(guard):
        enable_where_it_is(guard, robot)
        with ending_of(guard, lambda: None) as ending:
            try:
                yield ending
            finally:
                guard.stop("end of the guide")


def _asking(robot: Robot) -> Callable[[Array, Array], None]:
    """Return how to ask a person for a position."""
    return lambda start, end: _prompt(robot, start, end)


def _prompt(robot: Robot, start: Array, end: Array) -> None:
    """Say where to put the platform, and wait for Enter."""
    _wait_for_enter(request(end, robot.home_position, start))


def _ask_again(why: str) -> None:
    """Say why a sample is no use, and wait for Enter."""
    _wait_for_enter(f"{why}; hold it still, then Enter to read again ")


def _wait_for_enter(text: str) -> None:
    """Print a text, and wait for Enter."""
    try:
        input(text)
    except EOFError as error:
        allowed = "Enter for each position"
        raise InvalidField("--by-hand", "the end of the input", allowed) from error
