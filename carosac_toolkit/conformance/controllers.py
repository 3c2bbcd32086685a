"""Checks that every controller must pass."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.conformance.scenes import (
    LengthPlayback,
    make_scene,
    other_robot,
    stacked,
    wide_numbers,
)
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


def period_and_horizon(factory: Factory, robot: Robot) -> None:
    """Require a positive, finite `period` and a finite `horizon` >= 0."""
    controller = factory(robot, seed=CHECK_SEED)
    for name, allowed in (("period", "> 0"), ("horizon", ">= 0")):
        value: Any = getattr(controller, name, None)
        number = isinstance(value, float | int) and not isinstance(value, bool)
        good = number and np.isfinite(value) and (value > 0.0 or (value == 0.0 and "=" in allowed))
        require(good, f"{name}: got {value!r}; allowed: a finite number of seconds {allowed}")


def command_fits(factory: Factory, robot: Robot) -> None:
    """Require a `Command` of the belief's time, with one positive length per cable."""
    scene = make_scene(robot)
    controller = factory(robot, seed=CHECK_SEED)
    controller.reset(scene.beliefs[0])
    references = scene.references(controller.period, controller.horizon)
    for belief, reference in zip(scene.beliefs, references, strict=True):
        with only_clear_errors("command()"):
            command = controller.command(belief, reference)
        got = type(command).__name__
        require(isinstance(command, Command), f"command(): got {got}; allowed: Command")
        shape = command.unstrained_length.shape
        require(shape == (1, robot.n), f"command(): got lengths of shape {shape}; "
                f"allowed: {(1, robot.n)}")  # fmt: skip
        low = float(command.unstrained_length.min())
        require(low > 0.0, f"command(): got a length of {low} m; allowed: > 0 m")
        require(np.array_equal(command.time, belief.time), f"command().time: got {command.time}; "
                f"allowed: {belief.time}, that of the belief")  # fmt: skip


def reset_forgets(factory: Factory, robot: Robot) -> None:
    """Require the same commands, bit by bit, for the same inputs after `reset`."""
    controller = factory(robot, seed=CHECK_SEED)
    first = _commands(controller, robot)
    again = _commands(controller, robot)
    require_same(first, again, "reset(): the same inputs gave other commands than before")


def same_seed_same_commands(factory: Factory, robot: Robot) -> None:
    """Require equal seeds to give equal commands, whatever else draws random numbers."""
    require_repeatable(
        lambda: _commands(factory(robot, seed=CHECK_SEED), robot),
        "seed: two controllers made with the same seed disagreed",
    )


def extremes_stay_finite(factory: Factory, robot: Robot) -> None:
    """Require finite lengths or a clear error for far, fast and rotated inputs."""
    scene = make_scene(robot)
    controller = factory(robot, seed=CHECK_SEED)
    calm = scene.references(controller.period, controller.horizon)[0]
    start = scene.beliefs[0]
    upside_down = np.diag([1.0, -1.0, -1.0])[None]
    fast = np.full((1, 6), 50.0)
    beliefs = (
        replace(start, position=start.position + 1e3),
        replace(start, rotation=upside_down, twist=fast),
        replace(start, time=start.time + 1e6),
        replace(start, position=robot.exit_points[:1] - robot.anchor_points[:1]),
    )
    references = (
        calm,
        replace(calm, position=calm.position + 1e3, velocity=calm.velocity + 1e3),
        replace(calm, position=calm.position * 0.0 + robot.exit_points[0]),
        replace(calm, acceleration=calm.acceleration - 1e4),
    )
    for belief, reference in product(beliefs, references):
        with wide_numbers():
            refuses("extreme but valid input", partial(_once, controller, belief, reference))


def bare_belief_is_enough(factory: Factory, robot: Robot) -> None:
    """Require a belief of a pose alone to suffice, or an error that says what is missing."""
    scene = make_scene(robot)
    controller = factory(robot, seed=CHECK_SEED)
    reference = scene.references(controller.period, controller.horizon)[0]
    refuses("a belief without twist, covariance, tension and memory",
            lambda: _once(controller, scene.beliefs[0], reference))  # fmt: skip


def other_robot_refused(factory: Factory, robot: Robot) -> None:
    """Require a clear error for another number of cables, in the loop at the latest."""
    scene = make_scene(robot)

    def misuse() -> None:
        controller = factory(other_robot(robot), seed=CHECK_SEED)
        estimator = _Fixed(scene.beliefs[0])
        run(LengthPlayback(scene.measurements), estimator, controller, scene.path, duration=0.1)

    refused = refuses(f"a robot of {robot.n + 1} cables", misuse)
    require(refused, f"made for {robot.n + 1} cables, it commanded {robot.n}")


def batch_equals_loop(factory: Factory, robot: Robot) -> None:
    """Require a batch of two to equal two batches of one, or to be refused."""
    scene = make_scene(robot)
    period, horizon = (getattr(factory(robot, seed=CHECK_SEED), x) for x in ("period", "horizon"))
    references = scene.references(period, horizon)
    pairs = [(scene.beliefs[k], references[k]) for k in (1, 3)]
    (one, ahead), (other, further) = pairs
    both = Belief(
        time=np.concatenate([one.time, other.time]),
        position=np.concatenate([one.position, other.position]),
        rotation=np.concatenate([one.rotation, other.rotation]),
    )
    together: list[Array] = []

    def batched() -> None:
        command = _once(factory(robot, seed=CHECK_SEED), both, stacked(ahead, further))
        together.append(command.unstrained_length)

    if refuses("a batch of two", batched):
        return
    alone = [_once(factory(robot, seed=CHECK_SEED), *pair).unstrained_length for pair in pairs]
    message = "a batch of two and two batches of one"
    require_close(together[0], np.concatenate(alone), message, BATCH_TOLERANCE_M)


CONTROLLER_CHECKS: dict[str, Check] = {
    check.__name__: check
    for check in (
        period_and_horizon,
        command_fits,
        reset_forgets,
        same_seed_same_commands,
        extremes_stay_finite,
        bare_belief_is_enough,
        other_robot_refused,
        batch_equals_loop,
    )
}


class _Fixed:
    """Estimator that always returns the same belief."""

    def __init__(self, belief: Belief) -> None:
        self._belief = belief

    def reset(self, measurement: Measurement) -> Belief:
        return replace(self._belief, time=measurement.time)

    def update(self, belief: Belief, command: Command, measurement: Measurement) -> Belief:
        return self.reset(measurement)


def _once(controller: Any, belief: Belief, reference: Reference) -> Command:
    """Return one command after a reset."""
    controller.reset(belief)
    command: Command = controller.command(belief, reference)
    return command


def _commands(controller: Any, robot: Robot) -> list[Array]:
    """Return the lengths along a scene, after a reset."""
    scene = make_scene(robot)
    controller.reset(scene.beliefs[0])
    pairs = zip(scene.beliefs, scene.references(controller.period, controller.horizon), strict=True)
    return [np.array(controller.command(b, r).unstrained_length) for b, r in pairs]
