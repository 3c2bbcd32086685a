"""Winches of a simulated driver: lag, speed and acceleration."""

from __future__ import annotations

import numpy as np

from carosac_toolkit.arrays import Array
from carosac_toolkit.robot import Robot

STEP = 2e-3  # [s]


class Winches:
    """Wound lengths that follow their commands with a first-order lag, within winch limits.

    The drive asks for the speed (command - length) / lag; acceleration and speed are limited.
    """

    def __init__(self, robot: Robot, unstrained_length: Array) -> None:
        """Start at rest.

        Args:
            robot: The plant.
            unstrained_length: True lengths [m], shape (n,).
        """
        self._robot = robot
        self.length = np.array(unstrained_length, dtype=np.float64)
        self.rate = np.zeros(robot.n)

    def advance(self, command: Array, duration: float) -> None:
        """Follow a constant command for a time [s]."""
        robot = self._robot
        count = max(1, round(duration / STEP))
        h = duration / count
        # The lag must be resolved: a faster winch than one step reaches its command in one.
        lag = np.maximum(robot.winch_lag, h)
        for _ in range(count):
            wish = np.clip((command - self.length) / lag, -robot.speed_max, robot.speed_max)
            change = np.clip(
                wish - self.rate, -robot.acceleration_max * h, robot.acceleration_max * h
            )
            self.rate = self.rate + change
            self.length = self.length + h * self.rate
