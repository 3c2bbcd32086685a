"""Runs for `benchmarks.estimators`: simulated once, then heard by all estimators alike.

The kinematic solver is in the loop. Every run has the wind of the condition ``nominal-1``.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

import numpy as np

import carosac_toolkit as ct
from baselines.kinematic_solver import KinematicSolver
from baselines.kinematic_solver_controller import KinematicSolverController
from carosac_toolkit import trajectories
from carosac_toolkit.loop.loop import run
from carosac_toolkit.loop.values import Belief, Command, Measurement, State
from carosac_toolkit.robot.condition_file import find_condition
from carosac_toolkit.robot.perturbations import draw_plant
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.safety.settled import settled
from carosac_toolkit.trajectories import Trajectory
from sim_warp.driver import SimDriver, SimDriverSettings

SPEED, ACCELERATION = 2.0, 2.0  # [m/s], [m/s^2]
GENTLE = 0.7  # [m/s^2] for stop and go, which would throw the platform about and slacken cables
LENGTHS, INERTIAL = "lengths", "lengths+imu"
LONG, LOSS = 46.0, (5.0, 35.0)  # [s] of a run, without an IMU from and to
OUTLIERS = {"1 sample": (20.0, 20.01), "1 s": (20.0, 21.0)}  # [s]
JUMP = np.array([0.5, 0.0, 0.0])  # [m] that wrong lengths move the pose of rest
SLIP = 0.3  # [m] that encoders say too much from then on
BACK = 5.0  # [s] after which an estimator must have recovered
WINDOW = 5.0  # [s] after that, over which it is judged

Heard = list[tuple[Measurement, State, Command]]
Kept = TypeVar("Kept")


@dataclass(frozen=True, kw_only=True)
class Case:
    """One run.

    Attributes:
        robot: Name.
        perturbation: Condition of the plant.
        seed: Of everything that is drawn.
        kind: ``sway``, ``long``, ``centre`` or ``edge``.
    """

    robot: str
    perturbation: str
    seed: int
    kind: str

    @property
    def name(self) -> str:
        """Of its file."""
        return f"{self.robot}-{self.perturbation}-{self.kind}-{self.seed}"


@dataclass(frozen=True, kw_only=True)
class Score:
    """One estimator on one run; errors are root mean squares, NEES per degree of freedom.

    Attributes:
        case: The run.
        estimator: With its settings.
        suite: What it heard.
        position: Error over the whole run, without a fault [m].
        rotation: The same [rad].
        pose: NEES of the pose, or None without a covariance.
        full: NEES of pose and twist, or None.
        time: CPU time of an update [s].
        faults: By name, the position error over `WINDOW`, from `BACK` after the fault, and in the
            same time without it [m].
    """

    case: Case
    estimator: str
    suite: str
    position: float
    rotation: float
    pose: float | None
    full: float | None
    time: float
    faults: dict[str, tuple[float, float]]


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
    if case.kind == "sway":
        limits = {"speed_max": SPEED, "acceleration_max": ACCELERATION}
        return trajectories.build("minimum_snap", robot, case.seed, **limits)
    rng = np.random.default_rng(case.seed)
    low, high = robot.workspace_min, robot.workspace_max
    share = rng.uniform(-1.0, 1.0, (24 if case.kind == "long" else 5, 3))
    if case.kind == "edge":
        share[:, rng.integers(3)] = 0.95 * rng.choice([-1.0, 1.0])  # along one face
    elif case.kind == "centre":
        share *= 0.5
    points = 0.5 * (low + high) + 0.5 * share * (high - low)
    return trajectories.waypoints(points, rest=0.5, speed_max=SPEED, acceleration_max=GENTLE)


def record(case: Case) -> Heard:
    """Simulate a case, cables of particles."""
    robot, condition = robot_of(case.robot), find_condition(case.perturbation)
    windy = find_condition("nominal-1").of(robot)
    plant = draw_plant(robot, condition, np.random.default_rng(case.seed))
    path = path_of(case, robot)
    controller = KinematicSolverController.build(robot)
    x, y, z = (float(v) for v in path.sample(np.zeros(1)).position[0])
    settings = SimDriverSettings(
        suite=INERTIAL, period=controller.period, start_position=(x, y, z),
        wind_force=windy.wind_force, wind_time=windy.wind_time,
    )  # fmt: skip
    driver = SimDriver.build(plant, settled(settings, robot), seed=case.seed)
    recorder = Recorder(driver, robot)
    duration = LONG if case.kind == "long" else path.duration + 3.0
    run(driver, recorder, controller, path, duration=duration)
    return recorder.heard


def kept(file: Path | None, make: Callable[[], Kept]) -> Kept:
    """What an earlier call left in a file, or what is made now, and left there."""
    if file is None:
        return make()
    if file.is_file():
        known: Kept = pickle.loads(file.read_bytes())
        return known
    made = make()
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(pickle.dumps(made))
    return made
