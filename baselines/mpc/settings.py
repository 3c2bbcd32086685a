"""Settings of the model predictive controller."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal, get_args

import numpy as np

from carosac_toolkit.base.errors import InvalidField

Compiled = Literal["auto", "always", "never"]


@dataclass(frozen=True, kw_only=True)
class MpcSettings:
    """Settings of `Mpc`; all weights are per second, those at the end count once.

    Attributes:
        period: Time between two commands [s], which is also the first stage.
        lookahead: How far the plan reaches [s]; longer than it takes to stop the slowest sway.
        stages: Stages of the plan; the first lasts one period, the others share the rest.
        position_weight: Of the squared position error [1/m^2].
        velocity_weight: Of the squared velocity error [s^2/m^2].
        attitude_weight: Of the squared angle to the reference rotation, home if it has none
            [1/rad^2]; with fewer than six cables the attitude is free and this is not used.
        spin_weight: Of the squared angular velocity [s^2/rad^2]; this damps sway.
        tension_weight: Of the squared distance of the tensions from those of rest, per mean
            tension of rest.
        taut: Least tension in the plan, in weights of the cable, where half of the tension of rest
            and the robot's `tension_min` allow it; below it, sag changes length more than motion.
        end_factor: Weights of the last state over those under way [s].
        limit_weight: Price of one part in one by which speed, acceleration or length exceed
            their limits in the plan. Tensions are hard bounds; these are soft, as sway that is
            there already can make them impossible.
        limit_share: Share of speed and acceleration limits that the plan may use.
        jerk_max: Largest change of the acceleration of a command [m/s^3]; as in the driver's
            `LimitSettings`.
        offset_time: Time constant of the estimate of length offsets [s].
        offset_max: Largest offset that is kept [m]; what exceeds it is slack, and reeled in.
        disturbance_time: Time constant by which an unknown acceleration is followed, where the
            belief tells the centre of mass; else four times as long [s].
        center_of_mass: By how much the centre of mass may be elsewhere than in the robot file,
            where the belief does not tell it, one standard deviation per axis [m]; 0: it is known,
            as if the belief told it.
        excess_time: Time constant by which sag and stretch of the plan reach the command [s]; short
            ones shake cables that hang loosely, as their sag changes much with little tension.
        twist_gain: Share of a position difference that becomes velocity where beliefs have no
            twist.
        belief_gate: Largest distance between believed and predicted cable lengths [m]; beyond it
            the belief is not used, and cables are so slack that the plan is given up.
        shifted_steps: Steps for which the last plan goes on after a failed solve.
        time_budget: Longest solve [s], by the wall clock; later ones are thrown away. None: any,
            so that runs can be repeated.
        compiled: Whether the stage function is compiled: if there is a C compiler (``auto``),
            ``always`` or ``never``.
    """

    period: float = 0.02
    lookahead: float = 2.2
    stages: int = 20
    position_weight: float = 100.0
    velocity_weight: float = 10.0
    attitude_weight: float = 100.0
    spin_weight: float = 0.03
    tension_weight: float = 0.3
    taut: float = 4.0
    end_factor: float = 1.0
    limit_weight: float = 100.0
    limit_share: float = 0.95
    jerk_max: float = 200.0
    offset_time: float = 0.5
    offset_max: float = 0.1
    disturbance_time: float = 0.18
    center_of_mass: float = 0.02
    excess_time: float = 0.3
    twist_gain: float = 0.2
    belief_gate: float = 0.2
    shifted_steps: int = 5
    time_budget: float | None = None
    compiled: Compiled = "auto"

    def __post_init__(self) -> None:
        """Refuse numbers that make no sense."""
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name == "compiled" or (item.name == "time_budget" and value is None):
                continue
            number = isinstance(value, int | float) and not isinstance(value, bool)
            zero = item.name.endswith(("_weight", "_steps")) or item.name == "center_of_mass"
            lowest = 0.0 if zero else None
            good = number and (value >= 0.0 if lowest == 0.0 else value > 0.0) and value < np.inf
            if not good:
                sign = ">=" if lowest == 0.0 else ">"
                raise InvalidField(item.name, repr(value), f"{item.name} {sign} 0, finite")
        for name in ("stages", "shifted_steps"):
            if not isinstance(getattr(self, name), int):
                raise InvalidField(name, repr(getattr(self, name)), "a whole number")
        if self.compiled not in get_args(Compiled):
            raise InvalidField("compiled", repr(self.compiled), f"one of {get_args(Compiled)}")
        if self.stages < 2 or not self.lookahead > self.period * 2:
            got = f"{self.lookahead} s in {self.stages} stages"
            raise InvalidField("lookahead", got, "two stages or more, over two periods")
        if not self.limit_share <= 1.0 or not self.twist_gain <= 1.0:
            raise InvalidField("limit_share, twist_gain", "more than 1", "0 < share <= 1")
