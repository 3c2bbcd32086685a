"""Base of all simulated drivers: clock, sensors, command limits and the controlled stop.

A `Plant` is the simulation behind them. Time passes in `wait` alone; the plant is advanced from
one sample of a sensor to the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from carosac_toolkit.base.arrays import Array, as_floats, frozen_array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.numbers import check_period
from carosac_toolkit.drivers.plant import Plant
from carosac_toolkit.drivers.sensor_suite import SensorSuite, check_sensors
from carosac_toolkit.drivers.sensors import SensorSettings, check_suite
from carosac_toolkit.drivers.ticks import TickSchedule
from carosac_toolkit.loop.values import Command, Measurement, State
from carosac_toolkit.physics.motion.winch import WinchSettings
from carosac_toolkit.safety.limiter import Limiter, LimitSettings
from carosac_toolkit.safety.settled import settled

__all__ = ["Plant", "SimulatedDriver", "SimulatedSettings"]

Point = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class SimulatedSettings:
    """Settings that all simulated drivers share.

    Attributes:
        suite: ``lengths``, and any of `carosac_toolkit.drivers.sensors.SENSORS` behind it, each
            after a plus; an IMU needs inertia, swivel encoders pulleys.
        sensors: Rates, noise, bias and delays of the sensors.
        limits: Limits of the commands.
        winch: Control of the winches by their drives, in the plant.
        period: Time between two commands [s].
        start_position: Platform origin at the start in W [m], one for all robots or one each; None
            is the home position.
        real_time: True if `wait` also waits for the wall clock.
    """

    inertial: ClassVar[bool] = True

    suite: str = "lengths"
    sensors: SensorSettings = field(default_factory=SensorSettings)
    limits: LimitSettings = field(default_factory=lambda: LimitSettings(box=False))
    winch: WinchSettings = field(default_factory=WinchSettings)
    period: float = 0.02
    start_position: Point | tuple[Point, ...] | None = None
    real_time: bool = False

    def __post_init__(self) -> None:
        """Refuse an unknown suite, sensors of another type, and a switch that is not a bool."""
        if not isinstance(self.sensors, SensorSettings):
            raise InvalidField("sensors", repr(self.sensors), "SensorSettings(...)")
        check_suite(self.suite, inertial=self.inertial)
        if not isinstance(self.real_time, bool):
            raise InvalidField("real_time", repr(self.real_time), "True or False")


class SimulatedDriver:
    """B simulated robots, as fast as possible or in real time; time passes in `wait`.

    In real time `wait` returns at the ticks of an absolute schedule of one period, which starts at
    `connect` and does not drift. Where the cycle took longer than a period, it waits for the next
    tick that lies ahead and counts those missed in `overruns`. Simulated time goes on by one period
    a cycle all the same: it falls behind the wall clock, and no burst of cycles catches up.
    """

    Settings: ClassVar[type[SimulatedSettings]] = SimulatedSettings
    name: ClassVar[str] = "simulated"

    def __init__(
        self, plant: Plant, settings: SimulatedSettings, seed: int | Sequence[int] = 0
    ) -> None:
        """Take a plant; `seed`, one or one for each robot, draws bias and noise of the sensors."""
        check_sensors(settings.suite, settings.sensors, plant)
        self._plant = plant
        self._settings = settings = settled(settings, plant.robot)
        self._seed = seed
        self._connected = False
        self._ticks = TickSchedule(settings.period)

    @property
    def overruns(self) -> int:
        """Ticks of the wall clock that were missed since `connect`, in real time."""
        return self._ticks.missed

    def connect(self) -> None:
        """Set the robots down at rest at their start.

        Raises:
            InvalidField: One cannot rest there.
        """
        plant, settings = self._plant, self._settings
        self._connected = False
        plant.reset(self._start())
        self._time = 0.0
        self._sensors = SensorSuite(settings.suite, settings.sensors, plant, self._seed)
        self._command = plant.read_lengths() + self._sensors.encoder_bias
        self._limiter = Limiter(plant.robot, settings.limits, period=settings.period)
        self._limiter.reset(self._command)
        self._sensors.sample(plant, self._time)
        self._connected = True
        self._stopping = False
        self._sent = False
        self._ticks = TickSchedule(settings.period)

    def measure(self) -> Measurement:
        """Return the newest samples that have arrived; at the same time the same ones again."""
        self._check_connected()
        return self._sensors.measure(self._time)

    def command(self, command: Command) -> Command:
        """Limit the command and hold it until the next one; once stopped, brake instead.

        Raises:
            CarosacError: This cycle has its command already; limits count one a period.
        """
        self._check_connected()
        if self._sent and not self._stopping:
            raise CarosacError(f"{self.name}: one command per cycle; call wait() before the next")
        if self._stopping:
            self._brake()
            return Command(time=command.time, unstrained_length=self._command)
        sent = self._limiter.apply(command, self._sensors.newest_lengths(self._time))
        self._command = np.array(sent.unstrained_length)
        self._sent = True
        return sent

    def wait(self, duration: float) -> bool:
        """Simulate one period; the winches follow the command of this cycle.

        A cycle without a command holds the last one, within the limits.

        Raises:
            InvalidField: Another duration than the period, for which the limits count.
        """
        self._check_connected()
        check_period(duration, self._settings.period, "driver")
        if self._stopping:
            self._brake()
        elif not self._sent:
            now = np.full(self._plant.size, self._time)
            self.command(Command(time=now, unstrained_length=self._command))
        self._pass_time(duration)
        self._sent = False
        if self._settings.real_time:
            self._ticks.wait()
        return not self._stopping

    def stop(self, reason: str) -> None:
        """Brake from now on, whatever is commanded, and also where nothing is."""
        self._stopping = True

    def close(self) -> None:
        """Release the plant."""
        self._connected = False

    @property
    def plant(self) -> Plant:
        """Robot behind winches and sensors."""
        return self._plant

    def truth(self) -> State:
        """Return the current state of the plant."""
        self._check_connected()
        return replace(self._plant.truth(), time=np.full(self._plant.size, self._time))

    def _start(self) -> Array:
        """Return the initial positions of the platforms in W [m], shape (B, 3)."""
        plant, asked = self._plant, self._settings.start_position
        if asked is None:
            return np.tile(plant.robot.home_position, (plant.size, 1))
        each = as_floats("start_position", asked).ndim == 2
        start = frozen_array("start_position", asked, (plant.size, 3) if each else (3,))
        return np.array(np.broadcast_to(start, (plant.size, 3)))

    def _pass_time(self, duration: float) -> None:
        """Advance the plant, with a stop at each sample."""
        # A winch closes its loop on its own encoder, so the bias of that shortens the cable.
        asked = self._command - self._sensors.encoder_bias
        for step in self._sensors.steps(self._time, duration):
            self._plant.advance(asked, step)
            self._time += step
            self._sensors.sample(self._plant, self._time)

    def _brake(self) -> None:
        """Send the next command of the controlled stop, unless this cycle has its command."""
        if not self._sent:
            self._command = np.array(self._limiter.brake().unstrained_length)
            self._sent = True

    def _check_connected(self) -> None:
        """Refuse to work before `connect` and after `close`."""
        if not self._connected:
            raise CarosacError(f"{self.name}: not connected; call connect() first")
