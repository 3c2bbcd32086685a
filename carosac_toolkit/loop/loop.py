"""The one loop: measure, update, control, command, wait; time is the driver's."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, MutableSequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from itertools import count
from typing import Any, Protocol

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.plugin_errors import BadPlugin, exit_refused
from carosac_toolkit.loop.protocols import Controller, Driver, Estimator, Supervisor, TruthSource
from carosac_toolkit.loop.values import (
    Belief,
    Command,
    Innovations,
    LimitHit,
    Measurement,
    Reference,
    State,
)


class ReferenceSource(Protocol):
    """Source of references of a run: a `Trajectory`, or a target moved by hand."""

    @property
    def duration(self) -> float:
        """[s]."""
        ...

    def window(self, time: float, horizon: float, period: float) -> Reference:
        """Return the reference from `time` [s] after the start on; times never decrease."""
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """One cycle of the loop.

    Attributes:
        measurement: Measurement of the sensors.
        belief: Belief of the estimator after it.
        reference: Reference now and ahead, by the driver's clock.
        asked: Command of the controller.
        command: Command really sent.
        truth: State at the same time, or None if the driver does not know it.
        latency: Wall time of estimator and controller together [s].
        durations: Wall time of ``measure``, ``estimator``, ``controller`` and ``command`` [s].
    """

    measurement: Measurement
    belief: Belief
    reference: Reference
    asked: Command
    command: Command
    truth: State | None
    latency: float
    durations: dict[str, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class Log:
    """Record of T cycles of B worlds with n cables.

    Attributes:
        time: By the driver's clock, from the first measurement [s], shape (T,).
        reference: Platform origin that was asked for in W [m], shape (T, B, 3).
        position: True platform origin in W [m], shape (T, B, 3), or None if unknown.
        rotation: True rotation from P to W, shape (T, B, 3, 3), or None.
        tension: True tension at the platform [N], shape (T, B, n), or None.
        belief_position: Estimated platform origin in W [m], shape (T, B, 3).
        belief_rotation: Estimated rotation, shape (T, B, 3, 3).
        unstrained_length: Measured [m], shape (T, B, n).
        asked: Unstrained lengths that the controller asked for [m], shape (T, B, n).
        command: Unstrained lengths really sent [m], shape (T, B, n).
        latency: Wall time of estimator and controller per cycle [s], shape (T,).
        limited: Every limit that changed a command, with the index of its cycle.
        completed: True if the driver went on to the end.
        twist: True twist in W at the platform origin [m/s, rad/s], shape (T, B, 6), or None.
        true_length: True unstrained length [m], shape (T, B, n), or None.
        belief_twist: Estimated twist, shape (T, B, 6); None where the estimator has none.
        belief_covariance: Of the belief, as `Belief.covariance`, shape (T, B, 12, 12), or None.
        innovations: Normalised innovations of the measurements, each of shape (T, B); None if the
            estimator has none.
    """

    time: Array
    reference: Array
    position: Array | None
    rotation: Array | None
    tension: Array | None
    belief_position: Array
    belief_rotation: Array
    unstrained_length: Array
    asked: Array
    command: Array
    latency: Array
    limited: tuple[tuple[int, LimitHit], ...]
    completed: bool
    twist: Array | None = None
    true_length: Array | None = None
    belief_twist: Array | None = None
    belief_covariance: Array | None = None
    innovations: Innovations | None = None

    def world(self, row: int, cycles: int) -> Log:
        """Return the first cycles of one of the B worlds, as a log of its own.

        The latencies stay those of the whole batch.
        """
        parts: dict[str, Any] = {}
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                parts[field.name] = value[:cycles] if value.ndim == 1 else value[:cycles, [row]]
        if self.innovations is not None:
            parts["innovations"] = Innovations(
                **{name: value[:cycles, [row]] for name, value in vars(self.innovations).items()}
            )
        limited = tuple((k, hit) for k, hit in self.limited if k < cycles and hit.row == row)
        return replace(self, **parts, limited=limited)


def run(
    driver: Driver, estimator: Estimator, controller: Controller, trajectory: ReferenceSource, *,
    duration: float | None = None, watch: Callable[[Step], None] | None = None,
    keep: int | None = None, by_clock: bool = False,
    paid_out: Callable[[Array], Array] | None = None,
) -> Log:  # fmt: skip
    """Run one controller and one estimator on one driver along one trajectory.

    The driver is connected here, and stopped and closed whatever fails.

    Args:
        driver: Simulated, recorded or real.
        estimator: Sees applied commands and measurements only.
        controller: Its `period` is the cycle time.
        trajectory: Starts at the driver's first measurement.
        duration: Length of the run [s]; None: to the end of the trajectory and one second of rest.
        watch: Called after each command, before the wait.
        keep: Number of last cycles in the log; None: all of them.
        paid_out: Turns measured lengths (B, n) [m], one after another, into those that the
            estimator sees; `PaidOutLengths` does where winches have hysteresis. None: the same.
        by_clock: True to count `duration` by the clock of the driver, also where it misses ticks;
            else by cycles, one period each.

    Returns:
        The log of all cycles that were kept.

    Raises:
        BadPlugin: The estimator or controller returned a wrong shape or a number that is not
            finite; the driver was stopped.
        InvalidField: A period, horizon or duration that is not positive.
    """
    period = _positive("controller.period", getattr(controller, "period", None))
    total = trajectory.duration + 1.0 if duration is None else _positive("duration", duration)
    cycles = max(1, round(total / period))
    steps: MutableSequence[Step] = deque(maxlen=_kept(keep)) if keep is not None else []
    reason = "end of the trajectory"
    try:
        driver.connect()
        over = _Over(cycles, total - 1.5 * period if by_clock else None)
        alive = _cycles(driver, estimator, controller, trajectory, over, steps, watch, paid_out)
        reason = reason if alive else "end of data"
    except BaseException as error:
        reason = f"{type(error).__name__}: {error}"
        if not isinstance(error, KeyboardInterrupt) and isinstance(driver, Supervisor):
            driver.fail("program", error)
        raise
    finally:
        try:
            driver.stop(reason)
        finally:
            driver.close()
    return _log(list(steps), alive)


def _cycles(
    driver: Driver, estimator: Estimator, controller: Controller, trajectory: ReferenceSource,
    over: Callable[[int, float], bool], steps: MutableSequence[Step],
    watch: Callable[[Step], None] | None, paid_out: Callable[[Array], Array] | None,
) -> bool:  # fmt: skip
    """Run until it is over; False where the driver ended earlier."""
    measurement = driver.measure()
    start = float(measurement.time[0])
    applied = Command(time=measurement.time, unstrained_length=measurement.unstrained_length)
    belief: Belief | None = None
    clock = time.perf_counter
    for k in count():
        woken = clock()
        if k > 0:
            measurement = driver.measure()
        truth = driver.truth() if isinstance(driver, TruthSource) else None
        now = float(measurement.time[0]) - start
        reference = _reference(trajectory, controller, now, start)
        began = clock()
        first, seen = belief is None, measurement
        if paid_out is not None:
            seen = replace(measurement, unstrained_length=paid_out(measurement.unstrained_length))
        with _blamed(driver, "estimator", estimator):
            estimate = (
                estimator.reset(seen) if belief is None else estimator.update(belief, applied, seen)
            )
            belief = checked_belief(estimate, measurement)
        if isinstance(driver, Supervisor):
            driver.believe(belief)
        estimated = clock()
        with _blamed(driver, "controller", controller):
            if first:
                controller.reset(belief)
            asked = _checked_command(controller.command(belief, reference), measurement)
        decided = clock()
        applied = driver.command(asked)
        step = Step(
            measurement=measurement, belief=belief, reference=reference, asked=asked,
            command=applied, truth=truth, latency=decided - began,
            durations={
                "measure": began - woken, "estimator": estimated - began,
                "controller": decided - estimated, "command": clock() - decided,
            },
        )  # fmt: skip
        steps.append(step)
        if watch is not None:
            watch(step)
        last = over(k, now)
        if not driver.wait(controller.period) or last:
            return last
    raise AssertionError("cycles have no end of their own")


@dataclass(frozen=True)
class _Over:
    """End of a run: the `cycles`-th cycle, or the first at `time` [s] or after it."""

    cycles: int
    time: float | None

    def __call__(self, k: int, now: float) -> bool:
        return k == self.cycles - 1 if self.time is None else now >= self.time


@contextmanager
def _blamed(driver: Driver, part: str, plugin: object) -> Iterator[None]:
    """Tell a supervising driver which part raised an error."""
    try:
        with exit_refused(part, plugin):
            yield
    except BaseException as error:  # also CancelledError and GeneratorExit, which are no Exception
        if isinstance(driver, Supervisor):
            driver.fail(part, error)
        raise


def _kept(keep: int) -> int:
    """Refuse to keep nothing."""
    if isinstance(keep, bool) or not isinstance(keep, int) or keep < 1:
        raise InvalidField("keep", repr(keep), "a whole number of cycles, 1 or more")
    return keep


def _reference(
    trajectory: ReferenceSource, controller: Controller, now: float, start: float
) -> Reference:
    """Return the window of references `now` seconds after the start, by the driver's clock."""
    window = trajectory.window(now, controller.horizon, controller.period)
    return window if start == 0.0 else replace(window, time=window.time + start)


