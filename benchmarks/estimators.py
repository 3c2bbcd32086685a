"""Estimators on the same swaying runs: accuracy, consistency, faults, time.

Each run is simulated once, with the kinematic solver in the loop; all estimators then hear the
same measurements.
"""

from __future__ import annotations

import argparse
import multiprocessing
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache
from time import process_time
from typing import Any

import numpy as np

import carosac_toolkit as ct
from baselines.kinematic_solver import KinematicSolver
from baselines.kinematic_solver_controller import KinematicSolverController, UnreachableReference
from benchmarks.results import table, write_section
from carosac_toolkit import registry, trajectories
from carosac_toolkit.arrays import Array
from carosac_toolkit.consistency import band, normalised_square, state_error
from carosac_toolkit.errors import CarosacError
from carosac_toolkit.loop import run
from carosac_toolkit.perturbations import draw_plant, find_condition
from carosac_toolkit.physics.straight_line import straight_length
from carosac_toolkit.robot import Robot
from carosac_toolkit.trajectories import Trajectory
from carosac_toolkit.values import Belief, Command, Measurement, State
from sim_warp.driver import SimDriver, SimDriverSettings

COMMAND = "python -m benchmarks.estimators"
SPEED, ACCELERATION = 2.0, 2.0  # [m/s], [m/s^2]
GENTLE = 0.7  # [m/s^2] for stop and go, which would throw the platform about and slacken cables
KS = "kinematic_solver"
EKF = "baselines.ks_ekf:KsEkf"
DYNAMIC = "baselines.dynamic_estimator:DynamicEstimator"
LOOSE, TIGHT = f"{EKF} coupling=loose", f"{EKF} coupling=tight"
MATCHED = f"{TIGHT} length_walk=0"  # all errors constant, as where the plant is the model
LENGTHS, INERTIAL = "lengths", "lengths+imu"
LONG, LOSS = 52.0, (10.0, 40.0)  # [s] of a run, without an IMU from and to
OUTLIERS = {"1 sample": (20.0, 20.01), "1 s": (20.0, 21.0)}  # [s]
JUMP = np.array([0.5, 0.0, 0.0])  # [m] that wrong lengths move the pose of rest
BACK = 5.0  # [s] after which an estimator must have recovered
WINDOW = 5.0  # [s] after that, over which it is judged

Heard = list[tuple[Measurement, State, Command]]
Edit = Callable[[int, Measurement], Measurement]


@dataclass(frozen=True, kw_only=True)
class Case:
    """One run.

    Attributes:
        robot: Name.
        perturbation: Condition of the plant.
        seed: Of everything that is drawn.
        kind: ``sway``, ``long``, ``centre`` or ``edge``.
        estimators: Names, each with its settings behind it.
    """

    robot: str
    perturbation: str
    seed: int
    kind: str
    estimators: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Score:
    """One estimator on one run; errors are root mean squares, NEES per degree of freedom."""

    case: Case
    estimator: str
    suite: str
    fault: str
    position: float
    rotation: float
    pose: float | None
    full: float | None
    time: float
    recovered: float | None = None


class Recorder:
    """The kinematic solver, and all that it hears."""

    def __init__(self, driver: SimDriver, robot: Robot) -> None:
        self._driver, self._inner = driver, KinematicSolver.build(robot)
        self.heard: Heard = []

    def reset(self, measurement: Measurement) -> Belief:
        """Start."""
        lengths = measurement.unstrained_length
        applied = Command(time=measurement.time, unstrained_length=lengths)
        self.heard.append((measurement, self._driver.truth(), applied))
        return self._inner.reset(measurement)

    def update(self, belief: Belief, command: Command, measurement: Measurement) -> Belief:
        """Go on."""
        self.heard.append((measurement, self._driver.truth(), command))
        return self._inner.update(belief, command, measurement)


@lru_cache
def robot_of(name: str) -> Robot:
    """A bundled robot, once per process."""
    return ct.load_robot(name)


def path_of(case: Case, robot: Robot) -> Trajectory:
    """Where the platform is to go."""
    limits = {"speed_max": SPEED, "acceleration_max": ACCELERATION}
    if case.kind == "sway":
        return trajectories.build("minimum_snap", robot, case.seed, **limits)
    rng = np.random.default_rng(case.seed)
    low, high = robot.workspace_min, robot.workspace_max
    count = 24 if case.kind == "long" else 5
    share = rng.uniform(-1.0, 1.0, (count, 3))
    if case.kind == "edge":
        share[:, rng.integers(3)] = 0.95 * rng.choice([-1.0, 1.0])  # along one face
    elif case.kind == "centre":
        share *= 0.5
    points = 0.5 * (low + high) + 0.5 * share * (high - low)
    gentle = {"speed_max": SPEED, "acceleration_max": GENTLE}
    return trajectories.waypoints(points, rest=0.5, **gentle)


