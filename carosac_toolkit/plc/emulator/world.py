"""The simulated robot behind the PLC, in the units of the PLC."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.drivers.plant import Plant
from carosac_toolkit.drivers.sensor_suite import SensorSuite
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.plugin_builder import build_plugin
from carosac_toolkit.loop.values import State
from carosac_toolkit.plc.emulator.machine import Inputs
from carosac_toolkit.plc.emulator.settings import EmulatorSettings
from carosac_toolkit.robot.hardware import Hardware
from carosac_toolkit.robot.robot import Robot

RATE_SPAN_S = 0.01  # over which the PLC takes the difference for a velocity


class World:
    """One robot with encoders, load cells and an IMU.

    The encoders read `shift` too much, which they lost while they were switched off. The drives
    close their loops on the motors, so that an encoder that jumps moves nothing. Drives and
    encoders with the wrong sign turn the other way from where the robot was set down.

    Attributes:
        plant: Simulation of the robot.
        time: Simulated time since the robot was set down [s].
        shift: Offset of each encoder [m], shape (n,).
    """

    def __init__(
        self, robot: Robot, hardware: Hardware, settings: EmulatorSettings, seed: int
    ) -> None:
        """Make the plant; call `place` before anything else.

        Args:
            robot: Robot that is simulated.
            hardware: Units of the PLC.
            settings: Settings of plant and sensors.
            seed: Seed of wind, noise and shift.

        Raises:
            InvalidField: No such plant.
        """
        self.plant = _plant(robot, settings, seed)
        self._hardware, self._settings, self._seed = hardware, settings, seed
        rng = np.random.default_rng([seed, 1])
        self.shift = settings.shift * rng.standard_normal(robot.n)
        self._read_sign, self._drive_sign = np.ones(robot.n), np.ones(robot.n)
        self._read_sign[list(settings.wrong_sign)] = -1.0
        self._drive_sign[[*settings.wrong_sign, *settings.reversed_drive]] = -1.0

    def place(self, position: Array) -> None:
        """Set the robot down at rest, platform origin at a position in W [m], shape (3,).

        Raises:
            InvalidField: It has no equilibrium there.
        """
        self.plant.reset(position[None])
        self.time = 0.0
        rate = 1.0 / self._settings.cycle
        suite = "lengths+imu" if self.plant.inertial else "lengths"
        sensors = replace(
            self._settings.sensors, encoder_rate=rate, encoder_delay=0.0, tension_rate=rate,
            tension_delay=0.0, tension=self._settings.has_tension,
        )  # fmt: skip
        self._suite = SensorSuite(suite, sensors, self.plant, self._seed)
        span = max(1, round(RATE_SPAN_S / self._settings.cycle))
        self._lengths: deque[Array] = deque(maxlen=span + 1)
        self._imu: list[tuple[float, Array]] = []
        self._read()
        self._down = self._hardware.number(self._lengths[-1] + self.shift)
        self._down_standing = self.standing

    def jump(self, axis: int, distance: float) -> None:
        """Shift the readings of the encoder of a cable, from 0, by a distance [m]."""
        self.shift[axis] += distance

    def advance(self, number: Array) -> None:
        """Advance one PLC cycle at constant set positions, without `shift` [unit], shape (n,)."""
        number = self._down_standing + self._drive_sign * (number - self._down_standing)
        asked = self._hardware.length(number) - self._suite.encoder_bias[0]
        for step in self._suite.steps(self.time, self._settings.cycle):
            self.plant.advance(asked[None], step)
            self.time += step
            self._read()

    @property
    def standing(self) -> Array:
        """Set positions, without `shift` and noise, at which nothing moves [unit], shape (n,)."""
        lengths = self.plant.read_lengths() + self._suite.encoder_bias
        return self._hardware.number(lengths[0])

    @property
    def inputs(self) -> Inputs:
        """Present readings of the sensors, in the units of the PLC."""
        lengths = self._lengths
        span = (len(lengths) - 1) * self._settings.cycle
        rate = (lengths[-1] - lengths[0]) / span if span else np.zeros_like(lengths[-1])
        tension = self._measured.tension
        number = self._hardware.number(lengths[-1] + self.shift)
        return Inputs(
            length=self._down + self._read_sign * (number - self._down),
            rate=self._read_sign * rate / self._hardware.unit,
            tension=None if tension is None else tension.value[0],
        )

    def imu_samples(self) -> list[tuple[float, Array]]:
        """Return times [s] and samples since the last call: angular rate, specific force in P."""
        samples, self._imu = self._imu, []
        return samples

    def truth(self) -> State:
        """Return the true state of the robot."""
        return self.plant.truth()

    def _read(self) -> None:
        """Take the samples that are due."""
        self._suite.sample(self.plant, self.time)
        self._measured = self._suite.measure(self.time)
        self._lengths.append(np.array(self._measured.unstrained_length[0]))
        imu = self._measured.imu
        if imu is not None:
            both = np.concatenate([imu.angular_rate[0], imu.specific_force[0]], axis=1)
            self._imu += list(zip(imu.time[0].tolist(), both, strict=True))


def _plant(robot: Robot, settings: EmulatorSettings, seed: int) -> Plant:
    """Return the plant of a simulated driver."""
    offered = {"cables": settings.cables, "wind_force": settings.wind_force}
    kind = plugins.load("drivers", settings.plant)
    driver = build_plugin(kind, robot, where="plant", offered=offered, seed=seed)
    plant: Plant | None = getattr(driver, "plant", None)
    if plant is None:
        raise CarosacError(f"plc: driver '{settings.plant}' has no plant; use a simulated one")
    return plant
