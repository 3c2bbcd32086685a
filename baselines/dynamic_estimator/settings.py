"""Settings of the dynamic estimator: the uncertainty of everything it assumes."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any

from carosac_toolkit.base.arrays import frozen_array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.numbers import check_fields, check_not_negative, check_positive
from carosac_toolkit.base.scaled import Scaled, resolved
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

Mount = tuple[float, float, float]
# Of air that by the drag of ``carosac`` pushes it with its `wind_force`.
AIR_SPEED = Scaled(10.0, "m/s")


@dataclass(frozen=True, kw_only=True)
class DynamicEstimatorSettings:
    """Settings of `DynamicEstimator`; one standard deviation where something is random.

    The defaults are those of the condition ``nominal-1`` and its sensors, for the robot
    ``carosac``. Those of the IMU are the same for every robot. Noise and bias of encoders, load
    cells and poses are as in `SensorSettings`: smaller on smaller robots, not larger on larger
    ones. All others that have a unit scale with the robot. 0 takes a quantity as known.

    A robot that was identified says how far its model is off (`Robot.model_error`): this takes the
    place of the defaults of `mass`, `exit_error`, `wind_force`, `acceleration_noise`,
    `position_noise` and `rotation_noise`, and what was identified with it counts as known:
    `center_of_mass`, `encoder_bias` and `length_bias_walk` are 0 by default.

    Attributes:
        mass: Logarithm of the platform's mass over that of the robot file.
        center_of_mass: Per axis [m].
        encoder_bias: What an encoder says too much at the start, per cable [m].
        exit_error: Errors of exit points, along the cable [m].
        length_bias: What a length reading says too much at the start, per cable [m]; None: what
            `encoder_bias` and `exit_error` come to together.
        length_bias_walk: By how much that changes, where the platform moves through the workspace
            and exit points are wrong across the cable too [m/sqrt(s)].
        encoder_noise: Of the readings [m].
        stretch_vibration: Vibrations of the stretch, which the model does not follow [m].
        stretch_noise: Of the lengths between readings and platform [m]; None: what `encoder_noise`
            and `stretch_vibration` come to together.
        rate_noise: Of the rates of these lengths, in the twist of the belief [m/s].
        wind_force: Force of the wind on the platform per horizontal axis, and of all else that
            pushes it and that the model does not know: three times the wind alone, so that sway
            that such a push begins is seen soon [N]. By default it scales with the robot, and is
            no less than the push of air at `AIR_SPEED` by the drag of the robot file: air pushes
            a light platform no less than a heavy one of its shape.
        wind_time: Its correlation time [s].
        start_speed: Speed at the start: each mode has the energy of the platform at it [m/s].
        acceleration_noise: Density of accelerations that the model does not know, along the ways
            to sway [m/s^2/sqrt(Hz)].
        soft_acceleration_noise: The same along the ways to sway on cables that give way, while an
            IMU feels how their waves move the platform, which the model has not [m/s^2/sqrt(Hz)].
        stretch_damping: Time constant by which the stretch of the cables is damped in the model,
            beyond the damping of the robot [s].
        tension_noise: Of the tensions that the model predicts, over the weight of the platform: how
            little the accelerometer says along the cables.
        vibration: Of the specific force, which the model does not know [m/s^2].
        angular_vibration: Of the angular rate, which the model does not know [rad/s].
        angular_rate_noise: Of each IMU sample [rad/s].
        angular_rate_bias: Constant [rad/s].
        specific_force_noise: Of each IMU sample [m/s^2].
        specific_force_bias: Constant [m/s^2].
        imu_position: Where the IMU is, in P [m].
        imu_rotation: Rotation vector from the axes of the IMU to P [rad].
        load_cells: Whether measured tensions correct the filter, where there are any; in a study,
            on suites with ``tension``.
        load_cell_noise: Of each sample of a load cell [N].
        load_cell_bias: Constant, per cable [N].
        tension_vibration: Of the tensions, by vibrations of the stretch, which the model does not
            know; over the weight of the platform.
        swivels: Whether measured swivel angles correct the filter, where there are any; in a study,
            on suites with ``swivel``.
        swivel_noise: Of each swivel angle, swings of the cable included [rad].
        swivel_offset: Constant error of their zeros, per pulley [rad]; None: nothing is known of
            them before the first reading.
        attitude_rotation: Rotation vector from the axes of an AHRS or an inclinometer to P [rad],
            which corrects the filter then, where there is one; None: neither is used. In a study,
            on suites with ``attitude`` or ``inclination``, it is that of the simulation. Of both
            the AHRS counts.
        attitude_mounting: Error of that, constant, per axis [rad].
        attitude_noise: Of each of its readings, per axis [rad]. One that takes the specific force
            for gravity errs by the acceleration of the platform over gravity, in radians.
        attitude_heading: Of the level frame of an AHRS in W [rad]; the default knows nothing of it.
        attitude_heading_walk: By how much that changes [rad/sqrt(s)].
        position_noise: Of measured poses, per axis [m].
        rotation_noise: Of measured poses, per axis [rad].
        gate: Normalised innovation squared, over its degrees of freedom, beyond which a
            measurement counts as disturbed: its noise is then taken as so large that it is just
            within.
        reading_jump: Distance from what the last readings led to expect, beyond what a winch can
            do, from which a length reading is taken as an outlier, or its encoder to have slipped
            where it stays there [m].
        delay: By how much lengths lead poses [s]; None: what the robot says,
            `Robot.length_delay`.
        time_step: Longest time step of the dynamics [s].
        gap_max: Time between two measurements beyond which the platform is hung anew [s].
    """

    mass: float = Scaled(0.03, "1")
    center_of_mass: float = Scaled(0.01, "m")
    encoder_bias: float = Scaled(5e-3, "m", most=5e-3)
    exit_error: float = Scaled(4.898979485566357e-3, "m")  # 7 mm with the bias
    length_bias: float | None = None
    length_bias_walk: float = Scaled(1e-3, "m/sqrt(s)")
    encoder_noise: float = Scaled(0.2e-3, "m", most=0.2e-3)
    stretch_vibration: float = Scaled(5.656854249492379e-4, "m")  # 0.6 mm with the noise
    stretch_noise: float | None = None
    rate_noise: float = Scaled(0.02, "m/s")
    wind_force: float = Scaled(3.0, "N")
    wind_time: float = Scaled(2.0, "s")
    start_speed: float = Scaled(0.02, "m/s")
    acceleration_noise: float = Scaled(0.005, "m/s/sqrt(s)")
    soft_acceleration_noise: float = Scaled(0.2, "m/s/sqrt(s)")
    stretch_damping: float = Scaled(0.01, "s")
    tension_noise: float = 0.4
    vibration: float = Scaled(0.2, "m/s^2")
    angular_vibration: float = Scaled(0.02, "rad/s")
    angular_rate_noise: float = 3.5e-3
    angular_rate_bias: float = 5e-3
    specific_force_noise: float = 0.017
    specific_force_bias: float = 0.05
    imu_position: Mount = (0.0, 0.0, 0.0)
    imu_rotation: Mount = (0.0, 0.0, 0.0)
    load_cells: bool = False
    load_cell_noise: float = Scaled(0.5, "N", most=0.5)
    load_cell_bias: float = Scaled(1.0, "N", most=1.0)
    tension_vibration: float = 0.05
    swivels: bool = False
    swivel_noise: float = 3.5e-3
    swivel_offset: float | None = None
    attitude_rotation: Mount | None = None
    attitude_mounting: float = math.radians(2.0)
    attitude_noise: float = 5e-3
    attitude_heading: float = math.pi
    attitude_heading_walk: float = 2e-3
    position_noise: float = Scaled(1e-3, "m", most=1e-3)
    rotation_noise: float = Scaled(0.5e-3, "rad")
    gate: float = 6.0
    reading_jump: float = Scaled(0.05, "m")
    delay: float | None = None
    time_step: float = Scaled(0.01, "s")
    gap_max: float = Scaled(60.0, "s")

    def __post_init__(self) -> None:
        """Refuse numbers that make no sense."""
        for name in _MOUNT_FIELDS:
            if name != "attitude_rotation" or self.attitude_rotation is not None:
                frozen_array(name, getattr(self, name), (3,))
        if self.swivel_offset is not None:
            check_not_negative("swivel_offset", self.swivel_offset, "rad")
        for name in _SENSOR_FIELDS:
            if not isinstance(getattr(self, name), bool):
                raise InvalidField(name, repr(getattr(self, name)), "True or False")
        if self.delay is not None:
            check_not_negative("delay", self.delay, "s")
        if self.length_bias is not None:
            check_not_negative("length_bias", self.length_bias)
        if self.stretch_noise is not None:
            check_positive("stretch_noise", self.stretch_noise)
        apart = (*_POSITIVE_FIELDS, *_MOUNT_FIELDS, *_OPTIONAL_FIELDS, *_SENSOR_FIELDS)
        others = [item.name for item in fields(self) if item.name not in apart]
        check_fields(self, positive=_POSITIVE_FIELDS, not_negative=others)

    @property
    def bias_deviation(self) -> float:
        """What a length reading says too much at the start, one standard deviation [m]."""
        if self.length_bias is not None:
            return self.length_bias
        return math.hypot(self.encoder_bias, self.exit_error)

    @property
    def stretch_deviation(self) -> float:
        """Noise of the lengths between readings and platform, one standard deviation [m]."""
        if self.stretch_noise is not None:
            return self.stretch_noise
        return math.hypot(self.encoder_noise, self.stretch_vibration)


def informed(
    robot: Robot, settings: DynamicEstimatorSettings, *, open_loop: bool = True
) -> DynamicEstimatorSettings:
    """Return settings with what a recording told of a robot in place of defaults.

    Args:
        robot: The robot.
        settings: With defaults that are still `Scaled`.
        open_loop: Take errors of lengths and body too; False: measured poses will tell them better.
    """
    error = robot.model_error
    if error is None:
        return settings
    told: dict[str, Any] = {
        "exit_error": error.length,
        "wind_force": error.force,
        "mass": error.mass,
        "acceleration_noise": error.acceleration,
        "position_noise": error.position,
        "rotation_noise": error.rotation,
        **dict.fromkeys(("center_of_mass", "encoder_bias", "length_bias_walk"), 0.0),
    }
    if not open_loop:
        for name in ("mass", "center_of_mass", "exit_error", "encoder_bias", "length_bias_walk"):
            del told[name]
    left = {k: value for k, value in told.items() if isinstance(getattr(settings, k), Scaled)}
    return replace(settings, **left)


def settings_for(robot: Robot, settings: DynamicEstimatorSettings) -> DynamicEstimatorSettings:
    """Return settings with the defaults of a robot in place of those of ``carosac``."""
    told, ratios = informed(robot, settings), Scales(robot).ratios
    here = resolved(told, ratios)
    if isinstance(told.wind_force, Scaled):
        here = replace(here, wind_force=max(here.wind_force, robot.drag * AIR_SPEED.of(ratios)))
    swivels = here.swivels and bool((robot.pulley_radius > 0.0).any())
    return replace(
        here, length_bias=here.bias_deviation, stretch_noise=here.stretch_deviation, swivels=swivels
    )


_OPTIONAL_FIELDS = ("length_bias", "stretch_noise", "delay", "swivel_offset")
_SENSOR_FIELDS = ("load_cells", "swivels")
_MOUNT_FIELDS = ("imu_position", "imu_rotation", "attitude_rotation")
_POSITIVE_FIELDS = (
    "stretch_vibration", "load_cell_noise", "swivel_noise", "attitude_noise", "wind_time",
    "start_speed", "angular_rate_noise", "specific_force_noise", "position_noise", "rotation_noise",
    "rate_noise", "gate", "reading_jump", "time_step", "gap_max",
)  # fmt: skip
