"""MPC that says what it would do in any state."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from baselines.mpc.geometry import geometry_at
from baselines.mpc.observer import PlanStart
from baselines.mpc.plan import Plan
from baselines.mpc.plan_times import settings_for
from baselines.mpc.planner import COLD_START_ITERATIONS, Planner, PlanTarget
from baselines.mpc.settings import MpcSettings
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot
from learned.approximate_mpc.plan_inputs import PlanInputs

SAME_TENSION = 1e-3  # of the weight per cable: what a plan that is found still changes by
ANEW_MAX = 10  # times that a plan is made better until it is found


@dataclass(frozen=True, kw_only=True, eq=False)
class _KnownLoad:
    """Load of a plan.

    Attributes:
        robot: With its centre of mass.
        acceleration: Beyond the model, shape (6,).
    """

    robot: Robot
    acceleration: Array


class Teacher:
    """Plans of MPC for one robot, each from the last one that was kept.

    Attributes:
        grid: Times of a plan from now [s], shape (N + 1,).
        settings: Of MPC, in numbers for the robot.
    """

    def __init__(self, robot: Robot, settings: MpcSettings) -> None:
        self._robot = self._loaded = robot
        self.settings, weight_time = settings_for(robot, settings)
        self._planner = Planner(robot, self.settings, weight_time=weight_time)
        self.grid = self._planner.grid
        self.reset()

    def reset(self) -> None:
        """Begin with rest."""
        self._plan: Plan | None = None

    def ask(
        self, inputs: PlanInputs, rest: Array, habit: Array, surplus: Array, time: float
    ) -> Plan | None:
        """Return the plan from a state, which the next one begins with; None: there is none.

        Args:
            inputs: State, reference and load.
            rest: Tensions of rest, per stage [N], shape (N, n).
            habit: What tensions differ by from those of rest in the long run [N], shape (n,).
            surplus: What lengths sent exceed straight ones by [m], shape (n,).
            time: Now [s].
        """
        iterations = COLD_START_ITERATIONS if self._plan is None else 1
        plan = self.ask_aside(inputs, rest, habit, surplus, time, iterations=iterations)
        if plan is not None:
            self._plan = plan
        return plan

    def ask_anew(
        self, inputs: PlanInputs, rest: Array, habit: Array, surplus: Array
    ) -> Plan | None:
        """Return the plan from a state, begun with rest and solved until nothing changes.

        Arguments as of `ask`; None: there is no plan, or it goes on changing.
        """
        kept, self._plan = self._plan, None
        last: Plan | None = None
        try:
            for k in range(ANEW_MAX):
                iterations = 1 if k else COLD_START_ITERATIONS
                plan = self.ask_aside(inputs, rest, habit, surplus, 0.0, iterations=iterations)
                if plan is None or (last is not None and self._same(last, plan)):
                    return plan
                last = self._plan = plan
            return None
        finally:
            self._plan = kept

    def _same(self, one: Plan, other: Plan) -> bool:
        """Return whether two plans begin with the same tensions."""
        change = np.abs(one.tension[0] - other.tension[0]).max()
        return bool(change < SAME_TENSION * self._robot.weight / self._robot.n)

    def ask_aside(
        self, inputs: PlanInputs, rest: Array, habit: Array, surplus: Array, time: float, *,
        iterations: int = 1,
    ) -> Plan | None:  # fmt: skip
        """Return the plan from a state, with which no other begins; arguments as of `ask`."""
        start = PlanStart(
            position=inputs.position,
            rotation=inputs.rotation,
            twist=inputs.twist,
            geometry=geometry_at(self._robot, inputs.position, inputs.rotation),
            distance=0.0,
        )
        target = PlanTarget(
            position=inputs.target, velocity=inputs.target_velocity, rotation=None, tension=rest
        )
        center = self._robot.center_of_mass + inputs.center
        if not (center == self._loaded.center_of_mass).all():
            self._loaded = replace(self._robot, center_of_mass=center)
        load = _KnownLoad(robot=self._loaded, acceleration=inputs.acceleration)
        return self._planner.refine(
            start, target, time=time, load=load, offset=surplus, guess=self._plan, habit=habit,
            iterations=iterations,
        )  # fmt: skip
