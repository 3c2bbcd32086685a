"""Checks of drivers; commands come every 20 ms, well within the limits."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.conformance.capabilities import capabilities_fit
from carosac_toolkit.conformance.scenes import DEFAULT_PERIOD_S, other_robot
from carosac_toolkit.conformance.verdicts import (
    CHECK_SEED,
    Check,
    Factory,
    only_clear_errors,
    refuses,
    require,
    require_close,
    require_repeatable,
    require_same,
)
from carosac_toolkit.loop.protocols import TruthSource, replays
from carosac_toolkit.loop.values import Command, Measurement, State
from carosac_toolkit.robot.robot import Robot

SPEED_SHARE = 0.25  # of the speed limit
CYCLES_MAX = 20_000  # after which a driver counts as endless
SETTLED_DIFFERENCE_M = 0.02  # between lengths sent and lengths measured 2 s later


def not_before_connect(factory: Factory, robot: Robot) -> None:
    """Before `connect` and after `close`, `measure`, `command` and `wait` are clear errors."""
    driver = factory(robot, seed=CHECK_SEED)
    some = Command(time=np.zeros(1), unstrained_length=np.full((1, robot.n), 5.0))
    calls: dict[str, Callable[[], object]] = {
        "measure()": driver.measure,
        "command()": lambda: driver.command(some),
        "wait()": lambda: driver.wait(DEFAULT_PERIOD_S),
    }
    for when in ("before connect()", "after close()"):
        for name, call in calls.items():
            require(refuses(f"{name} {when}", call), f"{name} worked {when}")
        if when == "before connect()":
            driver.connect()
            driver.close()


def stop_and_close_any_time(factory: Factory, robot: Robot) -> None:
    """`stop` and `close` are safe before `connect`, twice, and after `close`."""
    driver = factory(robot, seed=CHECK_SEED)
    try:
        driver.stop("never connected")
        driver.close()
        driver.connect()
        for _ in range(2):
            driver.stop("conformance check")
        for _ in range(2):
            driver.close()
        driver.stop("closed")
    except Exception as error:
        message = f"{type(error).__name__}: {error}"
        require(False, f"stop() and close(): got {message}; allowed: no error at any time")


def measurement_fits(factory: Factory, robot: Robot) -> None:
    """Measurements have one length per cable, and time goes on with each `wait`."""
    driver = _connected(factory, robot)
    last = -np.inf
    for _ in range(3):
        measurement = driver.measure()
        kind = type(measurement).__name__
        require(isinstance(measurement, Measurement), f"measure(): got {kind}")
        shape = measurement.unstrained_length.shape
        good = len(shape) == 2 and shape[0] >= 1 and shape[1] == robot.n
        require(good, f"measure(): got lengths of shape {shape}; allowed: (B, {robot.n}), B >= 1")
        now = float(measurement.time[0])
        require(now > last, f"measure().time: got {now} s after {last} s; allowed: later")
        last = now
        driver.command(_hold(measurement))
        driver.wait(DEFAULT_PERIOD_S)
    driver.close()


def truth_is_withheld(factory: Factory, robot: Robot) -> None:
    """A suite without poses measures none; `truth` gives a `State`, or None."""
    driver = _connected(factory, robot)
    require(driver.measure().pose is None, "measure().pose: got a pose; allowed: None in a suite "
            "without poses")  # fmt: skip
    if isinstance(driver, TruthSource):
        state = driver.truth()
        good = state is None or isinstance(state, State)
        require(good, f"truth(): got {type(state).__name__}; allowed: State or None")
    driver.close()


def wrong_cables_refused(factory: Factory, robot: Robot) -> None:
    """A command of another number of cables is a clear error; so is a robot it cannot be."""
    driver = _connected(factory, robot)
    held = _hold(driver.measure())
    wide = Command(time=held.time, unstrained_length=np.c_[held.unstrained_length, [[5.0]]])
    refused = refuses(f"a command of {robot.n + 1} cables", lambda: driver.command(wide))
    require(refused, f"command(): it took {robot.n + 1} lengths for {robot.n} cables")
    driver.close()
    changed = other_robot(robot)
    shapes: list[tuple[int, ...]] = []

    def build() -> None:
        other = _connected(factory, changed)
        shapes.append(other.measure().unstrained_length.shape)
        other.close()

    if not refuses(f"a robot of {changed.n} cables", build):
        require(
            shapes[0][-1] == changed.n, f"built for {changed.n} cables, it measures {shapes[0]}"
        )


def command_says_what_was_sent(factory: Factory, robot: Robot) -> None:
    """Require that `command` returns what the winches then follow, and reports changes."""
    driver = _connected(factory, robot)
    held = _hold(driver.measure())
    far = Command(time=held.time, unstrained_length=held.unstrained_length + 3.0)
    sent = driver.command(far)
    require(isinstance(sent, Command), f"command(): got {type(sent).__name__}; allowed: Command")
    if replays(driver):
        require_same([sent.unstrained_length], [driver.command(held).unstrained_length],
                     "command(): a driver that replays returned what was asked")  # fmt: skip
        driver.close()
        return
    if not np.array_equal(sent.unstrained_length, far.unstrained_length):
        require(sent.limited, "command(): it changed the command; `limited` must say why")
    sent = _settle(driver, sent, 2.0)
    require_close(
        driver.measure().unstrained_length,
        sent.unstrained_length,
        "lengths sent and measured 2 s later",
        SETTLED_DIFFERENCE_M,
    )
    driver.close()


def stop_comes_to_rest(factory: Factory, robot: Robot) -> None:
    """After `stop` the lengths sent come to rest within speed, acceleration and length limits."""
    driver = _connected(factory, robot)
    if replays(driver):
        driver.close()
        return
    first = driver.measure().unstrained_length
    lengths: list[Array] = []
    step = SPEED_SHARE * robot.speed_max * DEFAULT_PERIOD_S
    braking = int(np.ceil((robot.speed_max / robot.acceleration_max).max() / DEFAULT_PERIOD_S)) + 50
    for k in range(30 + braking):
        if k == 30:
            driver.stop("conformance check")
        command = Command(time=driver.measure().time, unstrained_length=first + step * (k + 1))
        lengths.append(driver.command(command).unstrained_length)
        driver.wait(DEFAULT_PERIOD_S)
    driver.close()
    speed = np.diff(np.stack(lengths), axis=0) / DEFAULT_PERIOD_S
    acceleration = np.diff(speed, axis=0) / DEFAULT_PERIOD_S
    _within("speed", speed, robot.speed_max, "m/s")
    _within("acceleration", acceleration, robot.acceleration_max, "m/s^2")
    low, high = np.min(lengths, axis=0), np.max(lengths, axis=0)
    inside = (low >= robot.length_min).all() and (high <= robot.length_max).all()
    require(inside, f"stop(): lengths from {low.min():.3f} m to {high.max():.3f} m were sent; "
            "allowed: within length_min and length_max")  # fmt: skip
    moving = float(np.abs(speed[-10:]).max())
    seconds = braking * DEFAULT_PERIOD_S
    require(moving < 1e-6, f"stop(): {seconds:.1f} s later lengths are still sent that move at "
            f"{moving:.3g} m/s; allowed: 0 m/s")  # fmt: skip


def wait_says_when_it_ends(factory: Factory, robot: Robot) -> None:
    """`wait` returns True while it goes on, and False at the end of data or after `stop`."""
    driver = _connected(factory, robot)
    more = driver.wait(DEFAULT_PERIOD_S)
    require(more is True, f"wait(): got {more!r} at the first cycle; allowed: True")
    if not replays(driver):
        driver.stop("conformance check")
    for _ in range(CYCLES_MAX):
        if not driver.wait(DEFAULT_PERIOD_S):
            driver.close()
            return
    driver.close()
    require(False, f"wait(): never False in {CYCLES_MAX} cycles after stop() or of data")


def connecting_again_starts_over(factory: Factory, robot: Robot) -> None:
    """After `close`, `connect` gives the same measurements again."""
    driver = factory(robot, seed=CHECK_SEED)
    first = _lengths(driver, robot)
    again = _lengths(driver, robot)
    require_same(first, again, "connect(): the same commands gave other measurements than before")


def same_seed_same_data(factory: Factory, robot: Robot) -> None:
    """Two made with the same seed agree, whatever else draws random numbers."""
    require_repeatable(
        lambda: _lengths(factory(robot, seed=CHECK_SEED), robot),
        "seed: two drivers made with the same seed disagreed",
    )


DRIVER_CHECKS: dict[str, Check] = {
    check.__name__: check
    for check in (
        not_before_connect,
        stop_and_close_any_time,
        measurement_fits,
        truth_is_withheld,
        wrong_cables_refused,
        command_says_what_was_sent,
        stop_comes_to_rest,
        wait_says_when_it_ends,
        connecting_again_starts_over,
        same_seed_same_data,
        capabilities_fit,
    )
}


def _connected(factory: Factory, robot: Robot) -> Any:
    """Return a driver that is connected."""
    driver = factory(robot, seed=CHECK_SEED)
    with only_clear_errors("connect()"):
        driver.connect()
    return driver


def _hold(measurement: Measurement) -> Command:
    """Return a command to stay where the winches are."""
    return Command(time=measurement.time, unstrained_length=measurement.unstrained_length)


def _settle(driver: Any, command: Command, duration: float) -> Command:
    """Ask for the same lengths for a while."""
    for _ in range(round(duration / DEFAULT_PERIOD_S)):
        driver.wait(DEFAULT_PERIOD_S)
        command = driver.command(command)
    return command


def _lengths(driver: Any, robot: Robot) -> list[Array]:
    """Return measured lengths while they are asked to grow slowly."""
    driver.connect()
    lengths: list[Array] = []
    try:
        for k in range(10):
            measurement = driver.measure()
            lengths.append(np.array(measurement.unstrained_length))
            asked = lengths[0] + 0.1 * SPEED_SHARE * robot.speed_max * DEFAULT_PERIOD_S * k
            driver.command(Command(time=measurement.time, unstrained_length=asked))
            if not driver.wait(DEFAULT_PERIOD_S):
                break
    except CarosacError as error:
        raise AssertionError(f"slow commands near the start were refused: {error}") from error
    finally:
        driver.close()
    return lengths


def _within(what: str, values: Array, limit: Array, unit: str) -> None:
    """Require a rate to keep its limit, but for rounding."""
    worst = float((np.abs(values) / limit).max())
    most = float(np.abs(values).max())
    require(worst <= 1.0 + 1e-6, f"stop(): {what} of what was sent reached {most:.3g} {unit}, "
            f"{worst:.2f} times its limit")  # fmt: skip
