"""The controller in the loop: sway, offsets, limits, failures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import carosac_toolkit as ct
from baselines.dynamic_estimator import DynamicEstimator
from baselines.kinematic_solver_controller import KinematicSolverController
from baselines.mpc import Mpc, MpcSettings, NoStart
from baselines.mpc.controller import SHIFTED_STEPS_MAX
from carosac_toolkit import conformance, trajectories
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.conformance.scenes import make_scene
from carosac_toolkit.drivers.sensors import SensorSettings
from carosac_toolkit.loop.loop import run
from carosac_toolkit.studies.run.run_case import Truth
from sim_warp.driver import SimDriver, SimDriverSettings
from tests.robots import eight_cable_robot, simple_robot, with_pulleys

PERFECT = SensorSettings(encoder_noise=0.0, encoder_bias=0.0, encoder_resolution=0.0)


def plain(robot, *, seed):
    """Interpreted, so that no test waits for compilers of five and nine cables."""
    return Mpc.build(robot, MpcSettings(compiled="never"), seed=seed)


def live(controller, *, plant, path, rest=4.0, belief=None):
    """Run on catenary cables with perfect sensors; the truth is believed."""
    start = tuple(float(x) for x in path.sample([0.0]).position[0])
    settings = SimDriverSettings(
        cables="catenary", period=controller.period, start_position=start, sensors=PERFECT
    )
    driver = SimDriver.build(plant, settings, seed=0)
    estimator = (belief or Truth)(driver)
    return run(driver, estimator, controller, path, duration=path.duration + rest)


def move(robot, *, by=(0.5, 0.6, 0.4), speed=1.5, acceleration=2.0):
    start = robot.home_position
    return trajectories.line(start, start + by, speed_max=speed, acceleration_max=acceleration)


def errors(log):
    return np.linalg.norm(log.position - log.reference, axis=2)[:, 0]


@pytest.mark.parametrize("check", conformance.CONTROLLER_CHECKS.values(),
                         ids=list(conformance.CONTROLLER_CHECKS))  # fmt: skip
@pytest.mark.parametrize("robot", [simple_robot(), eight_cable_robot(),
                                   with_pulleys(simple_robot())],
                         ids=["four", "eight", "pulleys"])  # fmt: skip
def test_it_keeps_the_contract(check, robot):
    check(plain, robot)


def test_it_tracks_and_calms_the_platform_where_statics_leave_it_swinging():
    robot = simple_robot()
    plant = replace(robot, mass=1.05 * robot.mass, axial_stiffness=0.8 * robot.axial_stiffness)
    path = move(robot)
    controller = Mpc.build(robot)
    ours = live(controller, plant=plant, path=path)
    theirs = live(KinematicSolverController.build(robot), plant=plant, path=path)
    assert np.sqrt((errors(ours) ** 2).mean()) < 0.5 * np.sqrt((errors(theirs) ** 2).mean())
    calm = ours.time > path.duration + 3.0
    swing = [np.ptp(log.position[calm, 0], axis=0).max() for log in (ours, theirs)]
    assert swing[0] < 0.1 * swing[1]
    assert all(cycle < 10 for cycle, _ in ours.limited)  # at the start, lengths are not known
    assert (ours.tension > robot.tension_min - 0.05 * robot.weight).all()
    assert (ours.tension < robot.tension_max).all()
    assert not controller.record.failures


def test_wrong_parameters_leave_no_steady_error_of_what_is_believed():
    robot = simple_robot()
    rng = np.random.default_rng(3)
    plant = replace(
        robot, mass=1.2 * robot.mass, axial_stiffness=0.5 * robot.axial_stiffness,
        center_of_mass=robot.center_of_mass + np.array([0.02, -0.02, 0.0]),
        exit_points=robot.exit_points + 0.01 * rng.normal(size=(4, 3)),
    )  # fmt: skip
    path = move(robot)
    log = live(Mpc.build(robot), plant=plant, path=path, rest=6.0)
    solver = live(KinematicSolverController.build(robot), plant=plant, path=path, rest=6.0)
    last = log.time > path.duration + 4.0
    steady = [np.linalg.norm((run.position - run.reference)[last, 0].mean(axis=0))
              for run in (log, solver)]  # fmt: skip
    assert steady[0] < 2e-3
    assert steady[1] > 10e-3


def test_eight_cables_hold_the_attitude_and_the_path():
    robot = eight_cable_robot()
    path = move(robot, by=(0.2, 0.15, 0.1), speed=0.5, acceleration=1.0)
    controller = Mpc.build(robot)
    log = live(controller, plant=robot, path=path, rest=1.0)
    assert errors(log).max() < 10e-3  # 20 ms at its fastest: winches that step
    assert np.abs(log.rotation - robot.home_rotation).max() < 15e-3
    assert np.abs(log.rotation[-1] - robot.home_rotation).max() < 2e-3
    assert not controller.record.failures


class Bare(Truth):
    """Knows the pose alone."""

    def reset(self, measurement):
        return replace(super().reset(measurement), twist=None, tension=None)


def test_beliefs_without_twist_do():
    robot = simple_robot()
    path = move(robot, speed=0.8, acceleration=0.8)
    log = live(Mpc.build(robot), plant=robot, path=path, rest=3.0, belief=Bare)
    assert errors(log)[-10:].max() < 10e-3


def fail(monkeypatch, controller, when):
    """Let no quadratic program have a solution at such times."""
    improve = controller._planner.improve
    monkeypatch.setattr(
        controller._planner, "improve",
        lambda *a, time, **k: None if when(time) else improve(*a, time=time, **k),
    )  # fmt: skip


def test_after_failures_the_plan_goes_on_and_then_the_platform_rests(monkeypatch):
    robot = simple_robot()
    path = move(robot)
    controller = Mpc.build(robot)
    fail(monkeypatch, controller, lambda time: time >= 1.0)
    log = live(controller, plant=robot, path=path, rest=6.0)
    record = controller.record
    assert record.fallbacks["shifted plan"] == SHIFTED_STEPS_MAX
    assert record.fallbacks["to rest"] == record.failures["no solution"] - 5
    assert record.reason == "no solution: the quadratic program has no solution"
    assert all(cycle < 10 for cycle, _ in log.limited)
    moving = np.abs(np.diff(log.command[:, 0], axis=0)).max(axis=1)
    assert moving[-50:].max() < 1e-5
    swing = np.ptp(log.position[-100:, 0], axis=0).max()
    assert swing < 0.5  # nobody damps it


def test_after_a_second_without_solves_on_the_way_it_comes_back(monkeypatch):
    robot = simple_robot()
    path = move(robot)
    controller = Mpc.build(robot)
    fail(monkeypatch, controller, lambda time: 0.5 <= time < 1.6)
    log = live(controller, plant=robot, path=path, rest=6.0)
    assert errors(log).max() > 0.2
    assert errors(log)[-50:].max() < 10e-3
    assert controller.record.recovered == 1


def test_a_platform_that_was_thrown_about_on_slack_cables_comes_back(monkeypatch):
    """For 0.8 s the winches do what nobody has planned; then the controller is on its own."""
    robot = ct.load_robot("scampi")
    path = move(robot)
    controller = Mpc.build(robot)
    rng = np.random.default_rng(102)
    throws = np.repeat(rng.uniform(-5.0, 5.0, size=(5, 4)), 8, axis=0)  # [m/s^2]
    follow = controller._follow

    def thrown(plan):
        count = controller.record.commands - 25
        if 0 <= count < len(throws):
            return controller._winches.accelerate(throws[count])
        return follow(plan)

    monkeypatch.setattr(controller, "_follow", thrown)
    log = live(controller, plant=robot, path=path, rest=7.0)
    assert (log.tension < 0.1 * robot.weight).any(axis=2).mean() > 0.02  # it was slack
    assert errors(log).max() > 0.4
    assert errors(log)[-50:].max() < 10e-3
    assert controller.record.recovered >= 1


def test_wrong_exit_points_do_not_shake_the_platform_while_the_estimator_finds_out():
    """The belief moves by 2 cm under way; what does not fit the lengths must not drive winches."""
    robot = ct.load_robot("carosac")
    rng = np.random.default_rng([0, 11])
    off = rng.normal(size=(4, 3))
    plant = replace(robot, exit_points=robot.exit_points
                    + 0.02 * off / np.linalg.norm(off, axis=1, keepdims=True))  # fmt: skip
    path = trajectories.line([-0.52, -1.25, 3.6], [1.22, -1.14, 2.16],
                             speed_max=2.0, acceleration_max=3.0)  # fmt: skip
    controller = Mpc.build(robot)
    settings = SimDriverSettings(suite="lengths+imu", cables="catenary", period=0.02,
                                 start_position=(-0.52, -1.25, 3.6))  # fmt: skip
    driver = SimDriver.build(plant, settings, seed=0)
    log = run(driver, DynamicEstimator.build(robot), controller, path, duration=1.2)
    assert errors(log).max() < 0.06
    assert controller.record.held < 5
    assert not controller.record.softened


@pytest.mark.slow
def test_a_platform_rests_near_a_face_where_its_slackest_cable_sags():
    """There it bounces on cables at 3 Hz; a belief that took that for sway would stir it up."""
    robot = ct.load_robot("scampi")
    path = trajectories.line([-0.39, -4.63, 2.11], [-0.39, -4.63, 1.81],
                             speed_max=1.0, acceleration_max=2.0)  # fmt: skip
    controller = Mpc.build(robot)
    settings = SimDriverSettings(
        suite="lengths+imu", period=controller.period,
        start_position=(-0.39, -4.63, 2.11),
    )  # fmt: skip
    driver = SimDriver.build(robot, settings, seed=5)
    log = run(driver, DynamicEstimator.build(robot), controller, path, duration=10.0)
    assert errors(log)[log.time > 4.0].max() < 0.015


def test_late_solves_are_thrown_away_and_counted():
    robot = simple_robot()
    controller = Mpc.build(robot, MpcSettings(time_budget=1e-9))
    scene = make_scene(robot)
    controller.reset(scene.beliefs[0])
    reference = scene.references(controller.period, controller.horizon)[0]
    controller.command(scene.beliefs[0], reference)
    assert controller.record.failures == {"late": 1}
    assert controller.fallbacks == {"late": 1}
    assert "allowed: 1e-09 s" in controller.record.reason
    assert controller.record.solve_time > 0.0


def test_a_belief_that_jumps_away_is_not_followed_until_the_winches_rest():
    robot = simple_robot()
    controller = Mpc.build(robot)
    scene = make_scene(robot)
    belief = scene.beliefs[0]
    reference = scene.references(controller.period, controller.horizon)[0]
    controller.reset(belief)
    before = controller.command(belief, reference).unstrained_length
    away = replace(belief, position=belief.position + np.array([[0.0, 2.0, 0.0]]))
    held = before
    for _ in range(100):
        after = controller.command(away, reference).unstrained_length
        held = held if controller.record.rebased else after
    assert controller.record.failures["belief"] >= 5
    assert controller.record.rebased == 1
    assert np.abs(held - before).max() < 0.02


def test_plain_and_compiled_give_the_same_commands():
    robot = simple_robot()
    scene = make_scene(robot)
    lengths = []
    for compiled in ("auto", "never"):
        controller = Mpc.build(robot, MpcSettings(compiled=compiled))
        references = scene.references(controller.period, controller.horizon)
        controller.reset(scene.beliefs[0])
        lengths.append([controller.command(b, r).unstrained_length[0]
                        for b, r in zip(scene.beliefs, references, strict=True)])  # fmt: skip
    assert np.array(lengths[0]) == pytest.approx(np.array(lengths[1]), abs=1e-7)


def test_a_batch_and_a_place_out_of_reach_are_refused():
    robot = simple_robot()
    scene = make_scene(robot)
    one = scene.beliefs[0]
    controller = Mpc.build(robot)
    both = replace(
        one, time=np.zeros(2), position=np.tile(one.position, (2, 1)),
        rotation=np.tile(one.rotation, (2, 1, 1)),
    )  # fmt: skip
    with pytest.raises(InvalidField, match="belief: got 2 robots; allowed: one"):
        controller.reset(both)
    with pytest.raises(InvalidField, match=r"a call of reset\(\) first"):
        controller.command(one, scene.references(controller.period, controller.horizon)[0])
    with pytest.raises(NoStart, match=r"allowed: \[.*\] to \[.*\] m, outside pulleys"):
        controller.reset(replace(one, position=one.position + 100.0))


@pytest.mark.parametrize(("name", "value", "allowed"), [
    ("period", 0.0, "period > 0, finite"), ("position_weight", -1.0, "position_weight >= 0"),
    ("stages", 20.5, "a whole number"), ("compiled", "yes", "one of"),
    ("lookahead", 0.03, r"lookahead > 2 \* period"), ("stages", 1, "a whole number from 2"),
    ("time_budget", np.nan, "time_budget > 0"),
    ("limit_share", 1.5, "0 < limit_share <= 1"),
])  # fmt: skip
def test_settings_that_make_no_sense_are_refused(name, value, allowed):
    with pytest.raises(InvalidField, match=allowed):
        MpcSettings(**{name: value})
