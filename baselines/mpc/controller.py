"""Model predictive control of cable lengths."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import ClassVar, Self

import numpy as np

from baselines.kinematic_solver_controller import (
    KinematicSolverController,
    KinematicSolverControllerSettings,
)
from baselines.mpc.belief_gate import BeliefGate
from baselines.mpc.excess_filter import ExcessFilter
from baselines.mpc.fallback import RestFallback
from baselines.mpc.geometry import excess_at, first_excess, geometry_at, start_geometry
from baselines.mpc.observer import Observer, PlanStart
from baselines.mpc.plan import Plan, pose_of
from baselines.mpc.plan_times import settings_for
from baselines.mpc.planner import Planner
from baselines.mpc.premise import broken_premise
from baselines.mpc.record import MpcRecord
from baselines.mpc.settings import MpcSettings
from baselines.mpc.soft_start import SoftStart
from baselines.mpc.target_reader import TargetReader
from baselines.mpc.unknown_load import PlannedMotion
from baselines.mpc.winch_reference import WinchReference
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.extras import require
from carosac_toolkit.loop.values import Belief, Command, Reference
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

SOFTENED_RATIO = 0.01  # of a limit, by which a plan must exceed it to count as softened
SHIFTED_STEPS_MAX = 5  # for which the last plan goes on after a failure: longer, it runs away


class Mpc:
    """Plans tensions of rigid cables over a receding horizon, and sends the lengths that follow.

    The plan is one Gauss-Newton step better at every command. What is sent are lengths of hanging,
    stretching cables (`carosac_toolkit.physics`) at the planned pose and tension, with the lag of
    the winches taken out. Should a solve fail, the last plan goes on for some steps; then the
    platform is brought to rest near where it is. All that is counted in `record`.

    On a robot whose cables sag too much for such plans (`baselines.mpc.premise`) the commands are
    those of the kinematic solver, and `remark` says so.

    Attributes:
        period: Time between two commands [s].
        horizon: How far ahead the reference must reach [s].
        record: What happened since the last reset.
        remark: Reason why nothing is planned for this robot, or None.
    """

    Settings: ClassVar = MpcSettings

    def __init__(self, robot: Robot, settings: MpcSettings) -> None:
        require("model predictive control", "casadi")
        scales = Scales(robot)
        settings, weight_time = settings_for(robot, settings)
        jerk_max = settings.jerk_max or scales.jerk(settings.period)
        self._robot, self._settings = robot, settings
        self.period = settings.period
        self._planner = Planner(robot, settings, weight_time=weight_time)
        self._observer = Observer(robot, settings)
        self._excess = ExcessFilter(robot, self.period)
        self._winches = WinchReference(robot, period=self.period, jerk_max=jerk_max)
        self._targets = TargetReader(robot, self._planner.grid, settings.distribution)
        self._soft_start = SoftStart(self._planner.grid, scales.ratios)
        self._rest = RestFallback(robot)
        self._agreement = BeliefGate(settings.period, scales.ratios)
        self.horizon = self.period * float(np.ceil(settings.lookahead / self.period - 1e-9))
        self.record = MpcRecord()
        self._ready = False
        self.remark = broken_premise(robot)
        self._follower: KinematicSolverController | None = None
        if self.remark is not None:
            self._follower = KinematicSolverController(
                robot,
                KinematicSolverControllerSettings(
                    period=self.period, distribution=settings.distribution
                ),
            )
            self.horizon = max(self.horizon, self._follower.horizon)

    @classmethod
    def build(cls, robot: Robot, settings: MpcSettings | None = None, *, seed: int = 0) -> Self:
        """Make one for the nominal robot; it draws no random numbers, so `seed` has no effect."""
        return cls(robot, settings or MpcSettings())

    @property
    def fallbacks(self) -> Mapping[str, int]:
        """Commands without a new plan since the last reset, by reason of `MpcRecord.failures`."""
        return dict(self.record.failures)

    def reset(self, belief: Belief) -> None:
        """Start at rest where the belief says.

        Raises:
            InvalidField: A batch of several robots.
            NoStart: No cables can reach there.
        """
        _check_one(belief)
        if self._follower is not None:
            self._follower.reset(belief)
        stage = self._planner.stage
        self.record = MpcRecord(compiled=stage.compiled, interpreted_because=stage.reason)
        self._planner.reset()
        self._observer.reset()
        self._targets.reset()
        self._soft_start.reset()
        self._rest.reset()
        self._agreement.reset()
        self._failed = 0
        self._place = belief.position[0]
        position = belief.position[0]
        geometry = start_geometry(self._robot, position, belief.rotation[0], name="mpc")
        excess = first_excess(self._robot, belief, geometry, self._targets.at(position))
        self.record.no_cable += not np.isfinite(excess).all()
        self._excess.reset(excess)
        self._winches.reset(geometry.length + self._excess.value)
        self._ready = True

    def command(self, belief: Belief, reference: Reference) -> Command:
        """Return the lengths for the next period.

        Raises:
            InvalidField: A batch of several robots, or no reset before.
        """
        _check_one(belief)
        if not self._ready:
            raise InvalidField("mpc", "no belief to start from", "a call of reset() first")
        self.record.commands += 1
        if self._follower is not None:
            return self._follower.command(belief, reference)
        now = float(belief.time[0])
        start = self._observer.start(
            belief, self._winches.length - self._excess.value, self._winches.rate,
            within=self._agreement.within(self._resting), stuck=self._agreement.stuck,
        )  # fmt: skip
        self._agreement.update(start.distance, resting=self._resting, still=self._winches.at_rest)
        if start.distance <= self._observer.gate:
            self._place = start.position
        plan = self._solve(start, reference, now)
        if plan is None:
            lengths = self._fall_back(now)
        else:
            self.record.recovered += self._resting
            self._failed = 0
            self._rest.reset()
            self._planner.plan = plan
            lengths = self._follow(plan)
        self.record.held += self._winches.held
        self.record.rebased = self._observer.rebased
        self.record.no_rest = self._targets.no_rest
        return Command(time=belief.time, unstrained_length=lengths[None])

    def _solve(self, start: PlanStart, reference: Reference, now: float) -> Plan | None:
        """Make a plan from here, or return None with the reason in the record."""
        self.record.reason = ""
        if not np.isfinite(start.distance) or not start.geometry.valid:
            self._fail("geometry", "a believed pose that cables cannot reach")
            return None
        if not self._agreement.usable:
            self._fail("belief", f"{start.distance:.3g} m from the lengths that were sent")
            return None
        began = time.perf_counter()
        wanted = self._soft_start.faded(
            self._targets.read(reference), start.position, start.rotation, time=now
        )
        target = self._targets.nearer(wanted, start.position)
        self.record.approached += target is not wanted
        improved = self._planner.improve(
            start, target, time=now, load=self._observer.load,
            acceleration=self._winches.acceleration_range(),
            offset=self._excess.value + self._observer.lengths.surplus,
        )  # fmt: skip
        self.record.solve_time = time.perf_counter() - began
        self.record.solves += 1
        if improved is None:
            self._fail("no solution", "the quadratic program has no solution")
            return None
        budget = self._settings.time_budget
        if budget is not None and self.record.solve_time > budget:
            self._fail("late", f"{self.record.solve_time:.4f} s; allowed: {budget} s")
            return None
        plan, slack = improved
        self.record.softened += slack > SOFTENED_RATIO
        return plan

    @property
    def _resting(self) -> bool:
        """True if the last plan was given up, so that the platform is being brought to rest."""
        return self._failed > SHIFTED_STEPS_MAX

    def _fail(self, kind: str, words: str) -> None:
        """Count a failure."""
        self.record.failures[kind] += 1
        self.record.reason = f"{kind}: {words}"

    def _follow(self, plan: Plan) -> Array:
        """Return the command that leads to the plan's next state."""
        before, state = plan.state[:2]
        position, rotation = pose_of(state, plan.rotation)
        geometry = geometry_at(self._robot, position, rotation)
        excess = excess_at(self._robot, position, rotation, plan.tension[0], geometry)
        self.record.no_cable += not np.isfinite(excess).all()
        self._excess.approach(excess)
        self._observer.predict(
            PlanStart(position=position, rotation=rotation, twist=state[6:], geometry=geometry,
                  distance=0.0),
            PlannedMotion.of(
                self._robot, geometry, plan.tension[0],
                rotation=pose_of(before, plan.rotation)[1], spin=before[9:],
                spin_rate=(state[9:] - before[9:]) / self.period,
            ),
        )  # fmt: skip
        length = geometry.length + self._excess.value + self._observer.lengths.surplus
        return self._winches.follow(length, geometry.jacobian @ state[6:])

    def _fall_back(self, now: float) -> Array:
        """Return the command after a failure: the last plan for some steps, then rest."""
        self._failed += 1
        old = self._planner.plan
        if old is not None and not self._resting:
            self.record.fallbacks["shifted plan"] += 1
            states, _ = old.shifted(np.array([now + self.period, now + 2.0 * self.period]))
            position, rotation = pose_of(states[0], old.rotation)
            geometry = geometry_at(self._robot, position, rotation)
            self._observer.predict(
                PlanStart(position=position, rotation=rotation, twist=states[0, 6:],
                      geometry=geometry, distance=0.0)
            )  # fmt: skip
            rate = geometry.jacobian @ states[0, 6:]
            return self._winches.accelerate((rate - self._winches.rate) / self.period)
        self._planner.reset()
        self._observer.forget()
        acceleration, has_goal = self._rest.acceleration(
            self._place, self._winches.length, self._winches.rate, self._observer.lengths.kept
        )
        self.record.fallbacks["to rest" if has_goal else "hold"] += 1
        return self._winches.accelerate(acceleration)


def _check_one(belief: Belief) -> None:
    """Refuse a batch."""
    if len(belief.position) != 1:
        raise InvalidField("belief", f"{len(belief.position)} robots", "one: mpc plans for one")
