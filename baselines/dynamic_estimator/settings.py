"""Settings of the dynamic estimator: the uncertainty of everything it assumes."""

from __future__ import annotations

from dataclasses import dataclass, fields

from carosac_toolkit.base.arrays import frozen_array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.numbers import check_fields, check_not_negative

Mount = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class DynamicEstimatorSettings:
    """Settings of `DynamicEstimator`; one standard deviation where something is random.

    The defaults are those of the condition ``nominal-1`` and its sensors. 0 takes a quantity as
    known.

    Attributes:
        mass: Logarithm of the platform's mass over that of the robot file.
        center_of_mass: Per axis [m].
        length_bias: What a length reading says too much at the start, per cable: encoder bias,
            and errors of exit points along the cable [m].
        length_bias_walk: By how much that changes, where the platform moves through the workspace
            and exit points are wrong across the cable too [m/sqrt(s)].
        stretch_noise: Of the lengths between readings and platform: noise of the readings, and
            vibrations of the stretch, which the model does not follow [m].
        rate_noise: Of the rates of these lengths, in the twist of the belief [m/s].
        wind_force: Force of the wind on the platform per horizontal axis, and of all else that
            pushes it and that the model does not know: three times the wind alone, so that sway
            that such a push begins is seen soon [N].
        wind_time: Its correlation time [s].
        start_speed: Speed at the start: each mode has the energy of the platform at it [m/s].
        acceleration_noise: Density of accelerations that the model does not know, along the ways
            to sway [m/s^2/sqrt(Hz)].
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
        load_cells: Whether measured tensions correct the filter, where there are any.
        load_cell_noise: Of each sample of a load cell [N].
        load_cell_bias: Constant, per cable [N].
        tension_vibration: Of the tensions, by vibrations of the stretch, which the model does not
            know; over the weight of the platform.
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

    mass: float = 0.03
    center_of_mass: float = 0.01
    length_bias: float = 7e-3
    length_bias_walk: float = 1e-3
    stretch_noise: float = 0.6e-3
    rate_noise: float = 0.02
    wind_force: float = 3.0
    wind_time: float = 2.0
    start_speed: float = 0.02
    acceleration_noise: float = 0.005
    stretch_damping: float = 0.04
    tension_noise: float = 0.4
    vibration: float = 0.2
    angular_vibration: float = 0.02
    angular_rate_noise: float = 3.5e-3
    angular_rate_bias: float = 5e-3
    specific_force_noise: float = 0.017
    specific_force_bias: float = 0.05
    imu_position: Mount = (0.0, 0.0, 0.0)
    imu_rotation: Mount = (0.0, 0.0, 0.0)
    load_cells: bool = False
    load_cell_noise: float = 0.5
    load_cell_bias: float = 1.0
    tension_vibration: float = 0.05
    position_noise: float = 1e-3
    rotation_noise: float = 0.5e-3
    gate: float = 6.0
    reading_jump: float = 0.05
    delay: float | None = None
    time_step: float = 0.01
    gap_max: float = 60.0

    def __post_init__(self) -> None:
        """Refuse numbers that make no sense."""
        for name in _MOUNT_FIELDS:
            frozen_array(name, getattr(self, name), (3,))
        if not isinstance(self.load_cells, bool):
            raise InvalidField("load_cells", repr(self.load_cells), "True or False")
        if self.delay is not None:
            check_not_negative("delay", self.delay, "s")
        apart = (*_POSITIVE_FIELDS, *_MOUNT_FIELDS, "delay", "load_cells")
        others = [item.name for item in fields(self) if item.name not in apart]
        check_fields(self, positive=_POSITIVE_FIELDS, not_negative=others)


_MOUNT_FIELDS = ("imu_position", "imu_rotation")
_POSITIVE_FIELDS = (
    "stretch_noise", "load_cell_noise", "wind_time", "start_speed", "angular_rate_noise",
    "specific_force_noise", "position_noise", "rotation_noise", "rate_noise", "gate",
    "reading_jump", "time_step", "gap_max",
)  # fmt: skip
