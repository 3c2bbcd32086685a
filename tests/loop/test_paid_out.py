"""Estimators see what winches with hysteresis have paid out, not what their drums turned for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import carosac_toolkit as ct
from carosac_toolkit import trajectories
from carosac_toolkit.drivers.sensors import PERFECT_SENSORS
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.loop import run
from carosac_toolkit.loop.plugin_builder import build_plugin
from carosac_toolkit.loop.values import Belief
from carosac_toolkit.physics.motion.winch import PaidOutLengths

HYSTERESIS_M = 2e-3


class Listener:
    """An estimator that knows nothing, and keeps the lengths that it was told."""

    def __init__(self, robot):
        self.robot, self.lengths = robot, []

    def reset(self, measurement):
        return self.update(None, None, measurement)

    def update(self, belief, command, measurement):
        self.lengths.append(measurement.unstrained_length)
        return Belief(
            time=measurement.time, position=self.robot.home_position[None],
            rotation=self.robot.home_rotation[None],
        )  # fmt: skip


def heard(robot, paid_out):
    """The lengths that an estimator hears, and the true ones, (T, n) each."""
    home = robot.home_position
    path = trajectories.line(
        home, home + np.array([0.3, 0.2, 0.2]), speed_max=0.4, acceleration_max=0.5
    )
    driver = build_plugin(
        plugins.load("drivers", "quasi_static"), robot, where="driver", seed=0,
        asked={"start_position": tuple(home), "sensors": PERFECT_SENSORS},
    )  # fmt: skip
    controller = build_plugin(
        plugins.load("controllers", "straight_line"), robot, where="controller", asked={}
    )
    listener = Listener(robot)
    log = run(driver, listener, controller, path, paid_out=paid_out)
    return np.array(listener.lengths)[:, 0], log.true_length[:, 0]


def test_an_estimator_hears_true_lengths_of_winches_with_hysteresis():
    robot = replace(ct.load_robot("carosac"), length_hysteresis=np.full(4, HYSTERESIS_M))
    told, true = heard(robot, PaidOutLengths.of(robot))
    assert np.abs(told - true).max() < 0.05 * HYSTERESIS_M
    told, true = heard(robot, None)
    assert np.abs(told - true).max() > 0.9 * HYSTERESIS_M
