"""Drives in which MPC says what it would do, whoever commands (DAgger).

References:
    Ross, Gordon, Bagnell, A reduction of imitation learning and structured prediction to no-regret
    online learning, *AISTATS*, 2011.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from baselines.mpc.geometry import excess_at, geometry_at
from baselines.mpc.plan import Plan, pose_of
from baselines.mpc.settings import MpcSettings
from baselines.mpc.target_reader import TargetReader
from carosac_toolkit import trajectories
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.extras import MissingExtra
from carosac_toolkit.base.numbers import check_whole
from carosac_toolkit.base.scaled import Scaled, resolved
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.loop import run
from carosac_toolkit.loop.protocols import Driver, Estimator
from carosac_toolkit.loop.values import Belief, Command, Reference
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.condition_file import find_condition
from carosac_toolkit.robot.perturbations import Condition, draw_plant
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.safety.settled import settled
from carosac_toolkit.trajectories import Trajectory
from learned.approximate_mpc.controller import PlanFollower
from learned.approximate_mpc.elsewhere import elsewhere
from learned.approximate_mpc.plan_inputs import (
    INPUT_MAX,
    PlanInputs,
    PlanNumbers,
    PlanReader,
    PlanSource,
    UnreadableInputs,
)
from learned.approximate_mpc.teacher import Teacher

CALM_TIME = Scaled(2.5, "s")  # of holding still behind a path
SNAP_SHARE = 0.25  # of the drives, along minimum-snap paths; the others are straight moves
OUTER_SHARE = 0.6  # of the straight moves, between points near the faces of the box
OUTER_BOX_SHARE = 0.85  # of the half box, from which on a point is near them
PATH_TRIES_MAX = 100
PLANT_TRIES_MAX = 20  # at one start


@dataclass(frozen=True, kw_only=True)
class DemonstrationSettings:
    """Drives, and what is asked of MPC in them; numbers with a unit are those of ``carosac``.

    Attributes:
        condition: From which plants and the wind are drawn.
        suite: Sensors.
        estimator: Whose beliefs the controller gets.
        speed_max: Of the paths, at most [m/s].
        acceleration_max: The same [m/s^2].
        every: Answers are kept once in so many commands.
        nearby: Further questions each time, about states near the one that was met.
        elsewhere: Further questions of a drive, about states near some that were met, carried to
            other places with another centre of mass.
        place_spread: Of states near another, one sigma per axis [m].
        turn_spread: The same of rotations [rad].
        speed_spread: Of velocities [m/s].
        spin_spread: Of angular velocities [rad/s].
        push_spread: Of the acceleration that the model does not know [m/s^2].
        moment_spread: The same of angular ones [rad/s^2].
    """

    condition: str = "nominal-1"
    suite: str = "lengths+imu"
    estimator: str = "dynamic_estimator"
    speed_max: float = Scaled(2.0, "m/s")
    acceleration_max: float = Scaled(3.0, "m/s^2")
    every: int = 3
    nearby: int = 2
    elsewhere: int = 90
    place_spread: float = Scaled(0.015, "m")
    turn_spread: float = 0.015
    speed_spread: float = Scaled(0.08, "m/s")
    spin_spread: float = Scaled(0.05, "rad/s")
    push_spread: float = Scaled(0.1, "m/s^2")
    moment_spread: float = Scaled(0.1, "rad/s^2")

    def __post_init__(self) -> None:
        """Refuse counts that make no sense."""
        for name, least in (("every", 1), ("nearby", 0), ("elsewhere", 0)):
            check_whole(name, getattr(self, name), least)


@dataclass(frozen=True, kw_only=True, eq=False)
class Demonstrations:
    """What MPC answered.

    Attributes:
        numbers: That a network reads, shape (K, m).
        tension: First tensions of the plan [N], shape (K, n).
        excess: Sag less stretch that belong to them [m], shape (K, n).
        error: RMS distance from the reference in the drive [m]; NaN: it was given up.
        lost: Why, or nothing.
        cpu_time: CPU time of the drive [s].
    """

    numbers: Array
    tension: Array
    excess: Array
    error: float
    lost: str
    cpu_time: float

    def save(self, path: Path) -> None:
        """Write a file."""
        np.savez_compressed(
            path, numbers=self.numbers.astype(np.float32), tension=self.tension,
            excess=self.excess, error=self.error, lost=self.lost, cpu_time=self.cpu_time,
        )  # fmt: skip

    @classmethod
    def load(cls, path: Path) -> Demonstrations:
        """Read a file that `save` wrote."""
        with np.load(path) as data:
            return cls(
                numbers=data["numbers"], tension=data["tension"], excess=data["excess"],
                error=float(data["error"]), lost=str(data["lost"]),
                cpu_time=float(data["cpu_time"]),
            )  # fmt: skip


def demonstrate(
    robot: Robot,
    settings: DemonstrationSettings,
    mpc: MpcSettings,
    seed: tuple[int, int],
    network: PlanSource | None = None,
    reader: PlanReader | None = None,
    longest: float = np.inf,
) -> Demonstrations:
    """Drive a plant along a path, and ask MPC on the way.

    Args:
        robot: The nominal robot.
        settings: Settings.
        mpc: Of the teacher.
        seed: Of the training and of this drive.
        network: That drives; None: MPC does.
        reader: Gives the numbers that are kept; None: `PlanNumbers`.
        longest: Time after which a path is left [s].
    """
    began = time.process_time()
    chosen = resolved(settings, Scales(robot).ratios)
    rng = np.random.default_rng([*seed, 13])
    path, plant = draw_drive(robot, chosen, rng)
    controller = _Asking(robot, chosen, mpc, rng, network, reader)
    driver, estimator = build_drive(robot, plant, chosen, path, controller.period, rng)
    duration = min(path.duration, longest) + CALM_TIME.of(Scales(robot).ratios)
    error, lost = float("nan"), ""
    try:
        log = run(driver, estimator, controller, path, duration=duration)
    except (InvalidField, MissingExtra):
        raise  # that is no matter of driving
    except CarosacError as reason:  # it is lost; what was learned on the way there counts
        lost = str(reason)
    else:
        assert log.position is not None
        away = np.linalg.norm(log.position - log.reference, axis=2)
        error = float(np.sqrt((away**2).mean()))
    controller.ask_elsewhere(find_condition(chosen.condition).of(robot).center_of_mass)
    return controller.demonstrations(error, lost, time.process_time() - began)


def draw_drive(
    robot: Robot, settings: DemonstrationSettings, rng: np.random.Generator
) -> tuple[Trajectory, Robot]:
    """Draw a path, and a plant that can rest where it begins; where hardly any can, another path.

    Raises:
        NoRest: None could, on many paths.
    """
    condition = find_condition(settings.condition)
    for _ in range(PATH_TRIES_MAX):
        path = draw_path(robot, settings, rng)
        try:
            return path, draw_resting(robot, condition, path.sample(np.zeros(1)).position[0], rng)
        except NoRest as error:
            reason = error
    raise reason


def build_drive(
    robot: Robot,
    plant: Robot,
    settings: DemonstrationSettings,
    path: Trajectory,
    period: float,
    rng: np.random.Generator,
) -> tuple[Driver, Estimator]:
    """Return a plant where a path begins, behind sensors, and an estimator.

    Args:
        robot: The nominal robot.
        plant: That is simulated.
        settings: Settings, with numbers of this robot.
        path: The path.
        period: Time between two commands [s].
        rng: Draws the seed of all noise.
    """
    condition = find_condition(settings.condition)
    kind = plugins.load("drivers", "simulator")
    start = path.sample(np.zeros(1)).position[0]
    driver_settings = replace(
        kind.Settings(),
        suite=settings.suite,
        period=period,
        start_position=tuple(float(x) for x in start),
        wind_force=condition.of(robot).wind_force,
    )
    driver = kind.build(plant, settled(driver_settings, robot), seed=int(rng.integers(2**31)))
    return driver, plugins.load("estimators", settings.estimator).build(robot)


def draw_resting(
    robot: Robot, condition: Condition, start: Array, rng: np.random.Generator
) -> Robot:
    """Draw a plant that can rest at a start (3,) [m]; near the faces of the box some cannot.

    Raises:
        NoRest: None of those that were drawn can.
    """
    for _ in range(PLANT_TRIES_MAX):
        plant = draw_plant(robot, condition, rng)
        rest = statics.inverse_kinematics(plant, start[None])
        if (rest.converged & rest.stable).all():
            return plant
    where = ", ".join(f"{x:.3f}" for x in start)
    raise NoRest(f"{robot.name}: no plant of {PLANT_TRIES_MAX} can rest at ({where}) m")


def draw_path(
    robot: Robot,
    settings: DemonstrationSettings,
    rng: np.random.Generator,
    *,
    snap_share: float = SNAP_SHARE,
) -> Trajectory:
    """Draw a path inside the workspace box; so many along minimum-snap paths."""
    speed = settings.speed_max * rng.uniform(0.3, 1.0)
    acceleration = settings.acceleration_max * rng.uniform(0.3, 1.0)
    if rng.uniform() < snap_share:
        return trajectories.build(
            "minimum_snap", robot, int(rng.integers(2**31)), speed_max=speed,
            acceleration_max=acceleration,
        )  # fmt: skip
    if rng.uniform() < 0.5:
        speed, acceleration = settings.speed_max, settings.acceleration_max
    middle = 0.5 * (robot.workspace_min + robot.workspace_max)
    half = 0.5 * (robot.workspace_max - robot.workspace_min)
    outer = rng.uniform() < OUTER_SHARE
    ends: list[Array] = []
    for _ in range(PATH_TRIES_MAX):
        share = rng.uniform(-1.0, 1.0, 3)
        if not outer or np.abs(share).max() > OUTER_BOX_SHARE:
            ends.append(middle + half * share)
        if len(ends) == 2:
            break
    return trajectories.line(ends[0], ends[1], speed_max=speed, acceleration_max=acceleration)


def nearby(
    inputs: PlanInputs, settings: DemonstrationSettings, rng: np.random.Generator
) -> PlanInputs:
    """Draw a state near the one of inputs, and another push."""
    turn = Rotation.from_rotvec(settings.turn_spread * rng.standard_normal(3)).as_matrix()
    twist = np.repeat([settings.speed_spread, settings.spin_spread], 3) * rng.standard_normal(6)
    push = np.repeat([settings.push_spread, settings.moment_spread], 3) * rng.standard_normal(6)
    return replace(
        inputs,
        position=inputs.position + settings.place_spread * rng.standard_normal(3),
        rotation=turn @ inputs.rotation,
        twist=inputs.twist + twist,
        acceleration=inputs.acceleration + push,
    )


class NoRest(CarosacError):
    """No plant can rest where a drive would begin."""


class Lost(CarosacError):
    """A drive that a network cannot learn from any more."""


class _Asking:
    """The controller of a drive."""

    Settings: ClassVar = MpcSettings

    def __init__(
        self,
        robot: Robot,
        settings: DemonstrationSettings,
        mpc: MpcSettings,
        rng: np.random.Generator,
        network: PlanSource | None,
        reader: PlanReader | None,
    ) -> None:
        self._robot, self._settings, self._rng = robot, settings, rng
        self._plan = None if network is None else network.planner(robot)
        share = 1.0 if network is None else network.tension_share
        self._follower = PlanFollower(robot, mpc, tension_share=share)
        self._teacher = Teacher(robot, mpc)
        self._reader = reader or PlanNumbers(robot, self._teacher.settings.stages)
        self._targets = TargetReader(robot, self._teacher.grid, self._teacher.settings.distribution)
        self.period, self.horizon = self._follower.period, self._follower.horizon
        self._numbers: list[Array] = []
        self._tension: list[Array] = []
        self._excess: list[Array] = []
        self._met: list[PlanInputs] = []
        self._count = 0

    def reset(self, belief: Belief) -> None:
        """Start at rest where the belief says."""
        self._follower.reset(belief)
        self._targets.reset()
        self._usual_rest: Array | None = None
        self._teacher.reset()
        self._count = 0

    def command(self, belief: Belief, reference: Reference) -> Command:
        """Return the lengths for the next period, and ask MPC on the way."""
        inputs, reason = self._follower.look(belief, reference)
        if reason:
            raise Lost(f"the drive is lost: {reason}")
        rest = self._targets.read(reference).tension
        if self._usual_rest is None:
            self._usual_rest = rest[0]
        habit = inputs.usual_tension - self._usual_rest
        kept = self._count % self._settings.every == 0
        now = float(belief.time[0])
        tension = excess = np.zeros(0)
        if kept or self._plan is None:
            plan = self._ask(inputs, rest, habit, now)
            tension, excess = plan.tension[0], self._excess_of(plan)
        if kept:
            self._met.append(inputs)
            self._keep(self._reader.of(inputs), tension, excess)
            self._ask_nearby(inputs, rest, habit, now)
        if self._plan is not None:
            try:
                tension, excess = self._plan(inputs)
            except UnreadableInputs as error:
                raise Lost(f"the drive is lost: {error}") from error
        share = self._follower.habit_share
        self._usual_rest = self._usual_rest + share * (rest[0] - self._usual_rest)
        self._count += 1
        sent = self._follower.follow(inputs, tension, excess)
        return Command(time=belief.time, unstrained_length=sent[None])

    def ask_elsewhere(self, spread: float) -> None:
        """Ask about states that were met, at other places with another centre of mass.

        Args:
            spread: One sigma of the centre of mass, per axis [m].
        """
        count, rng = self._settings.elsewhere, self._rng
        if not count or not self._met:
            return
        for it in elsewhere(self._robot, self._met, count, spread, self._teacher.grid, rng):
            near = nearby(it.inputs, self._settings, rng)
            plan = self._teacher.ask_anew(near, it.rest, it.habit, it.surplus)
            if plan is not None:
                self._keep(self._reader.of(near), plan.tension[0], self._excess_of(plan))

    def demonstrations(self, error: float, lost: str, cpu_time: float) -> Demonstrations:
        """Return all answers."""
        n, size = self._robot.n, self._reader.count(self._follower.settings.stages)
        return Demonstrations(
            numbers=np.array(self._numbers).reshape(-1, size),
            tension=np.array(self._tension).reshape(-1, n),
            excess=np.array(self._excess).reshape(-1, n),
            error=error,
            lost=lost,
            cpu_time=cpu_time,
        )

    def _ask(self, inputs: PlanInputs, rest: Array, habit: Array, time: float) -> Plan:
        """Return what MPC would do."""
        plan = self._teacher.ask(inputs, rest, habit, self._follower.surplus, time)
        if plan is None:
            raise Lost("no plan")
        return plan

    def _ask_nearby(self, inputs: PlanInputs, rest: Array, habit: Array, time: float) -> None:
        """Ask about states near the one that was met."""
        for _ in range(self._settings.nearby):
            near = nearby(inputs, self._settings, self._rng)
            plan = self._teacher.ask_aside(near, rest, habit, self._follower.surplus, time)
            if plan is not None:
                excess = self._excess_of(plan)
                self._keep(self._reader.of(near), plan.tension[0], excess)

    def _excess_of(self, plan: Plan) -> Array:
        """Return sag less stretch at the end of the first stage [m], shape (n,)."""
        position, rotation = pose_of(plan.state[1], plan.rotation)
        geometry = geometry_at(self._robot, position, rotation)
        return excess_at(self._robot, position, rotation, plan.tension[0], geometry)

    def _keep(self, numbers: Array, tension: Array, excess: Array) -> None:
        if np.isfinite(excess).all() and np.abs(numbers).max() <= INPUT_MAX:
            self._numbers.append(numbers)
            self._tension.append(tension)
            self._excess.append(excess)
