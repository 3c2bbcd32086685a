from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from baselines.kinematic_solver import KinematicSolver
from baselines.kinematic_solver_controller import KinematicSolverController
from carosac_toolkit import trajectories
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.drivers.quasi_static import QuasiStaticDriver, QuasiStaticSettings
from carosac_toolkit.drivers.sensors import PERFECT_SENSORS
from carosac_toolkit.loop.loop import run
from carosac_toolkit.loop.values import Command
from carosac_toolkit.physics.rest import statics
from tests.robots import simple_robot

PERIOD = 0.02


def connected(settings=None, seed=0, robot=None):
    driver = QuasiStaticDriver.build(robot or simple_robot(), settings, seed=seed)
    driver.connect()
    return driver


def ask(driver, lengths):
    return driver.command(Command(time=driver.measure().time, unstrained_length=lengths))


def play(driver, count=30, speed=0.5):
    """Let all cables out at a constant speed; what was measured and what was sent."""
    start = driver.measure().unstrained_length
    measured, sent = [], []
    for k in range(count):
        measured.append(driver.measure().unstrained_length[0])
        sent.append(ask(driver, start + speed * PERIOD * (k + 1)).unstrained_length[0])
        driver.wait(PERIOD)
    return np.array(measured), np.array(sent)


def test_it_starts_at_rest_where_it_is_told():
    driver = connected(
        QuasiStaticSettings(start_position=(0.8, -1.0, 2.5), sensors=PERFECT_SENSORS)
    )
    truth = driver.truth()
    assert truth.position[0] == pytest.approx([0.8, -1.0, 2.5], abs=1e-9)
    rest = statics.inverse_kinematics(simple_robot(), truth.position)
    assert truth.unstrained_length == pytest.approx(rest.unstrained_length, abs=1e-9)
    assert truth.tension == pytest.approx(rest.tension, abs=1e-5)


def test_without_sensor_or_model_errors_only_lag_and_hold_are_left():
    robot, acceleration = simple_robot(), 0.5
    path = trajectories.circle(
        robot.home_position, 0.6, speed_max=0.6, acceleration_max=acceleration
    )
    start = tuple(path.sample(np.zeros(1)).position[0])
    driver = QuasiStaticDriver.build(
        robot, QuasiStaticSettings(sensors=PERFECT_SENSORS, start_position=start)
    )
    controller = KinematicSolverController.build(robot)
    log = run(driver, KinematicSolver.build(robot), controller, path)
    error = np.linalg.norm(log.position - log.reference, axis=2)
    # A lag and a hold that are aimed ahead of by their mean delay T leave a T^2 / 2 of the
    # acceleration; the same again for what the winches' own limits and the curved map add.
    delay = 0.05 + PERIOD / 2
    assert error.max() < acceleration * delay**2
    assert error[log.time > path.duration + 0.5].max() < 1e-6
    assert np.abs(log.belief_position - log.position).max() < 1e-6
    assert log.limited == ()


def test_an_encoder_bias_shifts_the_pose_as_statics_says():
    robot = simple_robot()
    settings = QuasiStaticSettings(sensors=replace(PERFECT_SENSORS, encoder_bias=0.01))
    driver = connected(settings, seed=4)
    bias = driver.measure().unstrained_length - driver.truth().unstrained_length
    assert 1e-3 < np.abs(bias).max() < 0.05
    wanted = statics.inverse_kinematics(robot, robot.home_position[None]).unstrained_length
    for _ in range(100):
        ask(driver, wanted)
        driver.wait(PERIOD)
    truth = driver.truth()
    assert truth.unstrained_length == pytest.approx(wanted - bias, abs=1e-7)
    moved = statics.forward_kinematics(robot, wanted - bias)
    assert truth.position == pytest.approx(moved.position, abs=1e-6)
    assert np.linalg.norm(truth.position - robot.home_position) > 1e-3
    assert driver.measure().unstrained_length == pytest.approx(wanted, abs=1e-7)


def test_commands_that_jump_are_limited_and_say_so():
    driver = connected(QuasiStaticSettings(sensors=PERFECT_SENSORS))
    start = driver.measure().unstrained_length
    sent = ask(driver, start + 1.0)
    jerk = driver._limiter.jerk_max
    assert (sent.unstrained_length - start).max() == pytest.approx(jerk * PERIOD**3, rel=1e-3)
    assert {"jerk", "acceleration"} <= {hit.limit for hit in sent.limited}


