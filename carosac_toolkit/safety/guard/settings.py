"""Settings of the guard: limits of every check, and which driver stands behind it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.numbers import check_positive, check_whole
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.safety.guard.home_check import SenseErrors
from carosac_toolkit.safety.limiter import LimitSettings

DELAY_S = 0.05  # of network, sampling, and a period, beside the lag of the winches
UNITS_OF_FIELDS = {
    "m": (
        "first_max", "range_margin", "jump_max", "following_max", "direction_max", "closure_max",
        "belief_max", "workspace_margin", "home_change_max", "step_max", "first_way",
    ),
    "s": ("period", "hang_time", "slack_time", "record_lag", "stale_time"),
    "m/s": ("speed_max", "first_speed"),
    "": ("tension_shift_max", "first_shift_max"),
}  # fmt: skip
NONE_ALLOWED = ("step_max", "speed_max", "stale_time", "tension_shift_max", "first_shift_max")
Point = tuple[float, float, float]
SCENE_SETTINGS = ("set_down", "wind_force", "wind_time")  # of a study's case, for a simulation


@dataclass(frozen=True, kw_only=True)
class GuardSettings:
    """Settings of `carosac_toolkit.safety.guard.guard.GuardedDriver`.

    Distances, speeds and times that are `Scaled` are those of the robot ``carosac``; the guard
    takes them by the size of its robot. Numbers that are given stay.

    Attributes:
        driver: Name of the driver behind the guard, or ``module:Class``.
        inner: Settings of that driver by name, a mapping for each settings dataclass inside them.
        scene: Settings of a simulation by name, such as ``wind_force``; the driver behind gets
            those that it has. A study says here what its case asks for.
        period: Time between two commands [s].
        suite: Sensor suite of a driver that has a choice.
        start_position: Position by which `enable_at_once` homes, and where a simulated robot
            starts, in W [m]; None is the home position. A PLC is not told of it.
        motion: Whether anything may move; else a run is dry: commands are limited and journaled,
            and not sent.
        enable_at_once: Whether `connect` homes and enables, where motion is allowed; else `home`
            and `enable` are called.
        reset_at_once: Whether `connect` clears a fault that the driver behind holds from an earlier
            run, where motion is allowed; a fault whose cause remains stays.
        rehearse: Whether a dry run homes at `start_position` in `connect` too, and refuses what
            `enable` would; offsets are numbers of this host, and no drive hears of it.
        home_anew: Whether `enable_at_once` may change offsets by more than `home_change_max`.
        home_confirmed: Whether a person vouches for the pose by which `enable_at_once` homes anew,
            where load cells, IMU and pose measurement would not notice a wrong one.
        senses: Errors of those and of a home that is right; they decide what is noticed.
        real_time: Whether the driver's time is wall-clock time; a simulator then waits for it.
            None: True for drivers that have no such setting, which are real, else False.
        limits: Limits of the commands; the box is judged by the pose instead (`workspace_margin`).
        first_max: Largest distance of the first command from where the winches stand [m].
        step_max: Largest distance of any command from where the winches stand [m]; a command
            farther away is a fault of the controller, a nearer one is approached within the limits.
            None: `first_max` and what winches at their largest rate wind in their lag and 50 ms.
        speed_max: Largest rate asked of a winch [m/s], such as for a slow first run, beside that of
            the robot file; None: that of the robot file alone.
        range_margin: Distance of a command outside the winches' range that the limits hold back;
            beyond it is a fault [m].
        jump_max: Largest change of a length between two samples, beyond what the winch can turn
            meanwhile or was asked for; where a fault holds the winches they may not turn [m].
        following_max: Largest distance of a length from where it should be by now [m], besides
            the motion in the spread of lags (30 ms for a lag of 50 ms) and in the age of the
            sample.
        direction_max: Largest turn of a winch against its commands [m], besides the motion in the
            spread of lags and in the age of the sample. The default is twenty times the noise of
            an encoder of ``carosac``, whatever the size of the robot.
        tension_shift_max: Largest relative change since `enable` of the ratio of measured tension
            to equilibrium tension at the measured lengths; with load cells and six cables or fewer.
            None: not checked, as sway shifts tensions too; for slow runs.
        first_way: Distance from where the robot is enabled at a new home within which it is to be
            moved slowly [m]; a home is new if it changed an offset by more than `home_change_max`.
        first_speed: Largest rate of a winch on that way [m/s]: half more than that of the platform.
            It is a speed near people: the default is lower for smaller robots, and for larger ones
            no higher, 0.075 m/s.
        first_shift_max: The same as `tension_shift_max`, within `first_way` alone.
        closure_max: Largest root mean square of the lengths that no straight-line pose explains
            [m]. Sag and tilt take up to 12 mm of it on the bundled robots.
        belief_max: Largest distance of the estimated position from that of the lengths [m].
        workspace_margin: Largest distance of the platform outside the workspace box [m].
        home_change_max: Largest change of a cable's offset by homing [m], unless told that the
            robot is homed anew.
        stale_time: Time for which measurements may stay the same [s]. None: 0.08 s, or as long as
            the driver behind waits for its robot (`LinkPatience`) where that is longer.
        hang_time: Time for which a controller may keep the guard waiting while the winches move [s]
            before that is a fault; they slow down from the third period on.
        overrun_share: Largest share of missed cycles within a second.
        warm_up: Cycles after `enable` in which the winches hold whatever is asked, in real time:
            the first ones are slow, as programs load what they need.
        slack_time: Time for which a tension may be below its limit [s]; sway takes it there for
            moments.
        record_lag: Largest delay of the recording, in real time [s].
    """

    driver: str = "simulator"
    inner: Mapping[str, Any] = field(default_factory=dict)
    scene: Mapping[str, Any] = field(default_factory=dict)
    period: float = 0.01
    suite: str = "lengths"
    start_position: Point | None = None
    motion: bool = False
    enable_at_once: bool = True
    reset_at_once: bool = False
    rehearse: bool = False
    home_anew: bool = False
    home_confirmed: bool = False
    senses: SenseErrors = field(default_factory=SenseErrors)
    real_time: bool | None = None
    limits: LimitSettings = field(default_factory=lambda: LimitSettings(box=False))
    first_max: float = Scaled(0.1, "m", least=0.03, most=0.1)
    step_max: float | None = None
    speed_max: float | None = None
    range_margin: float = Scaled(0.05, "m", least=0.01, most=0.05)
    jump_max: float = Scaled(0.03, "m", least=0.01, most=0.03)
    following_max: float = Scaled(0.06, "m", least=0.02, most=0.06)
    direction_max: float = 0.004
    tension_shift_max: float | None = None
    first_way: float = Scaled(0.1, "m", least=0.01)
    first_speed: float = Scaled(0.075, "m/s", most=0.075)
    first_shift_max: float | None = 0.15
    closure_max: float = Scaled(0.03, "m", least=0.01)
    belief_max: float = Scaled(0.7, "m", least=0.05)
    workspace_margin: float = Scaled(0.3, "m", least=0.03, most=0.3)
    home_change_max: float = Scaled(0.1, "m", least=0.03, most=0.1)
    stale_time: float | None = None
    hang_time: float = 0.25
    overrun_share: float = 0.5
    warm_up: int = 5
    slack_time: float = Scaled(0.5, "s")
    record_lag: float = 2.0

    def __post_init__(self) -> None:
        """Refuse numbers that are not positive."""
        for unit, names in UNITS_OF_FIELDS.items():
            for name in names:
                if getattr(self, name) is not None or name not in NONE_ALLOWED:
                    check_positive(name, getattr(self, name), unit)
        check_whole("warm_up", self.warm_up, 0)
        if not 0.0 < self.overrun_share <= 1.0:
            raise InvalidField("overrun_share", f"{self.overrun_share}", "0 < share <= 1")
        for name in ("inner", "scene"):
            if not isinstance(getattr(self, name), Mapping):
                raise InvalidField(name, repr(getattr(self, name)), "settings by name")
        for name in self.scene:
            if name not in SCENE_SETTINGS:
                raise InvalidField(f"scene.{name}", "a name", f"one of {list(SCENE_SETTINGS)}")

    def slowed(self, robot: Robot) -> Robot:
        """Return the robot as commands must treat it: its winches no faster than `speed_max`."""
        if self.speed_max is None:
            return robot
        return replace(robot, speed_max=np.minimum(robot.speed_max, self.speed_max))

    def step(self, robot: Robot) -> Array:
        """Return the largest distance of a command from where each winch stands [m], (n,)."""
        if self.step_max is not None:
            return np.full(robot.n, self.step_max)
        late = DELAY_S + float(robot.winch_lag.max())
        return np.asarray(self.first_max + late * self.slowed(robot).speed_max)
