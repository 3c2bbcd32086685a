"""Settings of the emulated PLC."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.numbers import check_fields
from carosac_toolkit.drivers.sensors import SensorSettings
from carosac_toolkit.plc.emulator.winches import WinchLimits
from carosac_toolkit.robot.hardware import Hardware
from carosac_toolkit.robot.robot import Robot


@dataclass(frozen=True, kw_only=True)
class PlcSettings:
    """The PLC and the machine behind it.

    Attributes:
        plant: Driver whose plant is the machine; a name of the registry.
        cables: How its cables are simulated, for the driver `simulator`.
        cycle: Of the PLC [s].
        watchdog: Silence of the host after which the winches ramp to rest [s].
        jerk_max: Of commands, counted only [m/s^3].
        step_max: Largest distance of a first command from where a winch stands [m].
        following_max: Largest distance of a winch from its set position [m].
        encoder_check: Whether a position that jumps is a fault of the PLC.
        has_tension: Whether there are load cells.
        shift: Standard deviation of what the encoders say too much after power-on [m].
        start_position: Platform origin at power-on in W [m]; None is the home position.
        sensors: Noise of encoders, load cells and IMU; their rates are those of the PLC.
        wrong_sign: Cables, from 0, whose encoder and drive are wired the other way than the robot
            file says.
        reversed_drive: Cables, from 0, whose drive alone is.
        wind_force: Standard deviation of the wind on the platform per horizontal axis [N].
    """

    plant: str = "simulator"
    cables: str = "catenary"
    cycle: float = 0.005
    watchdog: float = 0.1
    jerk_max: float = 200.0
    step_max: float = 0.03
    following_max: float = 0.25
    encoder_check: bool = True
    has_tension: bool = True
    shift: float = 0.0
    start_position: tuple[float, float, float] | None = None
    sensors: SensorSettings = field(default_factory=lambda: SensorSettings(encoder_bias=0.0))
    wrong_sign: tuple[int, ...] = ()
    reversed_drive: tuple[int, ...] = ()
    wind_force: float = 0.0

    def __post_init__(self) -> None:
        """Refuse numbers that no PLC has."""
        check_fields(
            self,
            positive=("cycle", "watchdog", "jerk_max", "step_max", "following_max"),
            not_negative=("shift", "wind_force"),
        )
        if self.watchdog < 2.0 * self.cycle:
            raise InvalidField(
                "watchdog", f"{self.watchdog} s", f">= {2.0 * self.cycle} s, 2 cycles"
            )


def limits_of(robot: Robot, hardware: Hardware, settings: PlcSettings) -> WinchLimits:
    """Limits of a robot in the units of its PLC, as the PLC keeps them."""
    scale = np.array(hardware.scale)
    ends = np.stack([hardware.number(robot.length_min), hardware.number(robot.length_max)])
    n = robot.n
    return WinchLimits(
        length_min=ends.min(axis=0),
        length_max=ends.max(axis=0),
        speed=robot.speed_max / scale,
        acceleration=robot.acceleration_max / scale,
        jerk=np.full(n, settings.jerk_max) / scale,
        step=np.full(n, settings.step_max) / scale,
        following=np.full(n, settings.following_max) / scale,
    )
