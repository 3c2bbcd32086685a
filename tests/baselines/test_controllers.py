from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from baselines.kinematic_solver import KinematicSolver
from baselines.kinematic_solver_controller import (
    KinematicSolverController,
    KinematicSolverControllerSettings,
    UnreachableReference,
)
from baselines.lookahead import LookaheadSettings
from baselines.straight_line_controller import StraightLineController
from carosac_toolkit import trajectories
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.drivers.quasi_static import QuasiStaticDriver, QuasiStaticSettings
from carosac_toolkit.drivers.sensors import PERFECT_SENSORS
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.loop import run
from carosac_toolkit.loop.values import Belief, Reference
from carosac_toolkit.physics.cable import straight_line
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.robot.file import load_robot
from tests.robots import eight_cable_robot, simple_robot

BOTH = [StraightLineController, KinematicSolverController]


def believed(robot, offset=0.0, size=1):
    return Belief(
        time=np.full(size, 5.0),
        position=np.tile(robot.home_position + offset, (size, 1)),
        rotation=np.tile(np.eye(3), (size, 1, 1)),
    )


def steady(robot, velocity, rows=5, period=0.02):
    """A reference at constant velocity, which passes home now."""
    time = 5.0 + period * np.arange(rows)
    position = robot.home_position + np.outer(time - 5.0, velocity)
    return Reference(
        time=time[None],
        position=position[None],
        velocity=np.tile(velocity, (1, rows, 1)),
        acceleration=np.zeros((1, rows, 3)),
    )


def lengths_at(plugin, robot, position):
    if plugin is StraightLineController:
        return straight_line.inverse_kinematics(robot, position)
    return statics.inverse_kinematics(robot, position).unstrained_length


def live(plugin, settings, *, rest=1.0, robot=None):
    """Run on a driver with perfect sensors and the robot that the controller knows."""
    robot = robot or simple_robot()
    path = trajectories.line(
        robot.home_position, robot.home_position + np.array([0.3, 0.5, 0.2]),
        speed_max=0.5, acceleration_max=0.5,
    )  # fmt: skip
    driver = QuasiStaticDriver.build(robot, QuasiStaticSettings(sensors=PERFECT_SENSORS))
    controller = plugin.build(robot, settings)
    log = run(driver, KinematicSolver.build(robot), controller, path, duration=path.duration + rest)
    return np.linalg.norm(log.position - log.reference, axis=2)[:, 0], log.time, path


@pytest.mark.parametrize("make", [simple_robot, eight_cable_robot])
@pytest.mark.parametrize("plugin", BOTH)
@pytest.mark.parametrize("delay", [0.0, 0.04, 0.05, None])
def test_lengths_are_those_of_the_reference_ahead(plugin, delay, make):
    robot, velocity = make(), np.array([0.2, -0.1, 0.3])
    controller = plugin.build(robot, LookaheadSettings(delay=delay))
    rows = 1 + round(controller.horizon / controller.period)
    reference = steady(robot, velocity, rows)
    controller.reset(believed(robot))
    command = controller.command(believed(robot, offset=0.01), reference)
    seconds = 0.05 + 0.01 if delay is None else delay  # the winches' lag and half a period
    ahead = robot.home_position + seconds * velocity
    expected = lengths_at(plugin, robot, ahead[None])
    assert command.unstrained_length == pytest.approx(expected, abs=1e-9)
    assert command.time[0] == 5.0


def test_straight_line_rate_is_the_derivative_of_its_lengths():
    robot, velocity = simple_robot(), np.array([0.2, -0.1, 0.3])
    controller = StraightLineController.build(robot)
    controller.reset(believed(robot))
    command = controller.command(believed(robot), steady(robot, velocity))
    ahead, step = robot.home_position + 0.06 * velocity, 1e-5 * velocity
    before, after = straight_line.inverse_kinematics(robot, [ahead - step, ahead + step])
    assert command.length_rate[0] == pytest.approx((after - before) / 2e-5, abs=1e-6)


@pytest.mark.parametrize("plugin", BOTH)
def test_reference_of_each_row_of_a_batch_is_its_own(plugin):
    robot = simple_robot()
    one, other = (steady(robot, v) for v in ([0.2, 0.0, 0.1], [0.0, -0.3, 0.1]))
    names = ("time", "position", "velocity", "acceleration")
    both = Reference(**{x: np.concatenate([getattr(one, x), getattr(other, x)]) for x in names})
    together = plugin.build(robot)
    together.reset(believed(robot, size=2))
    lengths = together.command(believed(robot, size=2), both).unstrained_length
    for row, reference in enumerate((one, other)):
        alone = plugin.build(robot)
        alone.reset(believed(robot))
        expected = alone.command(believed(robot), reference).unstrained_length[0]
        assert lengths[row] == pytest.approx(expected, abs=1e-10)