def record(case: Case) -> Heard:
    """Simulate a case, cables of particles."""
    robot, condition = robot_of(case.robot), find_condition(case.perturbation)
    plant = draw_plant(robot, condition, np.random.default_rng(case.seed))
    path = path_of(case, robot)
    controller = KinematicSolverController.build(robot)
    x, y, z = (float(v) for v in path.sample(np.zeros(1)).position[0])
    settings = SimDriverSettings(
        suite=INERTIAL, period=controller.period, start_position=(x, y, z),
        wind_force=condition.wind_force, wind_time=condition.wind_time,
    )  # fmt: skip
    driver = SimDriver.build(plant, settings, seed=case.seed)
    recorder = Recorder(driver, robot)
    duration = LONG if case.kind == "long" else path.duration + 3.0
    run(driver, recorder, controller, path, duration=duration)
    return recorder.heard


def build(estimator: str, robot: Robot) -> Any:
    """An estimator by name or module:Class, with settings such as ``coupling=tight`` behind it."""
    name, *pairs = estimator.split()
    plugin = registry.load("estimators", name)
    values = {key: number(text) for key, text in (pair.split("=") for pair in pairs)}
    return plugin.build(robot, plugin.Settings(**values) if values else None, seed=0)


def number(text: str) -> float | str:
    """A setting as a number, where it is one."""
    try:
        return float(text)
    except ValueError:
        return text


def hear(estimator: Any, heard: Heard, edit: Edit) -> tuple[list[Belief], float]:
    """Beliefs on edited measurements, and CPU time per update [s]."""
    found: list[Belief] = []
    spent = 0.0
    for k, (measurement, _, command) in enumerate(heard):
        edited = edit(k, measurement)
        began = process_time()
        if found:
            found.append(estimator.update(found[-1], command, edited))
            spent += process_time() - began
        else:
            found.append(estimator.reset(edited))
    return found, spent / max(len(found) - 1, 1)


def judge(
    case: Case, estimator: str, suite: str, heard: Heard, *,
    fault: str = "", edit: Edit = lambda k, m: m, end: float | None = None,
) -> Score:  # fmt: skip
    """Run an estimator on a record; `end` is when a fault is over [s]."""

    def seen(k: int, measurement: Measurement) -> Measurement:
        edited = edit(k, measurement)
        return replace(edited, imu=None) if suite == LENGTHS else edited

    found, spent = hear(build(estimator, robot_of(case.robot)), heard, seen)
    truths = [truth for _, truth, _ in heard]
    error = [state_error(truth, b)[0] for truth, b in zip(truths, found, strict=True)]
    distance = np.array([np.linalg.norm(e[:3]) for e in error])
    angle = np.array([np.linalg.norm(e[3:6]) for e in error])
    recovered = None
    if end is not None:
        time = np.array([m.time[0] for m, _, _ in heard])
        after = (time >= end + BACK) & (time < end + BACK + WINDOW)
        recovered = rms(distance[after])
    pose, full = squares(error, found)
    return Score(
        case=case, estimator=estimator, suite=suite, fault=fault, position=rms(distance),
        rotation=rms(angle), pose=pose, full=full, time=spent, recovered=recovered,
    )  # fmt: skip


def squares(error: list[Array], found: list[Belief]) -> tuple[float | None, float | None]:
    """Mean NEES of pose, and of pose and twist; None without a covariance."""
    if found[-1].covariance is None:
        return None, None
    covariance = np.concatenate([b.covariance for b in found if b.covariance is not None])
    late = np.array(error)[-len(covariance) :]
    full = normalised_square(late, covariance)
    return float(normalised_square(late[:, :6], covariance[:, :6, :6]).mean()), float(full.mean())


def rms(values: Iterable[float]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(list(values)))))


