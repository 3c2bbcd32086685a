"""What each weight and limit of the settings does to a plan."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carosac_toolkit as ct
from baselines.mpc import MpcSettings
from baselines.mpc.geometry import geometry_at
from baselines.mpc.observer import PlanStart
from baselines.mpc.planner import Planner, PlanTarget
from baselines.mpc.unknown_load import UnknownLoad
from baselines.mpc.winch_reference import WinchRange
from carosac_toolkit.base.scaled import resolved
from carosac_toolkit.physics.scales import Scales
from tests.robots import eight_cable_robot, simple_robot

GENTLE, HARD = np.array([0.1, 0.15, 0.05]), np.array([1.0, 1.5, 0.5])  # moves [m]


def plan(robot, move, **changes):
    """Plan a move from home, where the platform turns; the plan, its target, slack and planner."""
    settings = resolved(MpcSettings(compiled="never", **changes), Scales(robot).ratios)
    planner = Planner(robot, settings)
    rest = ct.statics.inverse_kinematics(robot, robot.home_position[None])
    turn = Rotation.from_rotvec([0.02, -0.03, 0.02]).as_matrix() @ rest.rotation[0]
    position = rest.position[0]
    start = PlanStart(
        position=position, rotation=turn, twist=np.array([0.0, 0.0, 0.0, 0.05, -0.1, 0.1]),
        geometry=geometry_at(robot, position, turn), distance=0.0,
    )  # fmt: skip
    count = len(planner.grid)
    target = PlanTarget(
        position=np.tile(position + move, (count, 1)), velocity=np.zeros((count, 3)),
        rotation=np.tile(rest.rotation[0], (count, 1, 1)) if robot.n >= 6 else None,
        tension=np.tile(rest.tension[0], (count - 1, 1)),
    )  # fmt: skip
    load = UnknownLoad(robot, period=settings.period, center_of_mass=0.0, disturbance_time=0.2)
    wide = WinchRange(low=np.full(robot.n, -1e3), high=np.full(robot.n, 1e3))
    found = planner.improve(
        start, target, time=0.0, load=load, acceleration=wide, offset=np.zeros(robot.n)
    )
    assert found is not None
    return found[0], target, found[1], planner


def position(found, target, slack, planner):
    return ((found.state[:, :3] - target.position) ** 2).sum()


def velocity(found, target, slack, planner):
    return (found.state[:, 6:9] ** 2).sum()


def spin(found, target, slack, planner):
    return (found.state[:, 9:] ** 2).sum()


def attitude(found, target, slack, planner):
    turns = [Rotation.from_mrp(s).as_matrix() @ found.rotation for s in found.state[:, 3:6]]
    errors = [Rotation.from_matrix(a @ b.T) for a, b in zip(turns, target.rotation, strict=True)]
    return sum(error.magnitude() ** 2 for error in errors)


def tension(found, target, slack, planner):
    return ((found.tension - target.tension) ** 2).sum()


def excess(found, target, slack, planner):
    return slack


@pytest.mark.parametrize(
    ("name", "cost", "robot", "move"),
    [
        ("position_weight", position, simple_robot, GENTLE),
        ("velocity_weight", velocity, simple_robot, GENTLE),
        ("spin_weight", spin, simple_robot, GENTLE),
        ("attitude_weight", attitude, eight_cable_robot, GENTLE),
        ("tension_weight", tension, simple_robot, GENTLE),
        ("limit_weight", excess, simple_robot, HARD),
    ],
)
def test_a_larger_weight_lowers_what_it_weighs(name, cost, robot, move):
    usual = float(getattr(MpcSettings(), name))
    small, large = (cost(*plan(robot(), move, **{name: k * usual})) for k in (0.1, 10.0))
    assert large < 0.9 * small


def test_the_share_of_the_limits_bounds_the_winch_speeds_of_the_plan():
    robot = simple_robot()
    *_, slack, planner = plan(robot, HARD, limit_share=0.3, limit_weight=1e4)
    rate = planner.stage.path[1:, robot.n : 2 * robot.n]
    assert np.abs(rate / robot.speed_max).max() < 0.3 + slack + 0.05
    *_, planner = plan(robot, HARD, limit_share=0.95, limit_weight=1e4)
    assert np.abs(planner.stage.path[1:, robot.n : 2 * robot.n] / robot.speed_max).max() > 0.5


def test_the_plan_reaches_as_far_as_the_lookahead_in_as_many_stages_as_it_is_told():
    found, *_ = plan(simple_robot(), GENTLE, lookahead=1.5, stages=12)
    assert len(found.tension) == 12
    assert found.time[1] == MpcSettings().period and found.time[-1] == pytest.approx(1.5)
