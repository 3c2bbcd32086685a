"""Settings of a guided self-calibration."""

from __future__ import annotations

from dataclasses import dataclass

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.numbers import check_positive, check_whole


@dataclass(frozen=True, kw_only=True)
class GuideSettings:
    """How a guided robot moves, and when it is done.

    Attributes:
        accuracy: Wanted standard deviation of the exit points, the mean of their distances from
            the truth, without turns of the whole robot about home [m].
        max_samples: Samples after which the guide gives up, home included.
        checks: Moves that are predicted before they are made.
        speed: Largest speed of the platform [m/s].
        acceleration: Largest acceleration of the platform [m/s^2].
        period: Time between two commands [s].
        settle_time: Time at rest before a sample [s].
        sample_time: Time over which a sample is averaged [s].
        first_reach: Distance of the first move, as a share of the longest cable [1].
        reach_growth: Ratio of the distance of the next move to the largest distance from home
            that was visited [1].
    """

    accuracy: float = 5e-3
    max_samples: int = 60
    checks: int = 10
    speed: float = 0.1
    acceleration: float = 0.2
    period: float = 0.02
    settle_time: float = 0.5
    sample_time: float = 0.5
    first_reach: float = 0.1
    reach_growth: float = 1.0

    def __post_init__(self) -> None:
        """Refuse numbers that are not positive."""
        units = {
            "accuracy": "m", "speed": "m/s", "acceleration": "m/s^2", "period": "s",
            "settle_time": "s", "sample_time": "s", "first_reach": "", "reach_growth": "",
        }  # fmt: skip
        for name, unit in units.items():
            check_positive(name, getattr(self, name), unit)
        check_whole("max_samples", self.max_samples, 2)
        check_whole("checks", self.checks, 0)
        if self.sample_time < self.period:
            allowed = f">= {self.period:g} s, the time between two commands"
            raise InvalidField("sample_time", f"{self.sample_time:g} s", allowed)
