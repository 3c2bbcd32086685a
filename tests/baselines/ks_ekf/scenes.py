"""A swaying robot, measured once; beliefs of any estimator on the same measurements."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

import carosac_toolkit as ct
from baselines.kinematic_solver import KinematicSolver
from baselines.kinematic_solver_controller import KinematicSolverController
from baselines.ks_ekf import KsEkf, KsEkfSettings
from carosac_toolkit import trajectories
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.drivers.sensors import PERFECT_SENSORS, SensorSettings
from carosac_toolkit.loop.consistency import normalised_square, state_error
from carosac_toolkit.loop.loop import run
from carosac_toolkit.loop.values import Belief, Command, Measurement, State
from sim_warp.driver import SimDriver, SimDriverSettings

DURATION = 6.0
STEPS = round(DURATION / 0.02)


class Recorder:
    """The kinematic solver in the loop, and everything it was told."""

    def __init__(self, driver: SimDriver, robot: ct.Robot) -> None:
        self._driver, self._inner = driver, KinematicSolver.build(robot)
        self.steps: list[tuple[Measurement, State, Belief]] = []

    def reset(self, measurement: Measurement) -> Belief:
        return self._kept(measurement, self._inner.reset(measurement))

    def update(self, belief: Belief, command: Command, measurement: Measurement) -> Belief:
        return self._kept(measurement, self._inner.update(belief, command, measurement))

    def _kept(self, measurement: Measurement, belief: Belief) -> Belief:
        self.steps.append((measurement, self._driver.truth(), belief))
        return belief


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """What was measured, what was true, and what the kinematic solver said."""

    robot: ct.Robot
    steps: list[tuple[Measurement, State, Belief]]

    @property
    def solver_error(self) -> float:
        """Position error of the kinematic solver, root mean square [m]."""
        error = [truth.position - belief.position for _, truth, belief in self.steps]
        return rms(np.concatenate(error))

    def leading(self, lead: float, cycles: int) -> Run:
        """The same with readings of some cycles later, on a robot that says that they lead [s]."""
        kept = self.steps[: len(self.steps) - cycles]
        steps = []
        for (measurement, truth, belief), (later, _, _) in zip(
            kept, self.steps[cycles:], strict=True
        ):
            stamp = replace(later.length_rate, time=later.length_rate.time - lead)
            lengths = later.unstrained_length
            early = replace(measurement, unstrained_length=lengths, length_rate=stamp)
            steps.append((early, truth, belief))
        return Run(robot=replace(self.robot, length_delay=lead), steps=steps)

    def until(self, count: int) -> Run:
        """Its first measurements."""
        return replace(self, steps=self.steps[:count])


@lru_cache
def swaying(seed: int, *, perfect: bool = False) -> Run:
    """A move of carosac that leaves it swaying, with an IMU."""
    robot = ct.load_robot("carosac")
    path = trajectories.build("minimum_snap", robot, seed, speed_max=2.0, acceleration_max=1.5)
    start = tuple(float(x) for x in path.sample(np.zeros(1)).position[0])
    controller = KinematicSolverController.build(robot)
    settings = SimDriverSettings(
        suite="lengths+imu", cables="catenary", start_position=start, period=controller.period,
        sensors=PERFECT_SENSORS if perfect else SensorSettings(),
    )  # fmt: skip
    driver = SimDriver.build(robot, settings, seed=seed)
    recorder = Recorder(driver, robot)
    run(driver, recorder, controller, path, duration=DURATION)
    return Run(robot=robot, steps=recorder.steps)


def beliefs(
    scene: Run,
    settings: KsEkfSettings | None = None,
    edit: Callable[[int, Measurement], Measurement] = lambda k, measurement: measurement,
    *,
    start: Sequence[Belief] = (),
) -> list[Belief]:
    """Run the filter on a scene whose measurements may be edited, maybe after first beliefs."""
    estimator = KsEkf.build(scene.robot, settings)
    found = list(start)
    for k, (original, _, _) in enumerate(scene.steps[len(start) :], start=len(start)):
        measurement = edit(k, original)
        command = Command(time=measurement.time, unstrained_length=measurement.unstrained_length)
        if found:
            found.append(estimator.update(found[-1], command, measurement))
        else:
            found.append(estimator.reset(measurement))
    return found


@lru_cache
def nominal(scene: Run) -> tuple[Belief, ...]:
    """Beliefs with default settings on what was measured."""
    return tuple(beliefs(scene))


def errors(scene: Run, found: Sequence[Belief]) -> Array:
    """Truth minus belief, in the order of its covariance, shape (T, 12)."""
    pairs = zip(scene.steps, found, strict=True)
    return np.concatenate([state_error(truth, belief) for (_, truth, _), belief in pairs])


def squares(scene: Run, found: Sequence[Belief]) -> Array:
    """Normalised error squared of pose and twist, shape (T,)."""
    covariance = np.concatenate([belief.covariance for belief in found])
    return normalised_square(errors(scene, found), covariance)


def rms(error: Array) -> float:
    """Root mean square of the norm of rows."""
    return float(np.sqrt((error**2).sum(axis=1).mean()))
