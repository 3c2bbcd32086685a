"""Sensors of simulated robots: sampling, delay, noise and bias."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.rotations import (
    from_matrix,
    from_rotation_vector,
    roll_and_pitch,
    wrapped_angle,
)
from carosac_toolkit.base.scaled import resolved
from carosac_toolkit.drivers.plant import Plant, Swivelling
from carosac_toolkit.drivers.sensors import (
    SENSORS,
    DelayLine,
    SensorSettings,
    check_suite,
    quantised,
)
from carosac_toolkit.loop.values import Imu, Measurement, Pose, Stamped, State
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

# Random streams in a fixed order: a new one comes last, so that the others keep their draws.
RANDOM_STREAMS = (
    "encoder_bias", "encoders", "pose", "imu_bias", "imu", "tension_bias", "tension",
    "tension_scale", "swivel_bias", "swivel", "attitude_turns", "attitude", "inclination_turn",
    "inclination",
)  # fmt: skip
_CHANGING = ("encoder_bias", "_tension_bias", "_imu_bias", "_constant", "_reading", "_measured")


class SensorSuite:
    """The sensors of B simulated robots, each with its own rate, delay and random stream.

    Another sensor, or more of its samples, never changes the readings of this one.

    Attributes:
        encoder_bias: Bias of the encoders [m], shape (B, n).
    """

    def __init__(
        self, suite: str, settings: SensorSettings, plant: Plant, seed: int | Sequence[int]
    ) -> None:
        """Draw the biases; nothing is sampled yet.

        Args:
            suite: As `carosac_toolkit.drivers.sensors.check_suite` allows.
            settings: Their numbers; defaults that are left follow from the robot of the plant.
            plant: At rest where it starts, at time 0.
            seed: Of biases and noise: one for all robots together, or one for each, which then has
                the sensors that it would have alone.

        Raises:
            InvalidField: Sensors that the plant cannot have.
        """
        check_sensors(suite, settings, plant)
        self._settings = settings = resolved(settings, Scales(plant.robot).ratios)
        self._size, self._n = plant.size, plant.robot.n
        self._lines = _delay_lines(settings.sensors_of(suite), settings)
        self._rng = _streams(seed, self._size)
        self.encoder_bias, self._tension_bias, self._imu_bias = self._biases()
        self._constant = self._constant_errors()
        self._reading = self._encoded(plant)
        self._measured: Measurement | None = None

    @property
    def next_due(self) -> float:
        """Time at which the next sample of any sensor is due [s]."""
        return min(line.next_due for line in self._lines.values())

    def steps(self, now: float, duration: float) -> Iterator[float]:
        """Split a duration that begins now at the times at which samples are due.

        Advance the plant by each and take the samples before asking for the next one [s].
        """
        end = now + duration
        while now < end - 1e-9:
            step = min(end, self.next_due) - now
            yield step
            now += step

    def sample(self, plant: Plant, now: float) -> None:
        """Take the samples that are due at this time [s]."""
        due = {name for name, line in self._lines.items() if line.due(now)}
        if "encoders" in due:
            self._lines["encoders"].put(now, self._lengths(plant))
        if not due - {"encoders"}:
            return
        state = plant.truth()
        for name in SENSORS:
            if name in due:
                self._lines[name].put(now, self._sampled(name, state, plant))

    def renew(self, rows: NDArray[Any]) -> None:
        """Replace the sensors of some robots by others of the same type: draw new biases.

        Call `restart` before the next sample, once these robots have been set down.
        """
        mine = (self.encoder_bias, self._tension_bias, self._imu_bias, *self._constant.values())
        drawn = (*self._biases(), *self._constant_errors().values())
        for bias, other in zip(mine, drawn, strict=True):
            bias[rows] = other[rows]

    def restart(self, rows: NDArray[Any], plant: Plant, now: float) -> None:
        """Clear the samples of some robots before now: they rest where they were placed.

        Others go on, but all draw noise. The next measurement, at the same time, is for the robots
        that were set down alone: it may have samples for all that the others have had before.
        """
        self._reading[rows] = self._encoded(plant)[rows]
        state, kept = plant.truth(), self._reading
        for name, line in self._lines.items():
            line.overwrite(rows, now, self._sampled(name, state, plant))
        kept[rows] = self._reading[rows]
        self._reading = kept
        self._measured = None

    def newest_lengths(self, now: float) -> Array:
        """Return the newest lengths that have arrived [m], shape (B, n)."""
        return self._lines["encoders"].newest(now)[1][:, : self._n]

    def measure(self, now: float) -> Measurement:
        """Return the newest samples that have arrived; of the IMU all since the last measurement.

        Measuring again at the same time gives the same measurement.
        """
        if self._measured is None or self._measured.time[0] != now:
            self._measured = Measurement(
                time=np.full(self._size, now),
                unstrained_length=self.newest_lengths(now),
                length_rate=self._stamped("encoders", now, self._n),
                tension=self._newest("tension", now),
                swivel_angle=self._newest("swivel", now),
                attitude=self._newest("attitude", now),
                inclination=self._newest("inclination", now),
                pose=self._measured_pose(now) if "pose" in self._lines else None,
                imu=self._measured_imu(now) if "imu" in self._lines else None,
            )
        return self._measured

    def state(self) -> dict[str, Any]:
        """Return everything that changes, as arrays, numbers and values of the loop."""
        values = {name: getattr(self, name) for name in _CHANGING}
        streams = {
            name: [one.bit_generator.state for one in parts] for name, parts in self._rng.items()
        }
        lines = {name: line.state() for name, line in self._lines.items()}
        return copy.deepcopy(values | {"streams": streams, "lines": lines})

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a state of a suite of the same sensors and size."""
        # States of earlier versions have none of these errors.
        state = copy.deepcopy({"_constant": self._constant} | state)
        for name in _CHANGING:
            setattr(self, name, state[name])
        for name in state["streams"]:
            parts = self._rng[name]
            for one, known in zip(parts, state["streams"][name], strict=True):
                one.bit_generator.state = known
        for name, line in self._lines.items():
            line.restore(state["lines"][name])

    def _draw(self, stream: str, count: int) -> Array:
        """Draw standard normal numbers of a stream, shape (B, count)."""
        parts = self._rng[stream]
        rows = self._size // len(parts)
        return np.concatenate([rng.standard_normal((rows, count)) for rng in parts])

    def _biases(self) -> tuple[Array, Array, Array]:
        """Draw biases of encoders [m], (B, n), tension sensors [N], (B, n), and IMU, (B, 6)."""
        sensors = self._settings
        scale = np.repeat([sensors.angular_rate_bias, sensors.specific_force_bias], 3)
        return (
            sensors.encoder_bias * self._draw("encoder_bias", self._n),
            sensors.tension_bias * self._draw("tension_bias", self._n),
            scale * self._draw("imu_bias", 6),
        )

    def _constant_errors(self) -> dict[str, Array]:
        """Draw constant errors of the sensors that are there, by their stream.

        Those are scales of load cells, (B, n), zeros of swivel angles, (B, n) [rad], rotation
        vectors of an AHRS on the platform with its heading, (B, 4) [rad], and of an inclinometer,
        (B, 3) [rad].
        """
        sensors, n = self._settings, self._n
        ahrs = np.append(np.full(3, sensors.attitude_mounting), sensors.attitude_heading)
        sizes = {
            "tension": ("tension_scale", np.full(n, sensors.tension_scale)),
            "swivel": ("swivel_bias", np.full(n, sensors.swivel_bias)),
            "attitude": ("attitude_turns", ahrs),
            "inclination": ("inclination_turn", np.full(3, sensors.inclination_mounting)),
        }
        return {
            stream: size * self._draw(stream, len(size))
            for sensor, (stream, size) in sizes.items()
            if sensor in self._lines
        }

    def _sampled(self, name: str, state: State, plant: Plant) -> Array:
        """Sample a sensor with noise and bias."""
        sample: dict[str, Callable[[], Array]] = {
            "encoders": lambda: self._lengths(plant),
            "pose": lambda: self._pose(state),
            "imu": lambda: self._imu(state, plant),
            "tension": lambda: self._tension(state),
            "swivel": lambda: self._swivel(plant),
            "attitude": lambda: self._attitude(state),
            "inclination": lambda: self._inclination(state),
        }
        return sample[name]()

    def _encoded(self, plant: Plant, noise: Array | float = 0.0) -> Array:
        """Return the encoder readings of the plant [m], shape (B, n)."""
        reading = plant.read_lengths() + self.encoder_bias + noise
        return quantised(reading, self._settings.encoder_resolution)

    def _lengths(self, plant: Plant) -> Array:
        """Return the encoder readings [m], then their rates [m/s], shape (B, 2 n)."""
        sensors = self._settings
        reading = self._encoded(plant, sensors.encoder_noise * self._draw("encoders", self._n))
        # The rate is what two readings say, their noise included.
        rate = (reading - self._reading) * sensors.encoder_rate
        self._reading = reading
        return np.concatenate([reading, rate], axis=1)

    def _pose(self, state: State) -> Array:
        """Return position [m] and rotation of motion capture, shape (B, 12)."""
        from scipy.spatial.transform import Rotation

        sensors = self._settings
        noise = self._draw("pose", 6)
        turn = Rotation.from_rotvec(sensors.rotation_noise * noise[:, :3]).as_matrix()
        position = state.position + sensors.position_noise * noise[:, 3:]
        rotation = (turn @ state.rotation).reshape(self._size, 9)
        return np.concatenate([position, rotation], axis=1)

    def _imu(self, state: State, plant: Plant) -> Array:
        """Return angular rate [rad/s], specific force [m/s^2] at the origin, in P, (B, 6)."""
        if state.twist is None:
            raise CarosacError("sensors: an inertial plant must provide its twist")
        sensors = self._settings
        scale = np.repeat([sensors.angular_rate_noise, sensors.specific_force_noise], 3)
        force = plant.acceleration()[:, :3] + np.array([0.0, 0.0, plant.robot.gravity])
        in_world = np.stack([state.twist[:, 3:], force], axis=1)  # (B, 2, 3)
        true = (in_world @ state.rotation).reshape(self._size, 6)  # R^T of each row
        return true + self._imu_bias + scale * self._draw("imu", 6)

    def _tension(self, state: State) -> Array:
        """Return tensions at the platform [N], shape (B, n)."""
        if state.tension is None:
            raise InvalidField("tension", "True", "False: this plant has no tensions")
        noise = self._settings.tension_noise * self._draw("tension", self._n)
        true = state.tension * (1.0 + self._constant["tension_scale"])
        return true + self._tension_bias + noise

    def _swivel(self, plant: Plant) -> Array:
        """Return the angles of the pulleys about their swivel axes [rad], shape (B, n)."""
        assert isinstance(plant, Swivelling)
        noise = self._settings.swivel_noise * self._draw("swivel", self._n)
        off = (self._constant["swivel_bias"] + noise) * (plant.robot.pulley_radius > 0.0)
        return wrapped_angle(plant.swivel_angles() + off)

    def _attitude(self, state: State) -> Array:
        """Return quaternions from the frame of an AHRS to its level frame, shape (B, 4)."""
        mounting, heading = np.split(self._constant["attitude_turns"], [3], axis=1)
        about = from_rotation_vector(heading * np.array([0.0, 0.0, 1.0]))
        noise = from_rotation_vector(self._settings.attitude_noise * self._draw("attitude", 3))
        return from_matrix(about @ state.rotation @ from_rotation_vector(mounting) @ noise)

    def _inclination(self, state: State) -> Array:
        """Return roll and pitch of an inclinometer [rad], shape (B, 2)."""
        mounting = from_rotation_vector(self._constant["inclination_turn"])
        noise = self._settings.inclination_noise * self._draw("inclination", 2)
        return wrapped_angle(roll_and_pitch(state.rotation @ mounting) + noise)

    def _stamped(self, sensor: str, now: float, first: int = 0) -> Stamped:
        """Return the newest sample of a sensor from a column on."""
        taken_at, packed = self._lines[sensor].newest(now)
        return Stamped(time=np.full(self._size, taken_at), value=packed[:, first:])

    def _newest(self, sensor: str, now: float) -> Stamped | None:
        """Return the newest sample of a sensor; None where it is not there."""
        return self._stamped(sensor, now) if sensor in self._lines else None

    def _measured_pose(self, now: float) -> Pose:
        """Return the newest pose that has arrived."""
        taken_at, packed = self._lines["pose"].newest(now)
        return Pose(
            position=packed[:, :3],
            rotation=packed[:, 3:].reshape(self._size, 3, 3),
            time=np.full(self._size, taken_at),
        )

    def _measured_imu(self, now: float) -> Imu | None:
        """Return the inertial samples since the last measurement, or None."""
        arrived = self._lines["imu"].arrived(now)
        if not arrived:
            return None
        samples = np.stack([packed for _, packed in arrived], axis=1)  # (B, K, 6)
        time = np.tile([taken_at for taken_at, _ in arrived], (self._size, 1))
        return Imu(time=time, angular_rate=samples[..., :3], specific_force=samples[..., 3:])


