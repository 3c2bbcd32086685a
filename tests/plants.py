"""Plants of simulated drivers whose motion is known in closed form, whatever is commanded."""

from __future__ import annotations

import numpy as np
import pinocchio

from carosac_toolkit.loop.values import State
from tests.robots import simple_robot

CENTRE = np.array([0.4, -1.8, 2.2])
AXIS = np.array([0.48, -0.6, 0.64])


class TurningPlant:
    """B platforms on ellipses that turn about a tilted axis; cables are as long as time says.

    Robot b is b tenths of a second ahead of the first one.
    """

    inertial = True

    def __init__(self, size=1, speed=2.0, spin=1.5, robot=None):
        self.robot = robot or simple_robot()
        self.size = size
        self.speed, self.spin = speed, spin  # [rad/s]
        self.now = 0.0
        self.positions, self.commands = [], []

    def reset(self, position):
        self.now = 0.0
        self.positions.append(position)

    def advance(self, command, duration):
        self.now += duration
        self.commands.append((command, duration))

    def clocks(self):
        return self.now + 0.1 * np.arange(self.size)

    def position_at(self, clocks):
        phase = self.speed * clocks[:, None]
        return CENTRE + np.array([0.5, 0.3, 0.2]) * np.sin(phase + np.array([0.0, 1.0, 2.0]))

    def rotation_at(self, clocks):
        return np.stack([pinocchio.exp3(self.spin * t * AXIS) for t in clocks])

    def length_at(self, clocks):
        return 8.0 + clocks[:, None] * np.arange(1, self.robot.n + 1)

    def truth(self):
        clocks = self.clocks()
        phase = self.speed * clocks[:, None] + np.array([0.0, 1.0, 2.0])
        velocity = self.speed * np.array([0.5, 0.3, 0.2]) * np.cos(phase)
        turning = np.tile(self.spin * AXIS, (self.size, 1))
        return State(
            time=clocks,
            position=self.position_at(clocks),
            rotation=self.rotation_at(clocks),
            twist=np.concatenate([velocity, turning], axis=1),
            unstrained_length=self.length_at(clocks),
            tension=100.0 + 10.0 * self.length_at(clocks),
        )

    def acceleration(self):
        linear = -(self.speed**2) * (self.position_at(self.clocks()) - CENTRE)
        return np.concatenate([linear, np.zeros((self.size, 3))], axis=1)

    def read_lengths(self):
        return self.length_at(self.clocks())
