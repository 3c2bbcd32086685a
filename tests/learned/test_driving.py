"""Bundled policies on plants that are not the robot of the file, behind an estimator."""

from dataclasses import replace

import numpy as np

import carosac_toolkit as ct
from carosac_toolkit import trajectories
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.loop import run
from carosac_toolkit.robot.condition_file import find_condition
from carosac_toolkit.robot.perturbations import draw_plant
from learned.policy_controller import PolicyController


def test_a_soft_plant_low_in_the_box_comes_to_rest_behind_the_dynamic_estimator():
    """Estimator and policy are a loop: with pushes priced at a third of now it swung up here."""
    robot = ct.load_robot("scampi")
    plant = draw_plant(robot, find_condition("nominal-1"), np.random.default_rng([13, 11]))
    end = np.array([0.26, -1.8, 2.03])
    path = trajectories.line(
        end + np.array([0.0, -0.3, 0.3]), end, speed_max=1.0, acceleration_max=1.0
    )
    controller = PolicyController.build(robot)
    kind = plugins.load("drivers", "simulator")
    start = tuple(float(x) for x in path.sample(np.zeros(1)).position[0])
    settings = replace(
        kind.Settings(), suite="lengths+imu", period=controller.period, start_position=start
    )
    driver = kind.build(plant, settings, seed=13)
    estimator = plugins.load("estimators", "dynamic_estimator").build(robot)
    log = run(driver, estimator, controller, path, duration=path.duration + 8.0)
    assert log.position is not None
    early, late = (
        log.position[(log.time > path.duration + t) & (log.time < path.duration + t + 2.0), 0]
        for t in (0.0, 6.0)
    )
    assert np.linalg.norm(late.std(axis=0)) < 0.5 * np.linalg.norm(early.std(axis=0)) < 0.01