def _streams(seed: int | Sequence[int], size: int) -> dict[str, list[np.random.Generator]]:
    """Return the generators of each stream: one for all robots, or one for each."""
    seeds = [seed] if isinstance(seed, int | np.integer) else list(seed)
    if len(seeds) not in (1, size):
        raise InvalidField("seed", f"{len(seeds)} seeds", f"one, or {size}: one for each robot")
    streams = zip(
        *(np.random.SeedSequence(one).spawn(len(RANDOM_STREAMS)) for one in seeds), strict=True
    )
    return {
        name: [np.random.default_rng(part) for part in parts]
        for name, parts in zip(RANDOM_STREAMS, streams, strict=True)
    }


def _delay_lines(sensors: Sequence[str], settings: SensorSettings) -> Mapping[str, DelayLine]:
    """Return the encoders and other sensors by name, always in the same order."""
    lines = {"encoders": DelayLine(settings.encoder_rate, settings.encoder_delay)}
    for name in sensors:
        rate, delay = getattr(settings, f"{name}_rate"), getattr(settings, f"{name}_delay")
        lines[name] = DelayLine(rate, delay)
    return lines


def check_pulleys(robot: Robot, field: str, value: str, without: str) -> None:
    """Refuse swivel encoders on a robot without pulleys; `without` is what it may have instead.

    Raises:
        InvalidField: Names the field and its value.
    """
    if not (robot.pulley_radius > 0.0).any():
        raise InvalidField(field, value, f"{without}: robot {robot.name!r} has no pulleys")


def check_sensors(suite: str, settings: SensorSettings, plant: Plant) -> None:
    """Refuse sensors that a plant cannot have.

    Raises:
        InvalidField: An unknown suite, an IMU on a plant without inertia, or swivel encoders where
            no pulley swivels.
    """
    check_suite(suite, inertial=plant.inertial)
    if "swivel" not in settings.sensors_of(suite):
        return
    named = "swivel" in suite.split("+")
    field, value = ("suite", repr(suite)) if named else ("sensors.swivel", "True")
    without = "one without swivel" if named else "False"
    check_pulleys(plant.robot, field, value, without)
    if not isinstance(plant, Swivelling):
        raise InvalidField(field, value, f"{without}: this plant has no swivel angles")