def faults(heard: Heard, robot: Robot) -> dict[str, tuple[Edit, float]]:
    """What may go wrong in a long run, and when it is over [s]."""

    def blind(k: int, m: Measurement) -> Measurement:
        return replace(m, imu=None) if LOSS[0] <= m.time[0] < LOSS[1] else m

    def corrupt(first: float, last: float) -> Edit:
        def edit(k: int, m: Measurement) -> Measurement:
            if not first <= m.time[0] < last:
                return m
            truth = heard[k][1]
            here, there = (
                straight_length(robot, truth.position + shift, truth.rotation).length
                for shift in (np.zeros(3), JUMP)
            )
            return replace(m, unstrained_length=m.unstrained_length + there - here)

        return edit

    wrong = {
        f"lengths wrong by 0.5 m, {name}": (corrupt(*span), span[1])
        for name, span in OUTLIERS.items()
    }
    return {"IMU lost for 30 s": (blind, LOSS[1])} | wrong


def work(case: Case) -> list[Score]:
    """All estimators on one run; none where the path leaves what the cables can hold."""
    try:
        heard = record(case)
    except UnreachableReference as error:
        print(f"{case.robot} {case.kind} {case.seed} left out: {error}", flush=True)
        return []
    scores = []
    for estimator in case.estimators:
        if case.kind == "long":
            for fault, (edit, end) in faults(heard, robot_of(case.robot)).items():
                usual = judge(case, estimator, INERTIAL, heard, fault=f"without: {fault}", end=end)
                hit = judge(case, estimator, INERTIAL, heard, fault=fault, edit=edit, end=end)
                scores += [usual, hit]
            continue
        scores.append(judge(case, estimator, INERTIAL, heard))
        if case.kind == "sway" and estimator not in (KS, LOOSE, MATCHED):
            scores.append(judge(case, estimator, LENGTHS, heard))
    return scores


