"""Settings of the driver of a robot behind a PLC."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.numbers import check_fields, check_positive
from carosac_toolkit.safety.limiter import LimitSettings

Point = tuple[float, float, float]

SILENCE_MAX_S = 0.1  # a winch at 2.5 m/s pays out 25 cm in it; a network of its own never needs it
EMULATED_SILENCE_MAX_S = 0.5  # PLC and host beside other programs on two cores: 0.25 s in 600 s
COMMAND_PERIOD_MAX_S = 0.1  # of the PLC: commands that stop coming are followed on for 3 periods
_SENSOR_SUITES = ("lengths", "lengths+imu", "lengths+tension", "lengths+imu+tension")


@dataclass(frozen=True, kw_only=True)
class PlcDriverSettings:
    """Settings of `PlcDriver`; the place of the PLC is in the robot file, section ``hardware``.

    Attributes:
        link: Wire to the PLC: an entry point in ``carosac.links``, or ``module:Class``.
        link_settings: Settings of the link by name, beside `ip` and `timeout`.
        ip: Address of the PLC, such as 127.0.0.1 for an emulated one; over ADS the AMS net id is
            then the same with .1.1. None: as in the robot file.
        motion: Whether anything may be written to the PLC; without it the driver only reads.
        period: Time between two commands [s].
        io_period: Time between two exchanges of data [s]; a new command is sent at once.
        timeout: Time after which a call of the link gives up [s]. None: as in the robot file.
        lost_after: Silence of the PLC after which the connection counts as lost, and standstill of
            its heartbeat or clock after which its data are stale [s]. None: `SILENCE_MAX_S`, and
            `EMULATED_SILENCE_MAX_S` for an emulated PLC, which has to wait for processor time.
        imu_lost_after: Silence of the IMU after which its data are stale, where `suite` asks for it
            [s]; an estimator that goes on without it would be wrong unnoticed.
        suite: ``lengths``, or ``lengths+imu`` if the robot file names an IMU.
        start_position: Where an emulated PLC sets its robot down at `connect`, in W [m]; a real
            robot does not move. None: it stays where it is.
        set_down: Whether a guard that connects to move an emulated PLC clears its fault and sets
            its robot down where it homes, as for each case of a study. A real one cannot: its
            platform has to be there, and people look at its faults.
        limits: Limits of the commands.
    """

    link: str = "ads"
    link_settings: Mapping[str, Any] = field(default_factory=dict)
    ip: str | None = None
    motion: bool = False
    period: float = 0.01
    io_period: float = 0.005
    timeout: float | None = None
    lost_after: float | None = None
    imu_lost_after: float = 0.5
    suite: str = "lengths"
    start_position: Point | None = None
    set_down: bool = False
    limits: LimitSettings = field(default_factory=lambda: LimitSettings(box=False))

    def __post_init__(self) -> None:
        """Refuse a `motion` that is no bool, times that are not positive, an unknown suite."""
        if not isinstance(self.motion, bool):
            raise InvalidField("motion", repr(self.motion), "True or False")
        if not isinstance(self.link_settings, Mapping):
            allowed = 'settings of the link by name, such as {"port": 48901}'
            raise InvalidField("link_settings", repr(self.link_settings), allowed)
        check_fields(self, positive=("period", "io_period", "imu_lost_after"))
        if self.period > COMMAND_PERIOD_MAX_S:
            raise InvalidField(
                "period", f"{self.period} s", f"<= {COMMAND_PERIOD_MAX_S} s, the limit of the PLC"
            )
        for name in ("timeout", "lost_after"):
            if getattr(self, name) is not None:
                check_positive(name, getattr(self, name), "s")
        if self.suite not in _SENSOR_SUITES:
            allowed = f"one of {list(_SENSOR_SUITES)}; the PLC measures no poses"
            raise InvalidField("suite", repr(self.suite), allowed)

    @property
    def for_link(self) -> dict[str, Any]:
        """Settings of the link that differ from its defaults."""
        shared = {"ip": self.ip, "timeout": self.timeout}
        return {k: v for k, v in shared.items() if v is not None} | dict(self.link_settings)
