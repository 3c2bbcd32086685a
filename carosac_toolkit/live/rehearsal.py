"""Rehearsal of a few cycles before a robot is connected, so that programs load what they need."""

from __future__ import annotations

from typing import Any

import numpy as np

from carosac_toolkit.loop.loop import ReferenceSource
from carosac_toolkit.loop.plugin_errors import exit_refused
from carosac_toolkit.loop.protocols import Controller, Estimator
from carosac_toolkit.loop.values import Command, Imu, Measurement, Stamped, State
from carosac_toolkit.physics.rest.homing import homing_lengths
from carosac_toolkit.robot.robot import Robot

REHEARSED_CYCLES = 5
IMU_PERIOD_S = 0.005


def rehearse(
    robot: Robot, estimator: Estimator, controller: Controller, path: ReferenceSource, *, suite: str
) -> None:
    """Run estimator and controller on a robot at rest at home; nothing is sent anywhere.

    Both are reset before the real run, so that they keep nothing of it.

    Raises:
        BadPlugin: One of the two called `sys.exit()`.
    """
    home = State(
        time=np.zeros(1), position=robot.home_position[None], rotation=robot.home_rotation[None]
    )
    lengths = homing_lengths(robot, home)[None]
    belief: Any = None
    for k in range(REHEARSED_CYCLES):
        now = k * controller.period
        measurement = _at_rest(robot, lengths, now, suite)
        held = Command(time=np.array([now]), unstrained_length=lengths)
        with exit_refused("estimator", estimator):
            belief = (
                estimator.reset(measurement)
                if k == 0
                else estimator.update(belief, held, measurement)
            )
        with exit_refused("controller", controller):
            if k == 0:
                controller.reset(belief)
            controller.command(belief, path.window(0.0, controller.horizon, controller.period))


def _at_rest(robot: Robot, lengths: Any, now: float, suite: str) -> Measurement:
    """Return what is measured at rest at home."""
    time, imu = np.array([now]), None
    if "imu" in suite:
        when = now - IMU_PERIOD_S * np.arange(1, -1, -1.0)
        force = np.broadcast_to(robot.home_rotation.T @ [0.0, 0.0, robot.gravity], (1, 2, 3))
        imu = Imu(time=when[None], angular_rate=np.zeros((1, 2, 3)), specific_force=force)
    rate = Stamped(time=time - 0.01, value=np.zeros_like(lengths))
    return Measurement(time=time, unstrained_length=lengths, length_rate=rate, imu=imu)
