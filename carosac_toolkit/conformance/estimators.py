"""Checks that every estimator must pass."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.conformance.scenes import LengthPlayback, make_scene, wide_numbers
from carosac_toolkit.conformance.verdicts import (
    BATCH_TOLERANCE_M,
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
from carosac_toolkit.loop.loop import run
from carosac_toolkit.loop.values import Belief, Command, Measurement, Reference
from carosac_toolkit.robot.robot import Robot


def belief_fits(factory: Factory, robot: Robot) -> None:
    """Require a finite `Belief` of the measurement's time and batch."""
    estimator = factory(robot, seed=CHECK_SEED)
    for belief, measurement in _beliefs(estimator, make_scene(robot).measurements):
        require(isinstance(belief, Belief), f"got {type(belief).__name__}; allowed: Belief")
        size = len(belief.position)
        require(size == 1, f"got {size} poses from one measurement; allowed: 1")
        same = np.array_equal(belief.time, measurement.time)
        require(same, f"time: got {belief.time}; allowed: {measurement.time}, as measured")
        if belief.tension is not None:
            shape = np.shape(belief.tension)
            require(shape == (1, robot.n), f"tension: got shape {shape}; allowed: {(1, robot.n)}")
            require(np.isfinite(belief.tension).all(), "tension: got a number that is not finite")


def reset_forgets(factory: Factory, robot: Robot) -> None:
    """Require the same beliefs, bit by bit, for the same measurements after `reset`."""
    estimator = factory(robot, seed=CHECK_SEED)
    measurements = make_scene(robot).measurements
    first = _poses(estimator, measurements)
    again = _poses(estimator, measurements)
    require_same(first, again, "reset(): the same measurements gave other beliefs than before")


def same_seed_same_beliefs(factory: Factory, robot: Robot) -> None:
    """Require equal seeds to give equal beliefs, whatever else draws random numbers."""
    measurements = make_scene(robot).measurements
    require_repeatable(
        lambda: _poses(factory(robot, seed=CHECK_SEED), measurements),
        "seed: two estimators made with the same seed disagreed",
    )


def extremes_stay_finite(factory: Factory, robot: Robot) -> None:
    """Require finite beliefs or a clear error for impossible, repeated and late measurements."""
    first = make_scene(robot).measurements[0]
    lengths = first.unstrained_length
    strange = (
        replace(first, time=first.time + 0.02, unstrained_length=lengths * 0.0 + 1e-3),
        replace(first, time=first.time + 0.02, unstrained_length=lengths * 1e3),
        replace(first, time=first.time + 0.02, unstrained_length=lengths * [[0.5] + [2.0] * (
            robot.n - 1)]),
        first,
        replace(first, time=first.time + 1e6),
    )  # fmt: skip
    for measurement in strange:
        for series in ((first, measurement), (measurement,)):
            estimator = factory(robot, seed=CHECK_SEED)
            with wide_numbers():
                refuses("extreme but valid measurement", partial(_run, estimator, series))


def other_robot_refused(factory: Factory, robot: Robot) -> None:
    """Require a clear error for a measurement of another number of cables."""
    lengths = make_scene(robot).measurements[0].unstrained_length
    measurement = Measurement(time=np.zeros(1), unstrained_length=np.c_[lengths, lengths[:, -1:]])

    def misuse() -> None:
        factory(robot, seed=CHECK_SEED).reset(measurement)

    refused = refuses(f"lengths of {robot.n + 1} cables", misuse)
    require(refused, f"made for {robot.n} cables, it took lengths of {robot.n + 1}")


def lengths_are_enough(factory: Factory, robot: Robot) -> None:
    """Require a driver of lengths alone, without truth, to suffice, or a clear error."""
    scene = make_scene(robot)

    hold = _Hold(scene.measurements[0].unstrained_length)

    def live() -> None:
        run(LengthPlayback(scene.measurements), factory(robot, seed=CHECK_SEED), hold, scene.path)

    refuses("a driver without truth, poses, tensions and IMU", live)


def batch_equals_loop(factory: Factory, robot: Robot) -> None:
    """Require a batch of two to equal two batches of one, or to be refused."""
    measurements = make_scene(robot).measurements
    series = (measurements[:3], measurements[1:4])
    both = tuple(
        Measurement(
            time=np.concatenate([a.time, a.time]),
            unstrained_length=np.concatenate([a.unstrained_length, b.unstrained_length]),
        )
        for a, b in zip(*series, strict=True)
    )
    together: list[Array] = []

    def batched() -> None:
        together.extend(_poses(factory(robot, seed=CHECK_SEED), both))

    if refuses("a batch of two", batched):
        return
    late = tuple(replace(b, time=a.time) for a, b in zip(*series, strict=True))
    alone = [_poses(factory(robot, seed=CHECK_SEED), row) for row in (series[0], late)]
    message = "a batch of two and two batches of one"
    for pair, one, other in zip(together, *alone, strict=True):
        require_close(pair, np.concatenate([one, other]), message, BATCH_TOLERANCE_M)


ESTIMATOR_CHECKS: dict[str, Check] = {
    check.__name__: check
    for check in (
        belief_fits,
        reset_forgets,
        same_seed_same_beliefs,
        extremes_stay_finite,
        other_robot_refused,
        lengths_are_enough,
        batch_equals_loop,
    )
}


class _Hold:
    """Controller that holds still."""

    period = 0.02
    horizon = 0.0

    def __init__(self, unstrained_length: Array) -> None:
        self._length = unstrained_length

    def reset(self, belief: Belief) -> None:
        pass

    def command(self, belief: Belief, reference: Reference) -> Command:
        return Command(time=belief.time, unstrained_length=self._length)


def _beliefs(
    estimator: Any, measurements: tuple[Measurement, ...]
) -> list[tuple[Belief, Measurement]]:
    """Return beliefs after a reset with their measurements; commands are the measured lengths."""
    beliefs: list[tuple[Belief, Measurement]] = []
    with only_clear_errors("reset() and update()"):
        for measurement in measurements:
            command = Command(
                time=measurement.time, unstrained_length=measurement.unstrained_length
            )
            belief = (
                estimator.update(beliefs[-1][0], command, measurement)
                if beliefs
                else estimator.reset(measurement)
            )
            beliefs.append((belief, measurement))
    return beliefs


def _poses(estimator: Any, measurements: tuple[Measurement, ...]) -> list[Array]:
    """Return position and rotation at each step, shape (B, 12)."""
    return [
        np.concatenate([belief.position, belief.rotation.reshape(-1, 9)], axis=1)
        for belief, _ in _beliefs(estimator, measurements)
    ]


def _run(estimator: Any, measurements: tuple[Measurement, ...]) -> None:
    """Check what `Belief` itself does not check."""
    for belief, _ in _beliefs(estimator, measurements):
        finite = belief.tension is None or bool(np.isfinite(belief.tension).all())
        require(finite, "extreme but valid measurement: tension: got a number that is not finite")
