"""Settings of the simulated cables, which the driver and the estimator share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, get_args

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.numbers import check_not_negative, check_positive, check_whole
from sim_warp.simulator import SEGMENTS_MAX, Cables


@dataclass(frozen=True, kw_only=True)
class CableOptions:
    """Options of a `Simulator` in the settings of those who run one.

    Attributes:
        cables: Model of the cables: ``particles``, ``catenary``, ``straight`` or ``xpbd``.
        segments: Number per cable, for ``particles`` and ``xpbd``: more are more accurate and cost
            time in proportion.
        time_step: Longest time step [s]; None takes a default.
        cable_drag: Air drag of the cables per mass [1/s]; ``straight`` ones have no mass. None:
            that of the robot, or, where it is unknown, 0.5 on ``carosac``, scaled to its size.
        device: Warp device, such as ``cpu`` or ``cuda``.
    """

    cables: Cables = "particles"
    segments: int = 16
    time_step: float | None = None
    cable_drag: float | None = None
    device: str = "cpu"

    def __post_init__(self) -> None:
        """Refuse what every simulator would refuse, before there is a robot."""
        if self.cables not in get_args(Cables):
            raise InvalidField("cables", repr(self.cables), f"one of {list(get_args(Cables))}")
        check_whole("segments", self.segments, 2, SEGMENTS_MAX)
        if self.time_step is not None:
            check_positive("time_step", self.time_step, "s")
        if self.cable_drag is not None:
            check_not_negative("cable_drag", self.cable_drag, "1/s")

    @property
    def simulator_options(self) -> dict[str, Any]:
        """Return these settings as keyword arguments of `Simulator`."""
        return {name: getattr(self, name) for name in CableOptions.__dataclass_fields__}
