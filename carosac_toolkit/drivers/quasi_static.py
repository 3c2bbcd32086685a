"""A simulated robot without inertia: at every instant it rests on its cables.

Winches, sensors and limits are real in time; the platform follows the wound lengths through the
statics. It shows geometry, sag, elasticity, delay and bias, and no sway.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from carosac_toolkit.arrays import Array, frozen_array
from carosac_toolkit.drivers.winch import Winches
from carosac_toolkit.errors import CarosacError, InvalidField
from carosac_toolkit.limits import Limiter, LimitSettings
from carosac_toolkit.physics import statics
from carosac_toolkit.robot import Robot
from carosac_toolkit.sensors import DelayLine, SensorSettings, quantised
from carosac_toolkit.values import Command, Measurement, Pose, Stamped, State

SUITES = ("lengths", "lengths+pose")


@dataclass(frozen=True, kw_only=True)
class QuasiStaticSettings:
    """Settings of `QuasiStaticDriver`.

    Attributes:
        suite: ``lengths`` or ``lengths+pose``; without inertia there is no IMU.
        sensors: Their numbers.
        limits: Of the commands.
        period: Time between two commands [s].
        start_position: Platform origin at the start in W [m]; None is the home position.
    """

    suite: str = "lengths"
    sensors: SensorSettings = field(default_factory=SensorSettings)
    limits: LimitSettings = field(default_factory=lambda: LimitSettings(box=False))
    period: float = 0.02
    start_position: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        """Refuse an unknown suite."""
        if self.suite not in SUITES:
            raise InvalidField("suite", repr(self.suite), f"one of {list(SUITES)}: no inertia here")


class QuasiStaticDriver:
    """One simulated robot, as fast as possible; time passes in `wait`."""

    Settings: ClassVar = QuasiStaticSettings

    def __init__(self, robot: Robot, settings: QuasiStaticSettings, seed: int) -> None:
        self._robot = robot
        self._settings = settings
        self._seed = seed
        self._connected = False

    @classmethod
    def build(
        cls, robot: Robot, settings: QuasiStaticSettings | None = None, *, seed: int = 0
    ) -> QuasiStaticDriver:
        """Make one for a plant; `seed` draws bias and noise of the sensors."""
        return cls(robot, settings or QuasiStaticSettings(), seed)

    def connect(self) -> None:
        """Set the robot down at rest at its start.

        Raises:
            InvalidField: It cannot rest there within its tension limits.
        """
        robot, settings = self._robot, self._settings
        start = robot.home_position
        if settings.start_position is not None:
            start = frozen_array("start_position", settings.start_position, (3,))
        rest = statics.inverse_kinematics(robot, start[None])
        if not rest.converged[0]:
            reason = statics.REASONS[rest.status[0]]
            raise InvalidField("start_position", start, f"a position of rest ({reason})")
        # A stream for each purpose: another sensor must not change what this one says.
        streams = np.random.SeedSequence(self._seed).spawn(3)
        bias, self._encoder_rng, self._mocap_rng = map(np.random.default_rng, streams)
        self._bias = settings.sensors.encoder_bias * bias.standard_normal(robot.n)
        self._winches = Winches(robot, rest.unstrained_length[0])
        self._rest = rest
        self._time = 0.0
        self._command = rest.unstrained_length[0] + self._bias
        self._limiter = Limiter(robot, settings.limits, period=settings.period)
        self._limiter.reset(self._command[None])
        sensors = settings.sensors
        self._encoders = DelayLine(sensors.encoder_rate, sensors.encoder_delay)
        self._mocap = DelayLine(sensors.pose_rate, sensors.pose_delay)
        self._connected = True
        self._stopping = False
        self._sent = False
        self._reading = quantised(self._command, sensors.encoder_resolution)
        self._sample()

    def measure(self) -> Measurement:
        """Newest samples that have arrived."""
        self._check_connected()
        now = np.array([self._time])
        n = self._robot.n
        taken, packed_lengths = self._encoders.newest(self._time)
        pose = None
        if self._settings.suite == "lengths+pose":
            when, packed = self._mocap.newest(self._time)
            pose = Pose(
                position=packed[None, :3],
                rotation=packed[None, 3:].reshape(1, 3, 3),
                time=np.array([when]),
            )
        rate = Stamped(time=np.array([taken]), value=packed_lengths[None, n:])
        length = packed_lengths[None, :n]
        return Measurement(time=now, unstrained_length=length, length_rate=rate, pose=pose)

    def command(self, command: Command) -> Command:
        """Limit the command and hold it until the next one; once stopped, brake instead.

        Raises:
            CarosacError: This cycle has its command already; limits count one a period.
        """
        self._check_connected()
        if self._sent and not self._stopping:
            raise CarosacError("quasi_static: one command a cycle; call wait() before the next")
        if self._stopping:
            self._brake()
            return Command(time=command.time, unstrained_length=self._command[None])
        actual = self._encoders.newest(self._time)[1][None, : self._robot.n]
        sent = self._limiter.apply(command, actual)
        self._command = np.array(sent.unstrained_length[0])
        self._sent = True
        return sent

    def wait(self, duration: float) -> bool:
        """Let one period pass; the winches follow the command of this cycle.

        A cycle without a command holds the last one, within the limits.

        Raises:
            InvalidField: Another duration than the period, for which the limits count.
        """
        self._check_connected()
        period = self._settings.period
        if not abs(duration - period) <= 1e-9 * period:
            raise InvalidField("duration", f"{duration} s", f"the driver's period, {period} s")
        if self._stopping:
            self._brake()
        elif not self._sent:
            now = np.array([self._time])
            self.command(Command(time=now, unstrained_length=self._command[None]))
        end = self._time + duration
        while self._time < end - 1e-9:
            h = min(end, self._next_sample()) - self._time
            self._winches.advance(self._command - self._bias, h)
            self._time += h
            self._sample()
        self._sent = False
        return not self._stopping

    def stop(self, reason: str) -> None:
        """Brake from now on, whatever is commanded, and also where nothing is."""
        self._stopping = True

    def close(self) -> None:
        """Let go."""
        self._connected = False

    def truth(self) -> State:
        """The pose at which the platform rests on the wound lengths."""
        self._check_connected()
        self._settle()
        return State(
            time=np.array([self._time]),
            position=self._rest.position,
            rotation=self._rest.rotation,
            unstrained_length=self._winches.length[None].copy(),
            tension=self._rest.tension,
        )

    def _brake(self) -> None:
        """Send the next command of the controlled stop, unless this cycle has its command."""
        if not self._sent:
            self._command = np.array(self._limiter.brake().unstrained_length[0])
            self._sent = True

    def _next_sample(self) -> float:
        """When the next sample is due [s]."""
        lines = [self._encoders]
        if self._settings.suite == "lengths+pose":
            lines.append(self._mocap)
        return min(line.next_due for line in lines)

    def _settle(self) -> None:
        """Rest on the lengths of this instant.

        Raises:
            CarosacError: There is no pose of rest; the winches have pulled the robot apart.
        """
        length = self._winches.length[None]
        rest = statics.forward_kinematics(self._robot, length, guess=self._rest)
        if not rest.converged[0]:
            raise CarosacError(f"no pose of rest at lengths {length[0]} m, {self._time:.3f} s")
        self._rest = rest

    def _sample(self) -> None:
        """Take the samples that are due."""
        import pinocchio

        sensors = self._settings.sensors
        if self._encoders.due(self._time):
            noise = sensors.encoder_noise * self._encoder_rng.standard_normal(self._robot.n)
            reading = quantised(
                self._winches.length + self._bias + noise, sensors.encoder_resolution
            )
            # The rate is what two readings say, their noise included.
            rate = (reading - self._reading) * sensors.encoder_rate
            self._reading = reading
            self._encoders.put(self._time, np.concatenate([reading, rate]))
        if self._settings.suite == "lengths+pose" and self._mocap.due(self._time):
            self._settle()
            noise = self._mocap_rng.standard_normal(6)
            turn = pinocchio.exp3(sensors.rotation_noise * noise[:3])
            position = self._rest.position[0]
            position = position + sensors.position_noise * noise[3:]
            packed: Array = np.concatenate([position, (turn @ self._rest.rotation[0]).ravel()])
            self._mocap.put(self._time, packed)

    def _check_connected(self) -> None:
        """Refuse to work before `connect` and after `close`."""
        if not self._connected:
            raise CarosacError("quasi_static: not connected; call connect() first")
