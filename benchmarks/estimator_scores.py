"""Scores of estimators on simulated runs, without and with faults."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from baselines.kinematic_solver_controller import UnreachableReference
from benchmarks.estimator_runs import (
    BACK,
    JUMP,
    LENGTHS,
    LOSS,
    OUTLIERS,
    SLIP,
    WINDOW,
    Case,
    Heard,
    Score,
    kept,
    record,
    robot_of,
)
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.consistency import POSE_SIZE, normalised_square, state_error
from carosac_toolkit.loop.values import Belief, Measurement, State
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.robot.robot import Robot

Edit = Callable[[Measurement, State], Measurement]


def build(estimator: str, robot: Robot) -> Any:
    """An estimator by name or module:Class, with settings such as ``coupling=tight`` behind it."""
    name, *pairs = estimator.split()
    plugin = plugins.load("estimators", name)
    values = {key: number(text) for key, text in (pair.split("=") for pair in pairs)}
    return plugin.build(robot, plugin.Settings(**values) if values else None, seed=0)


def number(text: str) -> float | str:
    """A setting as a number, where it is one."""
    try:
        return float(text)
    except ValueError:
        return text


def hear(
    estimator: Any, heard: Heard, edit: Edit, start: Belief | None = None
) -> tuple[list[Belief], float]:
    """Beliefs on edited measurements, after `start` if there is one; CPU time an update [s]."""
    found: list[Belief] = []
    last, spent = start, 0.0
    for measurement, truth, command in heard:
        edited = edit(measurement, truth)
        began = process_time()
        last = estimator.reset(edited) if last is None else estimator.update(last, command, edited)
        spent += process_time() - began
        found.append(last)
    return found, spent / len(found)


def errors(heard: Heard, found: Sequence[Belief]) -> Array:
    """Truth minus belief, in the order of its covariance, shape (T, 12), (T, 6) without a twist."""
    truths = [truth for _, truth, _ in heard]
    twists = [b.twist for b in found if b.twist is not None]
    truth = State(
        time=np.concatenate([t.time for t in truths]),
        position=np.concatenate([t.position for t in truths]),
        rotation=np.concatenate([t.rotation for t in truths]),
        twist=np.concatenate([t.twist for t in truths if t.twist is not None]),
    )
    belief = Belief(
        time=np.concatenate([b.time for b in found]),
        position=np.concatenate([b.position for b in found]),
        rotation=np.concatenate([b.rotation for b in found]),
        twist=np.concatenate(twists) if len(twists) == len(found) else None,
    )
    return state_error(truth, belief)


def squares(error: Array, found: list[Belief]) -> tuple[float | None, float | None]:
    """Mean NEES of pose, and of pose and twist; None without a covariance."""
    known = [b.covariance for b in found if b.covariance is not None]
    if len(known) < len(found):
        return None, None
    covariance = np.concatenate(known)
    pose = normalised_square(error[:, :POSE_SIZE], covariance[:, :POSE_SIZE, :POSE_SIZE])
    return float(pose.mean()), float(normalised_square(error, covariance).mean())


def rms(values: Iterable[float]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(list(values)))))


def distance(error: Array) -> Array:
    """Norm of the position's error [m], shape (T,)."""
    return np.asarray(np.linalg.norm(error[:, :3], axis=1))


@dataclass(frozen=True, kw_only=True)
class Fault:
    """What may go wrong in a long run.

    Attributes:
        edit: Of what is measured meanwhile.
        begin: [s].
        end: [s], from which on an estimator has time to recover.
        stays: Whether it never ends.
    """

    edit: Edit
    begin: float
    end: float
    stays: bool = False


def faults(robot: Robot) -> dict[str, Fault]:
    """All of them, by name."""

    def blind(measurement: Measurement, _: State) -> Measurement:
        return replace(measurement, imu=None)

    def corrupt(measurement: Measurement, truth: State) -> Measurement:
        here, there = (
            straight_length(robot, truth.position + shift, truth.rotation).length
            for shift in (np.zeros(3), JUMP)
        )
        wrong = measurement.unstrained_length + there - here
        return replace(measurement, unstrained_length=wrong)

    def slip(count: int) -> Fault:
        by = np.where(np.arange(robot.n) < count, SLIP, 0.0)
        begin, end = OUTLIERS["1 sample"]
        return Fault(
            edit=lambda m, _: replace(m, unstrained_length=m.unstrained_length + by),
            begin=begin, end=end, stays=True,
        )  # fmt: skip

    return {
        "IMU lost for 30 s": Fault(edit=blind, begin=LOSS[0], end=LOSS[1]),
        **{
            f"lengths wrong by 0.5 m, {name}": Fault(edit=corrupt, begin=span[0], end=span[1])
            for name, span in OUTLIERS.items()
        },
        f"one encoder slips by {SLIP:g} m": slip(1),
        f"all encoders slip by {SLIP:g} m": slip(robot.n),
    }


def judge(case: Case, heard: Heard, estimator: str, suite: str) -> Score:
    """Run an estimator on a record, and in a long one also with each fault."""

    def seen(measurement: Measurement, _: State) -> Measurement:
        return replace(measurement, imu=None) if suite == LENGTHS else measurement

    robot = robot_of(case.robot)
    listener = build(estimator, robot)
    found, spent = hear(listener, heard, seen)
    error = errors(heard, found)
    pose, full = squares(error, found)
    hit = {}
    for name, fault in (faults(robot) if case.kind == "long" else {}).items():
        hit[name] = recovery(listener, heard, found, fault)
    return Score(
        case=case, estimator=estimator, suite=suite, position=rms(distance(error)),
        rotation=rms(np.linalg.norm(error[:, 3:6], axis=1)), pose=pose, full=full, time=spent,
        faults=hit,
    )  # fmt: skip


def recovery(listener: Any, heard: Heard, found: list[Belief], fault: Fault) -> tuple[float, float]:
    """Position error [m] in the window after a fault, with and without it.

    Args:
        listener: The estimator.
        heard: The whole run.
        found: Beliefs without the fault, from which the run with it departs.
        fault: What goes wrong.
    """
    time = np.array([m.time[0] for m, _, _ in heard])
    over = fault.end + BACK
    first, again, last = np.searchsorted(time, [fault.begin, over, over + WINDOW])

    def seen(measurement: Measurement, truth: State) -> Measurement:
        wrong = fault.stays or measurement.time[0] < fault.end
        return fault.edit(measurement, truth) if wrong else measurement

    hit, _ = hear(listener, heard[first:last], seen, found[first - 1])
    pairs = (hit[again - first :], found[again:last])
    after, usual = (rms(distance(errors(heard[again:last], part))) for part in pairs)
    return after, usual


def work(folder: Path | None, listeners: Sequence[tuple[str, str]], case: Case) -> list[Score]:
    """Estimators, each with its suite, on one run; none where no cable tensions hold its path."""

    @lru_cache
    def heard() -> Heard:
        return kept(folder and folder / f"{case.name}.pickle", lambda: record(case))

    scores = []
    for estimator, suite in listeners:
        name = f"{case.name} {estimator} {suite}.pickle"
        score = partial(lambda e, s: judge(case, heard(), e, s), estimator, suite)
        try:
            scores.append(kept(folder and folder / "scores" / name, score))
        except UnreachableReference as error:
            print(f"{case.name} left out: {error}", flush=True)
            return []
    return scores
