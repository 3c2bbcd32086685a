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

COMMAND_JERK_MAX = 200.0  # [m/s^3]; beyond it commands are counted and obeyed all the same
FIRST_STEP_MAX_M = 0.03  # distance of the first command from where the winch stands
FOLLOWING_ERROR_MAX_M = 0.25  # the way of a fast winch, 2.5 m/s, in 0.1 s


@dataclass(frozen=True, kw_only=True)
class EmulatorSettings:
    """Settings of the emulated PLC and of the machine behind it.

    Attributes:
        plant: Driver whose plant is the machine, by the name of its entry point.
        cables: Cable model of the driver `simulator`.
        cycle: Period of the PLC [s].
        watchdog: Silence of the host after which the winches ramp to rest [s].
        encoder_check: Whether a position that jumps is a fault of the PLC.
        has_tension: Whether the tensions are measured.
        shift: Standard deviation of the offset of the encoders after power-on [m].
        start_position: Platform origin at power-on in W [m]; None is the home position.
        sensors: Noise of encoders, load cells and IMU; they are sampled once a PLC cycle.
        wrong_sign: Cables, from 0, whose encoder and drive turn opposite to the robot file.
        reversed_drive: Cables, from 0, whose drive alone does.
        wind_force: Standard deviation of the wind on the platform per horizontal axis [N].
    """

    plant: str = "simulator"
    cables: str = "catenary"
    cycle: float = 0.005
    watchdog: float = 0.1
    encoder_check: bool = True
    has_tension: bool = True
    shift: float = 0.0
    start_position: tuple[float, float, float] | None = None
    sensors: SensorSettings = field(default_factory=lambda: SensorSettings(encoder_bias=0.0))
    wrong_sign: tuple[int, ...] = ()
    reversed_drive: tuple[int, ...] = ()
    wind_force: float = 0.0

    def __post_init__(self) -> None:
        """Refuse values that no PLC can have."""
        check_fields(self, positive=("cycle", "watchdog"), not_negative=("shift", "wind_force"))
        if self.watchdog < 2.0 * self.cycle:
            raise InvalidField(
                "watchdog", f"{self.watchdog} s", f">= {2.0 * self.cycle} s, 2 cycles"
            )


def winch_limits(robot: Robot, hardware: Hardware) -> WinchLimits:
    """Return the limits of a robot in the units of its PLC."""
    scale = np.array(hardware.scale)
    ends = np.stack([hardware.number(robot.length_min), hardware.number(robot.length_max)])
    n = robot.n
    return WinchLimits(
        length_min=ends.min(axis=0),
        length_max=ends.max(axis=0),
        speed=robot.speed_max / scale,
        acceleration=robot.acceleration_max / scale,
        jerk=np.full(n, COMMAND_JERK_MAX) / scale,
        step=np.full(n, FIRST_STEP_MAX_M) / scale,
        following=np.full(n, FOLLOWING_ERROR_MAX_M) / scale,
    )