def test_aiming_ahead_takes_the_lag_out():
    moving, time, path = live(KinematicSolverController, LookaheadSettings(delay=None))
    late, *_ = live(KinematicSolverController, LookaheadSettings(delay=0.0))
    under_way = (time > 0.3) & (time < path.duration)
    ratio = np.sqrt((late[under_way] ** 2).mean() / (moving[under_way] ** 2).mean())
    assert ratio > 10.0
    # Without it, the platform is late by the lag of the winches and half a period.
    assert late.max() == pytest.approx(path.peak_speed * 0.06, rel=0.1)


def test_compensation_follows_the_lag_of_the_nominal_robot():
    slow = simple_robot(winch_lag=[0.2] * 4)
    moving, time, path = live(KinematicSolverController, LookaheadSettings(), robot=slow)
    late, *_ = live(KinematicSolverController, LookaheadSettings(delay=0.0), robot=slow)
    under_way = (time > 0.5) & (time < path.duration)
    assert moving[under_way].max() < 0.35 * late[under_way].max()
    assert KinematicSolverController.build(slow).horizon == pytest.approx(0.22)


def test_integral_gain_takes_out_a_constant_error():
    without, *_ = live(StraightLineController, LookaheadSettings(), rest=6.0)
    with_gain, *_ = live(StraightLineController, LookaheadSettings(gain=1.5), rest=6.0)
    assert without[-1] > 0.05  # tilt, which straight lines do not know
    assert with_gain[-1] < 0.01 * without[-1]


@pytest.mark.parametrize("plugin", BOTH)
def test_the_correction_integrates_the_believed_error(plugin):
    robot = simple_robot()
    controller = plugin.build(robot, LookaheadSettings(gain=2.0, delay=0.0))
    controller.reset(believed(robot))
    off = np.array([0.02, -0.01, 0.03])
    for _ in range(5):
        command = controller.command(believed(robot, offset=off), steady(robot, np.zeros(3)))
    aimed = robot.home_position - 5 * 2.0 * 0.02 * off
    expected = lengths_at(plugin, robot, aimed[None])
    assert command.unstrained_length == pytest.approx(expected, abs=1e-9)


def test_a_reference_at_which_it_cannot_rest_is_named_with_the_reason():
    robot = simple_robot()
    controller = KinematicSolverController.build(robot)
    calm = steady(robot, np.zeros(3))
    up = replace(calm, position=calm.position + np.array([0.0, 0.0, 7.0]))
    controller.reset(believed(robot))
    message = r"kinematic_solver: position \[ 0\.4 -1\.8  9\.2\] m: (no tensions|not converged)"
    with pytest.raises(UnreachableReference, match=message):
        controller.command(believed(robot), up)


@pytest.mark.parametrize("plugin", BOTH)
def test_they_are_installed_under_their_names(plugin):
    names = {plugins.load("controllers", x) for x in ("straight_line", "kinematic_solver")}
    assert plugin in names
    assert plugin.build(simple_robot(), seed=1).period == LookaheadSettings().period


@pytest.mark.parametrize(
    ("name", "value"), [("period", 0.0), ("period", np.nan), ("delay", -0.1), ("gain", -1.0)]
)
def test_settings_that_make_no_sense_are_refused(name, value):
    with pytest.raises(InvalidField, match=f"{name}: got .*; allowed: {name} >"):
        LookaheadSettings(**{name: value})


@pytest.mark.parametrize("name", ["minimum", "p_norm", "centre"])
def test_kinematic_solver_sends_the_lengths_of_its_choice_of_tensions(name):
    robot = load_robot("cogiro")
    settings = KinematicSolverControllerSettings(distribution=name, delay=0.0)
    controller = KinematicSolverController.build(robot, settings)
    where = robot.home_position[None]
    belief = Belief(time=np.zeros(1), position=where, rotation=robot.home_rotation[None])
    reference = Reference(
        time=np.zeros((1, 1)), position=where[:, None], velocity=np.zeros((1, 1, 3)),
        acceleration=np.zeros((1, 1, 3)),
    )  # fmt: skip
    controller.reset(belief)
    sent = controller.command(belief, reference).unstrained_length
    chosen = statics.inverse_kinematics(robot, where, distribution=name)
    assert np.array_equal(sent, chosen.unstrained_length)
    assert np.abs(sent - statics.inverse_kinematics(robot, where).unstrained_length).max() > 1e-5


def test_controllers_refuse_a_choice_that_their_robot_does_not_have():
    hall = load_robot("carosac")
    with pytest.raises(InvalidField, match=r"distribution: got 'centre'.*of 4 cables"):
        KinematicSolverController.build(
            hall, KinematicSolverControllerSettings(distribution="centre")
        )
    with pytest.raises(InvalidField, match=r"distribution: got 'least'"):
        KinematicSolverControllerSettings(distribution="least")