def cases(robots: Sequence[str], seeds: int, estimators: tuple[str, ...]) -> list[Case]:
    """All runs; the longest first."""
    few = max(1, seeds // 4)
    found = []
    for robot in robots:
        inertial = tuple(e for e in estimators if e != KS)
        for seed in range(few):
            found.append(
                Case(robot=robot, perturbation="nominal-1", seed=seed, kind="long",
                     estimators=inertial)
            )  # fmt: skip
    for robot in robots:
        for perturbation in ("none", "nominal-1"):
            for seed in range(seeds):
                found.append(
                    Case(robot=robot, perturbation=perturbation, seed=seed, kind="sway",
                         estimators=estimators)
                )  # fmt: skip
        for kind in ("centre", "edge"):
            for seed in range(2 * few):
                found.append(
                    Case(robot=robot, perturbation="nominal-1", seed=seed, kind=kind,
                         estimators=estimators)
                )  # fmt: skip
    return found


def short(estimator: str) -> str:
    """Name in a table."""
    name, *settings = estimator.split()
    return " ".join(
        [name.split(":")[0].split(".")[-1], *(s.removeprefix("coupling=") for s in settings)]
    )


def accuracy(scores: list[Score], robots: Sequence[str]) -> str:
    """Errors, consistency and time on the swaying moves."""
    rows = []
    for robot in robots:
        for perturbation in ("none", "nominal-1"):
            chosen = [
                s for s in scores
                if (s.case.robot, s.case.perturbation, s.case.kind) == (robot, perturbation, "sway")
            ]  # fmt: skip
            solver = rms(s.position for s in chosen if s.estimator == KS)
            for name, suite in dict.fromkeys((s.estimator, s.suite) for s in chosen):
                mine = [s for s in chosen if (s.estimator, s.suite) == (name, suite)]
                pooled = rms(s.position for s in mine)
                rows.append(
                    (
                        robot, perturbation, LENGTHS if name == KS else suite, short(name),
                        f"{1e3 * np.median([s.position for s in mine]):.1f}",
                        f"{1e3 * pooled:.1f}", f"{pooled / solver:.3f}",
                        f"{1e3 * rms(s.rotation for s in mine):.1f}",
                        consistency([s.pose for s in mine], 6),
                        consistency([s.full for s in mine], 12),
                        f"{1e3 * np.median([s.time for s in mine]):.1f}",
                    )
                )  # fmt: skip
    header = (
        "robot", "plant", "suite", "estimator", "position RMSE, median of seeds [mm]",
        "all seeds [mm]", "over KS", "rotation RMSE [mrad]", "NEES of the pose (95 % band)",
        "NEES of pose and twist (95 % band)", "CPU time an update [ms]",
    )  # fmt: skip
    return table(header, rows)


def consistency(values: Sequence[float | None], dof: int) -> str:
    """Mean of NEES over runs, with the band of as many independent samples."""
    known = [v for v in values if v is not None]
    if not known:
        return "-"
    low, high = band(dof, len(known))
    return f"{np.mean(known):.2f} ({low:.2f}-{high:.2f})"


def recovery(scores: list[Score], robots: Sequence[str]) -> str:
    """How estimators come back from faults."""
    rows = []
    for robot in robots:
        hit = [s for s in scores if s.case.robot == robot and s.recovered is not None]
        for name, fault in dict.fromkeys((s.estimator, s.fault) for s in hit):
            if fault.startswith("without"):
                continue
            mine = [s for s in hit if (s.estimator, s.fault) == (name, fault)]
            usual = [s for s in hit if (s.estimator, s.fault) == (name, f"without: {fault}")]
            after, before = (rms(s.recovered or 0.0 for s in part) for part in (mine, usual))
            whole = rms(s.position for s in usual)
            rows.append(
                (robot, short(name), fault, f"{1e3 * whole:.1f}", f"{1e3 * before:.1f}",
                 f"{1e3 * after:.1f}", f"{after / whole:.2f}")
            )  # fmt: skip
    header = (
        "robot", "estimator", "fault", "without it, whole run [mm]",
        "without it, 5 to 10 s after it would end [mm]", "5 to 10 s after it [mm]",
        "over the whole run without it",
    )  # fmt: skip
    return table(header, rows)


def workspace(scores: list[Score], robots: Sequence[str]) -> str:
    """Along the faces of the workspace box against its middle."""
    rows = []
    for robot in robots:
        near = [s for s in scores if s.case.robot == robot and s.case.kind in ("centre", "edge")]
        for name in dict.fromkeys(s.estimator for s in near):
            both = [
                rms(s.position for s in near if (s.estimator, s.case.kind) == (name, kind))
                for kind in ("centre", "edge")
            ]
            rows.append(
                (robot, short(name), *(f"{1e3 * e:.1f}" for e in both), f"{both[1] / both[0]:.2f}")
            )
    return table(("robot", "estimator", "centre [mm]", "outer 10 % [mm]", "ratio"), rows)


def optional() -> list[str]:
    """The dynamic estimator, where it is there."""
    try:
        registry.load("estimators", DYNAMIC)
    except CarosacError as error:
        print(f"left out: {error}", flush=True)
        return []
    return [DYNAMIC]


def main() -> None:
    """Measure and write the section."""
    parser = argparse.ArgumentParser(prog=COMMAND, description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--robots", nargs="+", default=["carosac", "scampi"])
    parser.add_argument("--estimators", nargs="+", help="name or module:Class, settings behind it")
    parser.add_argument("--processes", type=int, default=2)
    asked = parser.parse_args()
    estimators = tuple(asked.estimators or [KS, LOOSE, TIGHT, MATCHED, *optional()])
    todo = cases(asked.robots, asked.seeds, estimators)
    spawn = multiprocessing.get_context("spawn")
    scores: list[Score] = []
    left_out = 0
    with ProcessPoolExecutor(asked.processes, mp_context=spawn) as pool:
        for case, found in zip(todo, pool.map(work, todo), strict=True):
            scores += found
            left_out += not found
            said = " ".join(f"{short(s.estimator)}:{1e3 * s.position:.1f}" for s in found)
            print(case.robot, case.perturbation, case.kind, case.seed, said, flush=True)
    body = (
        f"{asked.seeds} minimum-snap moves a line, up to {SPEED:g} m/s and {ACCELERATION:g} m/s^2, "
        "in the simulator with cables of particles; the kinematic solver (KS) is in the loop, and "
        "all estimators hear the same measurements. Errors of a run go together, since biases are "
        "constant, so the bands are those of one sample a run. Left out, as their path leaves what "
        f"the cables can hold: {left_out} of {len(todo)} runs.\n\n"
        + accuracy(scores, asked.robots)
        + "\n\nFaults, suite `lengths+imu`, plant `nominal-1`, stop and go for "
        f"{LONG:g} s at {GENTLE:g} m/s^2, {max(1, asked.seeds // 4)} seeds:\n\n"
        + recovery(scores, asked.robots)
        + f"\n\nMoves within the middle half of the workspace box and along a face of it, "
        f"{GENTLE:g} m/s^2, plant `nominal-1`, {2 * max(1, asked.seeds // 4)} seeds:\n\n"
        + workspace(scores, asked.robots)
    )
    print(body)
    write_section("estimators", "Estimators in sway", COMMAND, body)


if __name__ == "__main__":
    main()
