"""Settings of the model predictive controller."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal, get_args

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.numbers import check_fields, check_positive, check_whole
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.physics.rest.tension_problem import DistributionName, check_distribution

Compiled = Literal["auto", "always", "never"]


@dataclass(frozen=True, kw_only=True)
class MpcSettings:
    """Settings of `Mpc`; numbers with a unit are those of ``carosac``, and scale with the robot.

    Weights are per second on ``carosac``; those at the end count once. By default they are larger
    where a platform turns fast on its cables (`plan_times`).

    Attributes:
        period: Time between two commands [s], which is also the first stage.
        lookahead: How far the plan reaches [s]; longer than it takes to stop the slowest sway. By
            default shorter where a platform turns so fast on its cables that the stages would be
            too long to follow that (`plan_times`).
        stages: Stages of the plan; the first lasts one period, the others share the rest.
        position_weight: Of the squared position error [1/m^2].
        velocity_weight: Of the squared velocity error [s^2/m^2].
        attitude_weight: Of the squared angle to the reference rotation, home if it has none
            [1/rad^2]; with fewer than six cables the attitude is free and this is not used.
        spin_weight: Of the squared angular velocity [s^2/rad^2]; this damps sway.
        tension_weight: Of the squared distance of the tensions from those of rest, per mean
            tension of rest.
        limit_weight: Price of one part in one by which speed, acceleration or length exceed
            their limits in the plan. Tensions are hard bounds; these are soft, as sway that is
            there already can make them impossible.
        limit_share: Share of speed and acceleration limits that the plan may use.
        jerk_max: Largest change of the acceleration of a command [m/s^3]; None: that of the
            driver's default limits.
        disturbance_time: Time constant by which an unknown acceleration is followed, where the
            belief tells the centre of mass; else four times as long [s].
        center_of_mass: By how much the centre of mass may be elsewhere than in the robot file,
            where the belief does not tell it, one standard deviation per axis [m]; 0: it is known,
            as if the belief told it.
        time_budget: Longest solve [s], by the wall clock; later ones are thrown away. None: any,
            so that runs can be repeated.
        distribution: Which tensions a robot of more than six cables is to have, as in
            `tension_distribution`; fewer than six have no choice.
        compiled: Whether the stage function is compiled: if there is a C compiler (``auto``),
            ``always`` or ``never``.
    """

    period: float = 0.02
    lookahead: float = Scaled(2.2, "s")
    stages: int = 20
    position_weight: float = Scaled(100.0, "1/m^2")
    velocity_weight: float = Scaled(10.0, "s^2/m^2")
    attitude_weight: float = 100.0
    spin_weight: float = Scaled(0.03, "s^2/rad^2")
    tension_weight: float = 0.3
    limit_weight: float = 100.0
    limit_share: float = 0.95
    jerk_max: float | None = None
    disturbance_time: float = Scaled(0.18, "s")
    center_of_mass: float = Scaled(0.02, "m")
    time_budget: float | None = None
    distribution: DistributionName = "least_squares"
    compiled: Compiled = "auto"

    def __post_init__(self) -> None:
        """Refuse numbers that make no sense."""
        check_whole("stages", self.stages, 2)
        zero = [item.name for item in fields(self) if item.name.endswith("_weight")]
        zero.append("center_of_mass")
        apart = (*zero, "stages", "distribution", "compiled", "time_budget", "jerk_max")
        positive = [item.name for item in fields(self) if item.name not in apart]
        check_fields(self, positive=positive, not_negative=zero)
        for name, unit in (("time_budget", "s"), ("jerk_max", "m/s^3")):
            if getattr(self, name) is not None:
                check_positive(name, getattr(self, name), unit)
        check_distribution(self.distribution)
        if self.compiled not in get_args(Compiled):
            raise InvalidField("compiled", repr(self.compiled), f"one of {get_args(Compiled)}")
        if not isinstance(self.lookahead, Scaled) and not self.lookahead > 2.0 * self.period:
            raise InvalidField("lookahead", f"{self.lookahead} s", "lookahead > 2 * period")
        if not self.limit_share <= 1.0:
            raise InvalidField("limit_share", repr(self.limit_share), "0 < limit_share <= 1")
