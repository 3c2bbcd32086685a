"""Drives in the prediction model of MPC itself, without cables that swing, sensors and winches.

They take a fraction of the time of a simulated drive. MPC, or a network, gives the tensions; both
robots differ in centre of mass and in an acceleration that is known, and states are as exact as a
belief is not. What lags and vibrates is learned from simulated drives, after these.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from baselines.mpc import model
from baselines.mpc.geometry import geometry_at
from baselines.mpc.length_offsets import OFFSET_TIME
from baselines.mpc.plan_times import fastest_motion
from baselines.mpc.settings import MpcSettings
from baselines.mpc.target_reader import TargetReader
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.condition_file import find_condition
from carosac_toolkit.robot.robot import Robot
from learned.approximate_mpc.demonstrations import (
    CALM_TIME,
    DemonstrationSettings,
    Lost,
    draw_path,
    nearby,
)
from learned.approximate_mpc.plan_inputs import PlanInputs, TensionCallback
from learned.approximate_mpc.teacher import Teacher

DRIVE_TIME, HOLD_TIME = 8.0, 0.04  # in sqrt(L / g): longest drive, and of a held tension
HOLD_ANGLE, HOLDS_MAX = 0.3, 160  # of the fastest motion in a held tension [rad], and of these
START_SPREADS = 2.0  # times those of nearby states
LOST_DISTANCE = 0.1  # from the reference, over L


class ModelWorld:
    """One robot that moves along a path."""

    def __init__(
        self, robot: Robot, settings: DemonstrationSettings, period: float, grid: Array,
        rng: np.random.Generator,
    ) -> None:  # fmt: skip
        """Draw a path, a centre of mass and a push, and start near the path.

        Args:
            robot: The nominal robot.
            settings: In numbers for the robot.
            period: Of commands [s].
            grid: Times of a plan from now [s], shape (N + 1,).
            rng: Of all that is drawn.

        Raises:
            CarosacError: The robot cannot rest at the start.
        """
        self.path = draw_path(robot, settings, rng)
        self._robot, self._grid, self._rng = robot, grid, rng
        self._targets = TargetReader(robot, grid)
        self._stage = _stage(robot.n)
        scales = Scales(robot)
        condition = find_condition(settings.condition).of(robot)
        self._center = condition.center_of_mass * rng.standard_normal(3)
        self._loaded = replace(robot, center_of_mass=robot.center_of_mass + self._center)
        push = np.repeat([settings.push_spread, settings.moment_spread], 3)
        self._push = push * rng.standard_normal(6)
        hold = min(HOLD_TIME * scales.time, HOLD_ANGLE / fastest_motion(robot))
        self._hold = max(1, round(hold / period)) * period
        self._lost = LOST_DISTANCE * scales.length
        self._share = min(1.0, self._hold / OFFSET_TIME.of(scales.ratios))
        whole = min(self.path.duration, DRIVE_TIME * scales.time) + CALM_TIME.of(scales.ratios)
        self.end = min(whole, HOLDS_MAX * self._hold)
        self.time = 0.0
        start = self.path.sample(np.zeros(1)).position
        rest = statics.inverse_kinematics(self._loaded, start)
        if not rest.converged[0]:
            raise CarosacError(f"no rest at {start[0].round(4)} m")
        self._usual_tension, self._usual_place = rest.tension[0], start[0]
        self._position, self._rotation = rest.position[0], rest.rotation[0]
        self._twist = np.zeros(6)
        wide = replace(settings, **{
            name: START_SPREADS * getattr(settings, name)
            for name in ("place_spread", "turn_spread", "speed_spread", "spin_spread")
        })  # fmt: skip
        near = nearby(self.look(), wide, rng)
        self._position, self._rotation, self._twist = near.position, near.rotation, near.twist

    def look(self) -> PlanInputs:
        """Return what the next plan depends on."""
        ahead = self.path.sample(self.time + self._grid)
        return PlanInputs(
            position=self._position, rotation=self._rotation, twist=self._twist,
            target=ahead.position, target_velocity=ahead.velocity, center=self._center,
            acceleration=self._push, usual_tension=self._usual_tension,
            usual_place=self._usual_place - ahead.position[0],
        )  # fmt: skip

    def rest(self, inputs: PlanInputs) -> tuple[Array, Array]:
        """Return tensions of rest per stage (N, n) [N], and what is usual beyond those (n,)."""
        ends = [self._targets.at(place) for place in (inputs.target[0], inputs.target[-1])]
        usual = self._targets.at(inputs.target[0] + inputs.usual_place)
        share = (self._grid[:-1] / self._grid[-1])[:, None]
        return (1.0 - share) * ends[0] + share * ends[1], inputs.usual_tension - usual

    def move(self, tension: Array) -> None:
        """Hold tensions (n,) [N] for a while.

        Raises:
            Lost: The platform is far from its reference.
        """
        robot = self._robot
        tension = np.clip(tension, robot.tension_min, robot.tension_max)
        geometry = geometry_at(robot, self._position, self._rotation)
        parameters = model.parameters(
            self._loaded, rotation=self._rotation, length=geometry.free, exits=geometry.exits,
            disturbance=self._push,
        )  # fmt: skip
        state = np.concatenate([self._position, np.zeros(3), self._twist])
        after = np.array(self._stage(state, tension, parameters, self._hold)).ravel()
        self._position, self._twist = after[:3], after[6:]
        turned = model.rotation_of(after[3:6]) @ self._rotation
        self._rotation = Rotation.from_matrix(turned).as_matrix()  # rounding does not grow
        self.time += self._hold
        self._usual_tension = self._usual_tension + self._share * (tension - self._usual_tension)
        due = self.path.sample(np.array([self.time])).position[0]
        self._usual_place = self._usual_place + self._share * (due - self._usual_place)
        if not np.linalg.norm(self._position - due) <= self._lost:
            raise Lost("far from its reference")


def answers(
    robot: Robot, settings: DemonstrationSettings, mpc: MpcSettings, rng: np.random.Generator,
    plan: TensionCallback | None,
) -> Iterator[tuple[PlanInputs, Array]]:  # fmt: skip
    """Drive along a path in the model, and give states and the first tensions (n,) [N] of MPC.

    Args:
        robot: The nominal robot.
        settings: In numbers for the robot.
        mpc: Of the teacher.
        rng: Of all that is drawn.
        plan: Gives the tensions that drive; None: MPC does.
    """
    teacher = Teacher(robot, mpc)
    world = ModelWorld(robot, settings, teacher.settings.period, teacher.grid, rng)
    surplus = np.zeros(robot.n)  # lengths are far from their limits
    while world.time < world.end:
        inputs = world.look()
        rest, habit = world.rest(inputs)
        first = teacher.ask(inputs, rest, habit, surplus, world.time)
        if first is None:
            raise Lost("no plan")
        yield inputs, first.tension[0]
        for _ in range(settings.nearby):
            near = nearby(inputs, settings, rng)
            other = teacher.ask_aside(near, rest, habit, surplus, world.time)
            if other is not None:
                yield near, other.tension[0]
        world.move(first.tension[0] if plan is None else plan(inputs))


@lru_cache(maxsize=4)
def _stage(n: int) -> Any:
    """Return the function of one step: (x, u, p, h) -> x thereafter."""
    import casadi as ca

    whole = model.stage(n)
    inputs = [ca.MX.sym(f"i{k}", *whole.sparsity_in(k).shape) for k in range(whole.n_in())]
    return ca.Function("after", inputs, [whole(*inputs)[0]])