def _positive(name: str, value: object) -> float:
    """Refuse zero, negative values, NaN and anything but a number."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.floating):
        raise InvalidField(name, repr(value), "a number of seconds")
    if not 0.0 < value < np.inf:
        raise InvalidField(name, f"{value} s", "> 0 s, finite")
    return float(value)


def checked_belief(belief: object, measurement: Measurement) -> Belief:
    """Refuse an invalid result of an estimator; arrays of a Belief are finite by construction.

    Raises:
        BadPlugin: No Belief, or one of another batch or number of cables.
    """
    size, n = measurement.unstrained_length.shape
    if not isinstance(belief, Belief):
        raise BadPlugin(f"estimator: got {type(belief).__name__}; allowed: a Belief")
    if len(belief.position) != size:
        raise BadPlugin(f"estimator: got {len(belief.position)} poses; allowed: {size}")
    if belief.tension is not None and np.shape(belief.tension) != (size, n):
        got = np.shape(belief.tension)
        raise BadPlugin(f"estimator: got tensions of shape {got}; allowed: {(size, n)}")
    return belief


def _checked_command(command: object, measurement: Measurement) -> Command:
    """Refuse a command of another shape; its arrays are finite by construction."""
    shape = measurement.unstrained_length.shape
    if not isinstance(command, Command):
        raise BadPlugin(f"controller: got {type(command).__name__}; allowed: a Command")
    if command.unstrained_length.shape != shape:
        got = command.unstrained_length.shape
        raise BadPlugin(f"controller: got lengths of shape {got}; allowed: {shape}")
    return command


def _log(steps: list[Step], completed: bool) -> Log:
    """Stack the cycles."""
    size = len(steps[0].measurement.unstrained_length)
    beliefs = [s.belief for s in steps]
    start = float(steps[0].measurement.time[0])
    return Log(
        time=np.array([s.measurement.time[0] for s in steps]) - start,
        reference=np.stack([np.broadcast_to(s.reference.position[:, 0], (size, 3)) for s in steps]),
        belief_position=np.stack([belief.position for belief in beliefs]),
        belief_rotation=np.stack([belief.rotation for belief in beliefs]),
        belief_twist=_stacked([belief.twist for belief in beliefs]),
        belief_covariance=_stacked([belief.covariance for belief in beliefs]),
        innovations=_innovations(beliefs),
        unstrained_length=np.stack([s.measurement.unstrained_length for s in steps]),
        asked=np.stack([s.asked.unstrained_length for s in steps]),
        command=np.stack([s.command.unstrained_length for s in steps]),
        latency=np.array([s.latency for s in steps]),
        limited=tuple((k, hit) for k, s in enumerate(steps) for hit in s.command.limited),
        completed=completed,
        **_truth([s.truth for s in steps]),
    )


def _truth(truths: list[State | None]) -> dict[str, Array | None]:
    """Return the truth over all cycles; None unless it is known in each of them."""
    known = [truth for truth in truths if truth is not None]
    names = {
        "position": "position", "rotation": "rotation", "twist": "twist", "tension": "tension",
        "true_length": "unstrained_length",
    }  # fmt: skip
    if len(known) < len(truths):
        return dict.fromkeys(names)
    return {
        name: _stacked([getattr(truth, field) for truth in known]) for name, field in names.items()
    }


def _stacked(values: list[Array | None]) -> Array | None:
    """Stack the values of all cycles, shape (T, ...); None if any is missing."""
    known = [value for value in values if value is not None]
    return np.stack(known) if len(known) == len(values) else None


def _innovations(beliefs: list[Belief]) -> Innovations | None:
    """Stack the innovations of all cycles if any belief has some; none count as 0."""
    innovations = [belief.innovations for belief in beliefs]
    if all(one is None for one in innovations):
        return None
    size = len(beliefs[0].position)
    names = ("squares", "dof", "rejected")
    columns = {
        name: np.stack(
            [
                np.broadcast_to(np.asarray(getattr(one, name, 0.0), dtype=float), (size,))
                for one in innovations
            ]
        )
        for name in names
    }
    return Innovations(**columns)