@pytest.mark.parametrize("commanding", [True, False])
def test_stop_brakes_within_the_limits_whether_commanded_or_not(commanding):
    robot = simple_robot()
    driver = connected(QuasiStaticSettings(sensors=PERFECT_SENSORS))
    _, moving = play(driver)
    driver.stop("test")
    lengths, sent = [driver.truth().unstrained_length[0]], list(moving[-3:])
    for _ in range(100):
        if commanding:
            sent.append(ask(driver, driver.measure().unstrained_length + 5.0).unstrained_length[0])
        assert driver.wait(PERIOD) is False
        lengths.append(driver.truth().unstrained_length[0])
    assert np.ptp(lengths[-20:], axis=0).max() < 1e-6
    # from 0.5 m/s at 5 m/s^2, after 25 ms of jerk and the lag of 60 ms
    assert 0.0 < (lengths[-1] - lengths[0]).max() < 0.5**2 / 10.0 + 0.5 * (0.025 + 0.06)
    if commanding:
        acceleration = np.diff(sent, 2, axis=0) / PERIOD**2
        assert (np.abs(acceleration) <= robot.acceleration_max * (1 + 1e-6)).all()


def test_a_stop_between_command_and_wait_lets_that_command_stand():
    driver = connected(QuasiStaticSettings(sensors=PERFECT_SENSORS))
    play(driver)
    sent = ask(driver, driver.measure().unstrained_length + 0.04).unstrained_length
    driver.stop("test")
    assert np.array_equal(ask(driver, sent + 1.0).unstrained_length, sent)
    driver.wait(PERIOD)
    assert (ask(driver, sent).unstrained_length > sent).all()  # braking, not standing


def test_time_passes_in_wait_alone():
    driver = connected()
    for _ in range(3):
        ask(driver, driver.measure().unstrained_length)
        driver.wait(0.02)
    assert driver.measure().time[0] == pytest.approx(3 * 0.02)


@pytest.mark.parametrize("duration", [0.0, -0.1, 0.002, 0.1, np.nan, np.inf])
def test_a_duration_other_than_the_period_is_refused(duration):
    with pytest.raises(InvalidField, match=r"duration: got .*; allowed: the driver's period, 0.02"):
        connected().wait(duration)


def test_a_second_command_in_a_cycle_is_refused():
    driver = connected()
    start = driver.measure().unstrained_length
    ask(driver, start)
    with pytest.raises(CarosacError, match="one command per cycle"):
        ask(driver, start + 0.01)
    driver.wait(0.02)
    ask(driver, start)


def test_no_interleaving_of_commands_and_waits_breaks_a_limit():
    robot = simple_robot()
    driver = connected()
    rng = np.random.default_rng(8)
    start = driver.measure().unstrained_length
    lengths = [driver._command.copy()]
    for _ in range(400):
        if rng.random() < 0.6:
            ask(driver, start + rng.normal(0.0, 0.5, start.shape))
        driver.wait(0.02)
        lengths.append(driver._command.copy())
    speed = np.diff(lengths, axis=0) / 0.02
    assert (np.abs(speed) <= robot.speed_max * (1 + 1e-9)).all()
    assert (np.abs(np.diff(speed, axis=0)) / 0.02 <= robot.acceleration_max * (1 + 1e-6)).all()


def test_one_seed_is_one_run():
    one, same, other = (play(connected(seed=seed))[0] for seed in (5, 5, 6))
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)


def test_connecting_again_starts_over():
    driver = connected(seed=5)
    first, _ = play(driver)
    driver.stop("test")
    driver.close()
    driver.connect()
    assert np.array_equal(play(driver)[0], first)


@pytest.mark.parametrize("state", ["never connected", "closed"])
def test_nothing_works_without_a_connection(state):
    driver = QuasiStaticDriver.build(simple_robot())
    if state == "closed":
        driver.connect()
        driver.close()
    some = Command(time=np.zeros(1), unstrained_length=np.full((1, 4), 8.0))
    for call in (
        driver.measure, driver.truth, lambda: driver.wait(PERIOD), lambda: driver.command(some)
    ):  # fmt: skip
        with pytest.raises(CarosacError, match="quasi_static: not connected; call connect"):
            call()
    driver.stop("test")
    driver.close()


def test_poses_are_measured_only_in_a_suite_with_poses():
    assert connected().measure().pose is None
    assert connected(QuasiStaticSettings(suite="lengths+pose")).measure().pose is not None


@pytest.mark.parametrize("suite", ["lengths+imu", "lengths+imu+pose", "pose"])
def test_other_suites_are_refused_with_the_reason(suite):
    refusal = r"suite: got .*any of \+pose, .* in this order; this plant has no inertia"
    with pytest.raises(InvalidField, match=refusal):
        QuasiStaticSettings(suite=suite)


def test_a_start_where_it_cannot_rest_is_refused_with_the_reason():
    driver = QuasiStaticDriver.build(
        simple_robot(), QuasiStaticSettings(start_position=(0.4, -1.8, 9.5))
    )
    with pytest.raises(
        InvalidField, match=r"start_position: got .*a position with an equilibrium \("
    ):
        driver.connect()
