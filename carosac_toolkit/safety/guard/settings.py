"""What the guard allows: numbers of every check, and which driver stands behind it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.numbers import check_positive, check_whole
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.safety.limiter import LimitSettings

STALE = 0.08  # [s]
BEHIND = 0.1  # [s] that winches may lag behind: 50 ms of their own, network, sampling, a period
Point = tuple[float, float, float]
_METRES = (
    "first_max", "range_margin", "jump_max", "following_max", "direction_max", "closure_max",
    "belief_max", "workspace_margin", "rest_max", "home_change_max",
)  # fmt: skip
_SECONDS = (
    "period",
    "hang_time",
    "hang_time_at_rest",
    "stop_time_max",
    "lasting",
    "slack_time",
    "record_lag",
)


@dataclass(frozen=True, kw_only=True)
class GuardSettings:
    """Settings of `carosac_toolkit.safety.guard.guard.GuardedDriver`.

    Attributes:
        driver: Name of the driver behind the guard, or ``module:Class``.
        inner: Settings of that driver by name, a mapping for each settings dataclass inside them.
        period: Time between two commands [s].
        suite: Sensor suite of a driver that has a choice.
        start_position: The pose by which `enable_at_once` homes, and where a simulated robot is set
            down, in W [m]; None is the home position. A PLC is not told of it, unless `set_down`.
        set_down: Whether an emulated PLC clears its fault and sets its robot down at
            `start_position`, as for each case of a study. A real one cannot: its platform has to be
            there, and people look at its faults.
        motion: Whether anything may move; else a run is dry: commands are limited and journaled,
            and not sent.
        enable_at_once: Home and enable in `connect`, where motion is allowed; else it is up to
            calls of `home` and `enable`.
        reset_at_once: Whether `connect` clears a fault that the driver behind holds from an earlier
            run, where motion is allowed; one whose cause remains stays.
        rehearse: Whether a dry run homes at `start_position` in `connect` too, and refuses what
            `enable` would; offsets are numbers of this host, and no drive hears of it.
        home_anew: Whether `enable_at_once` may change offsets by more than `home_change_max`.
        real_time: Whether the driver's time is that of the wall; a simulator then waits for it.
            None: True for drivers that have no such setting, which are real, else False.
        wind_force: Of the wind, for a driver that has some [N].
        wind_time: Its correlation time [s].
        limits: Of the commands; the box is judged by the pose instead (`workspace_margin`).
        first_max: Largest distance of the first command from where the winches stand [m].
        step_max: Largest distance of any command from where the winches stand [m]; a command
            farther away is a fault of the controller, a nearer one is approached within the limits.
            None: `first_max` and what winches at their largest rate lag behind in 0.1 s.
        speed_max: Largest rate that is asked of a winch [m/s], such as for a slow first run; None:
            that of the robot file, which holds as well.
        range_margin: How far a command may lie outside the lengths of the winches [m]; the limits
            hold it back.
        jump_max: Largest change of a length between two samples, beyond what the winch can turn
            meanwhile or was asked for; where a fault holds the winches they may not turn [m].
        following_max: Largest distance of a length from where it should be by now [m], besides
            the motion of 30 ms and of the age of the sample.
        direction_max: How far a winch may turn the other way than it was told to [m], besides the
            motion of 30 ms and of the age of the sample.
        tension_shift_max: By how much the share of the measured tension in the one that belongs to
            the lengths at rest may differ from its value at `enable`; with load cells and six
            cables or fewer. None: not looked at, as sway shifts tensions too; for slow runs.
        closure_max: Largest root mean square of the lengths that no straight-line pose explains
            [m]. Sag and tilt take up to 12 mm of it on the bundled robots.
        belief_max: Largest distance of the believed position from that of the lengths [m].
        workspace_margin: How far the platform may leave the workspace box [m].
        rest_max: Largest change of the lengths over the samples that count as standing still [m].
        home_change_max: Largest change of the offset of a cable by homing, unless it is told that
            the robot is homed anew [m].
        stale_time: How long measurements may stay the same [s]. None: as long as the driver behind
            waits for its robot (`lost_after`) where it says so, else `STALE`.
        hang_time: How long a controller may keep the guard waiting while the winches move [s]
            before that is a fault; they slow down from the third period on.
        hang_time_at_rest: The same while they stand still, such as in the first cycle [s].
        stop_time_max: When a stop is given up [s].
        overrun_share: Largest share of missed cycles within a second.
        warm_up: Cycles after `enable` in which the winches hold whatever is asked, in real time:
            the first ones are slow, as programs load what they need.
        lasting: How long following error, closure, too much tension, or leaving the workspace must
            last to count [s].
        slack_time: How long a tension may be below its limit [s]; sway takes it there for moments.
        record_lag: How far the recording may be behind, in real time [s].
        homing_samples: Samples of which the mean is homed.
    """

    driver: str = "simulator"
    inner: Mapping[str, Any] = field(default_factory=dict)
    period: float = 0.01
    suite: str = "lengths"
    start_position: Point | None = None
    set_down: bool = False
    motion: bool = False
    enable_at_once: bool = True
    reset_at_once: bool = False
    rehearse: bool = False
    home_anew: bool = False
    real_time: bool | None = None
    wind_force: float = 0.0
    wind_time: float = 2.0
    limits: LimitSettings = field(default_factory=lambda: LimitSettings(box=False))
    first_max: float = 0.1
    step_max: float | None = None
    speed_max: float | None = None
    range_margin: float = 0.05
    jump_max: float = 0.03
    following_max: float = 0.06
    direction_max: float = 0.004
    tension_shift_max: float | None = None
    closure_max: float = 0.03
    belief_max: float = 0.7
    workspace_margin: float = 0.3
    rest_max: float = 0.003
    home_change_max: float = 0.1
    stale_time: float | None = None
    hang_time: float = 0.25
    hang_time_at_rest: float = 10.0
    stop_time_max: float = 5.0
    overrun_share: float = 0.5
    warm_up: int = 5
    lasting: float = 0.03
    slack_time: float = 0.5
    record_lag: float = 2.0
    homing_samples: int = 10

    def __post_init__(self) -> None:
        """Refuse numbers that are not positive."""
        for name in _METRES:
            check_positive(name, getattr(self, name), "m")
        for name in _SECONDS:
            check_positive(name, getattr(self, name), "s")
        for name, unit in (("step_max", "m"), ("speed_max", "m/s"), ("stale_time", "s"),
                           ("tension_shift_max", "")):  # fmt: skip
            if getattr(self, name) is not None:
                check_positive(name, getattr(self, name), unit)
        check_whole("homing_samples", self.homing_samples, 1)
        check_whole("warm_up", self.warm_up, 0)
        if not 0.0 < self.overrun_share <= 1.0:
            raise InvalidField("overrun_share", f"{self.overrun_share}", "0 < share <= 1")
        if not isinstance(self.inner, Mapping):
            raise InvalidField("inner", repr(self.inner), "settings by name")

    def slowed(self, robot: Robot) -> Robot:
        """The robot as commands must treat it: its winches no faster than `speed_max`."""
        if self.speed_max is None:
            return robot
        return replace(robot, speed_max=np.minimum(robot.speed_max, self.speed_max))

    def step(self, robot: Robot) -> Array:
        """Largest distance of a command from where each winch stands [m], shape (n,)."""
        if self.step_max is not None:
            return np.full(robot.n, self.step_max)
        return np.asarray(self.first_max + BEHIND * self.slowed(robot).speed_max)
