"""Settings of the driver of a robot behind a TwinCAT PLC."""

from __future__ import annotations

from dataclasses import dataclass, field

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.numbers import check_fields, check_positive
from carosac_toolkit.safety.limiter import LimitSettings

Point = tuple[float, float, float]

PLANT = 0.1  # [s] of silence in which full speed is 25 cm: what a network of its own never needs
DESK = 0.5  # [s]; PLC and host beside other programs on two cores: 0.19 s in 30 s, 0.25 s in 600 s
_SUITES = ("lengths", "lengths+imu")


@dataclass(frozen=True, kw_only=True)
class AdsSettings:
    """Settings of `AdsDriver`; where the PLC is stands in the robot file, section ``hardware``.

    Attributes:
        ip: Address of the PLC, such as 127.0.0.1 for an emulated one; its AMS net id is then the
            same with .1.1. None: as the robot file says.
        motion: Whether anything may be written to the PLC; without it the driver only reads.
        period: Time between two commands [s].
        io_period: Time between two exchanges of data [s]; a new command is sent at once.
        timeout: After which a call is given up [s]; None: as the robot file says.
        lost_after: Silence of the PLC after which the connection counts as lost, and standstill of
            its heartbeat or clock after which its data are stale [s]. None: `PLANT` for a PLC, and
            `DESK` for an emulated one, which shares a machine with its host and is kept waiting.
        suite: ``lengths``, or ``lengths+imu`` where the robot file names an IMU.
        start_position: Where an emulated PLC sets its robot down at `connect`, in W [m]; no real
            one is moved. None: it stays where it is.
        limits: Of the commands.
    """

    ip: str | None = None
    motion: bool = False
    period: float = 0.01
    io_period: float = 0.005
    timeout: float | None = None
    lost_after: float | None = None
    suite: str = "lengths"
    start_position: Point | None = None
    limits: LimitSettings = field(default_factory=lambda: LimitSettings(box=False))

    def __post_init__(self) -> None:
        """Refuse a switch that is none, times that are not positive, an unknown suite."""
        if not isinstance(self.motion, bool):
            raise InvalidField("motion", repr(self.motion), "True or False")
        check_fields(self, positive=("period", "io_period"))
        for name in ("timeout", "lost_after"):
            if getattr(self, name) is not None:
                check_positive(name, getattr(self, name), "s")
        if self.suite not in _SUITES:
            allowed = f"one of {list(_SUITES)}; the PLC measures no poses"
            raise InvalidField("suite", repr(self.suite), allowed)
