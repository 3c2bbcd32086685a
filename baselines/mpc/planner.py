"""Real-time iterations: one linearisation and one quadratic program a command."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from baselines.mpc import model
from baselines.mpc.length_offsets import OFFSET_TIME
from baselines.mpc.observer import PlanStart
from baselines.mpc.plan import Plan
from baselines.mpc.plan_times import stage_durations, times_of
from baselines.mpc.quadratic_program import NO_LIMIT, QuadraticProgram
from baselines.mpc.settings import MpcSettings
from baselines.mpc.stage_function import StageFunction
from baselines.mpc.winch_reference import WinchRange
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

COLD_START_ITERATIONS = 3  # where there is no plan to start from
STATE_UNITS = ("m", "rad", "m/s", "rad/s")  # of position, attitude, velocity, spin
RODRIGUES_NORM_MAX = 0.35  # beyond it (80 degrees) R_0 moves along
STATE_MAX = 1e3  # of scaled states: a plan beyond it has diverged
REST_TENSION_RATIO_MIN = 0.5  # the plan can always go down to this share of the tension of rest
TAUT_TENSION_CABLE_WEIGHTS = 4.0  # below it, sag changes a length more than motion does
LENGTH_EXCESS_SCALE = Scaled(1.0, "m")  # counts like exceeding a speed limit by all of it


@dataclass(frozen=True, kw_only=True, eq=False)
class PlanTarget:
    """Target of the platform at the N + 1 times of a plan.

    Attributes:
        position: Platform origin in W [m], shape (N + 1, 3).
        velocity: [m/s], shape (N + 1, 3).
        rotation: Wanted rotation per time, shape (N + 1, 3, 3); None leaves it free.
        tension: Of rest, per stage [N], shape (N, n).
        calm: Whether half of the tension of rest is the least: then nothing falls.
    """

    position: Array
    velocity: Array
    rotation: Array | None
    tension: Array
    calm: bool = False


class Load(Protocol):
    """What is known of the load.

    Attributes:
        robot: With its centre of mass.
        acceleration: As the disturbance of `baselines.mpc.model`, shape (6,).
    """

    @property
    def robot(self) -> Robot:
        """Return the robot."""

    @property
    def acceleration(self) -> Array:
        """Return the acceleration."""


class Planner:
    """Keeps a plan and improves it at each command.

    Tensions are kept near those of rest. With fewer than six cables, for which motion leaves no
    choice of tensions, what they differ by in the long run is learned and not held against them,
    so that a disturbance leaves no steady error of the position.

    Attributes:
        grid: Times of the states from now [s], shape (N + 1,).
        stage: The stage function.
        plan: The plan that the next one starts from, or None.
    """

    plan: Plan | None

    def __init__(
        self, robot: Robot, settings: MpcSettings, *, weight_time: float | None = None
    ) -> None:
        """Set up solver and stage function.

        Args:
            robot: The nominal robot.
            settings: Grid and weights.
            weight_time: Unit of time of the weights over that of ``carosac``; None: by the size.
        """
        n, stages, ratios = robot.n, settings.stages, Scales(robot).ratios
        # States are solved for in units of the robot's size, in which tolerances are alike.
        self._state_unit = np.repeat([ratios.of_unit(unit) for unit in STATE_UNITS], 3)
        self._length_scale = LENGTH_EXCESS_SCALE.of(ratios)
        self._habit_share = settings.period / OFFSET_TIME.of(ratios)
        self._robot, self._settings = robot, settings
        self._duration = stage_durations(settings)
        self.grid = times_of(self._duration)
        self.stage = StageFunction(n, stages, settings.compiled)
        self._program = QuadraticProgram(stages, model.STATE_SIZE, n, model.PATH_QUANTITIES * n)
        self._unit = 0.5 * robot.weight / min(n, 4)  # [N], scale of the tensions
        held = settings.attitude_weight if n >= 6 else 0.0
        weights = settings.position_weight, held, settings.velocity_weight, settings.spin_weight
        scale = np.array([1.0, 4.0, 1.0, 1.0]) ** 2  # small Rodrigues parameters: quarter angles
        self._weight = np.repeat(np.array(weights) * scale, 3) * self._state_unit**2
        unit_of_time = ratios.time if weight_time is None else weight_time
        self._share = self._duration[:, None] / unit_of_time  # of a stage in the cost
        self.reset()

    def reset(self) -> None:
        """Forget the plan."""
        self.plan = None
        self._habit = np.zeros(self._robot.n)

    def improve(
        self, start: PlanStart, target: PlanTarget, *, time: float, load: Load,
        acceleration: WinchRange, offset: Array,
    ) -> tuple[Plan, float] | None:  # fmt: skip
        """Make a plan from where the platform is.

        Args:
            start: Pose and twist now.
            target: At the times of `grid` from now.
            time: Now [s].
            load: What was learned of the load.
            acceleration: What the winches can do in the first stage [m/s^2].
            offset: What lengths sent exceed straight ones by [m], shape (n,).

        Returns:
            The plan, and by which share it exceeds a soft limit; None without a solution.
        """
        cold = self.plan is None
        plan = self._guess(start, target, time)
        for _ in range(COLD_START_ITERATIONS if cold else 1):
            self._linearise(plan, start, load)
            corrected = self._correct(plan, target, acceleration, offset)
            if corrected is None:
                return None
            plan, slack = corrected
        if self._robot.n < 6:
            now = plan.tension[0] - target.tension[0]
            self._habit = self._habit + self._habit_share * (now - self._habit)
        return plan, slack

    def refine(
        self, start: PlanStart, target: PlanTarget, *, time: float, load: Load, offset: Array,
        guess: Plan | None, habit: Array, iterations: int,
    ) -> Plan | None:  # fmt: skip
        """Make a plan from a guess, whatever the winches did before; nothing is learned from it.

        Args:
            start: Pose and twist now.
            target: At the times of `grid` from now.
            time: Now [s].
            load: What is known of the load.
            offset: What lengths sent exceed straight ones by [m], shape (n,).
            guess: Another plan; None: begin with rest.
            habit: What tensions differ by from those of rest in the long run [N], shape (n,).
            iterations: Quadratic programs.
        """
        self.plan, self._habit = guess, habit
        plan = self._guess(start, target, time)
        free = np.full(self._robot.n, np.inf)
        for _ in range(iterations):
            self._linearise(plan, start, load)
            corrected = self._correct(plan, target, WinchRange(low=-free, high=free), offset)
            if corrected is None:
                return None
            plan = corrected[0]
        return plan

    def _guess(self, start: PlanStart, target: PlanTarget, time: float) -> Plan:
        """Return the last plan, shifted to now, with the first state replaced."""
        when = time + self.grid
        old = self.plan
        if old is None:
            rotation = start.rotation
            state = np.zeros((len(when), model.STATE_SIZE))
            state[:, :3] = start.position
            rest = np.broadcast_to(target.tension[0], target.tension.shape)
            tension = np.clip(rest, self._robot.tension_min, self._robot.tension_max)
        else:
            s = model.parameters_of(start.rotation @ old.rotation.T)
            old = old.turned(start.rotation) if s @ s > RODRIGUES_NORM_MAX**2 else old
            rotation = old.rotation
            state, tension = old.shifted(when)
        state[0, :3] = start.position
        state[0, 3:6] = model.parameters_of(start.rotation @ rotation.T)
        state[0, 6:] = start.twist
        return Plan(time=when, state=state, tension=tension, rotation=rotation)

    def _linearise(self, plan: Plan, start: PlanStart, load: Load) -> None:
        """Evaluate the stage function along the plan."""
        stage, geometry = self.stage, start.geometry
        stage.state[:] = plan.state[:-1]
        stage.tension[:] = plan.tension
        stage.duration[:] = self._duration
        stage.parameters[:] = model.parameters(
            load.robot, rotation=plan.rotation, length=geometry.free, exits=geometry.exits,
            disturbance=load.acceleration,
        )  # fmt: skip
        stage()
        self._hanging = self._robot.weight_per_length * geometry.free

    def _least(self, target: PlanTarget) -> Array:
        """Return the tensions at which cables are still taut [N], shape (N, n)."""
        half = REST_TENSION_RATIO_MIN * target.tension
        taut = half if target.calm else np.minimum(TAUT_TENSION_CABLE_WEIGHTS * self._hanging, half)
        return np.maximum(self._robot.tension_min, taut)

    def _correct(
        self, plan: Plan, target: PlanTarget, acceleration: WinchRange, offset: Array
    ) -> tuple[Plan, float] | None:
        """Solve for the best change of the plan."""
        stage, settings, n = self.stage, self._settings, self._robot.n
        error, unit = self._error(plan, target) / self._state_unit, self._state_unit
        share = self._share
        cost = np.hstack([
            share * self._weight,
            share * np.full((settings.stages, n), settings.tension_weight),
        ])  # fmt: skip
        surplus = (plan.tension - target.tension - self._habit) / self._unit
        step = self._program.solve(
            hessian=cost, gradient=cost * np.hstack([error[:-1], surplus]),
            end=np.stack([self._weight, self._weight * error[-1]]),
            dynamics=(stage.by_state * (unit / unit[:, None]),
                      stage.by_tension * (self._unit / unit[:, None]),
                      (stage.after - plan.state[1:]) / unit),
            bounds=((self._least(target) - plan.tension) / self._unit,
                    (self._robot.tension_max - plan.tension) / self._unit),
            rows=self._rows(acceleration, offset), price=settings.limit_weight,
            start=np.zeros(model.STATE_SIZE),
        )  # fmt: skip
        if not step.solved:
            return None
        tension = plan.tension + self._unit * step.tension
        better = Plan(time=plan.time, state=plan.state + unit * step.state, tension=tension,
                      rotation=plan.rotation)  # fmt: skip
        near = np.abs(better.state / unit).max() < STATE_MAX
        sound = near and np.abs(better.state[:, 3:6]).max() < 1.0
        return (better, float(step.slack.max())) if sound else None

    def _error(self, plan: Plan, target: PlanTarget) -> Array:
        """Return state minus target; no attitude error where it is free."""
        error = plan.state.copy()
        error[:, :3] -= target.position
        error[:, 6:9] -= target.velocity
        if target.rotation is not None:
            for row, wanted in zip(error, target.rotation, strict=True):
                row[3:6] -= model.parameters_of(wanted @ plan.rotation.T)
        return error

    def _rows(self, acceleration: WinchRange, offset: Array) -> tuple[Array, Array, Array]:
        """Return scaled limits on length, rate and acceleration of the cables."""
        robot, stage, share = self._robot, self.stage, self._settings.limit_share
        n, stages = robot.n, self._settings.stages
        speed, most = share * robot.speed_max, share * robot.acceleration_max
        scale = np.concatenate(
            [np.full(n, self._length_scale), robot.speed_max, robot.acceleration_max]
        )
        low = np.tile(np.concatenate([robot.length_min - offset, -speed, -most]), (stages, 1))
        high = np.tile(np.concatenate([robot.length_max - offset, speed, most]), (stages, 1))
        low[0, 2 * n :] = acceleration.low
        high[0, 2 * n :] = acceleration.high
        low, high = (low - stage.path) / scale, (high - stage.path) / scale
        low[0, : 2 * n], high[0, : 2 * n] = -NO_LIMIT, NO_LIMIT  # now: nothing can change them
        by_state = stage.path_by_state * self._state_unit
        matrix = np.concatenate([by_state, self._unit * stage.path_by_tension], axis=2)
        return matrix / scale[:, None], low, high
