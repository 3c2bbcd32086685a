"""Sag less stretch of what is sent: that of the plan, as fast as winches can follow it.

The tensions of a plan change from one command to the next. Were their sag and stretch sent at once,
or by a first-order filter, whose speed jumps, the winches of soft cables would be asked for more
acceleration than the plan has left them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

# Of both poles. With half of it, and with a single pole, robots were lost whose stretch takes the
# acceleration of their winches (`python -m benchmarks.any_robot`).
EXCESS_TIME = Scaled(0.3, "s")


class ExcessFilter:
    """Critically damped filter of what unstrained cables have beyond straight ones.

    Attributes:
        value: Now [m], shape (n,).
        rate: [m/s], shape (n,).
    """

    def __init__(self, robot: Robot, period: float) -> None:
        """Take the robot of n cables and the time between two commands [s]."""
        self._period = period
        self._duration = EXCESS_TIME.of(Scales(robot).ratios)
        self.reset(np.zeros(robot.n))

    def reset(self, excess: Array) -> None:
        """Begin at rest with an excess [m], shape (n,); 0 where it is NaN."""
        self.value = np.where(np.isfinite(excess), excess, 0.0)
        self.rate = np.zeros_like(self.value)

    def approach(self, excess: Array) -> None:
        """Move towards an excess [m], shape (n,); cables for which it is NaN come to rest."""
        self.take(*self.after(self.value, self.rate, self.reachable(excess) - self.value))

    def reachable(self, excess: Array) -> Array:
        """Return an excess [m], shape (n,); where it is NaN, as no cable hangs so, that of now."""
        return np.where(np.isfinite(excess), excess, self.value)

    def after(self, value: Any, rate: Any, error: Any) -> tuple[Any, Any]:
        """Return value and rate a command later, of arrays or of expressions.

        Args:
            value: Now [m], shape (n,).
            rate: [m/s], shape (n,).
            error: Of the value, to what it moves to [m], shape (n,).
        """
        share = self._period / self._duration  # backward Euler is stable for all of it
        rate = (rate + share / self._duration * error) / (1.0 + share) ** 2
        return value + self._period * rate, rate

    def take(self, value: Array, rate: Array) -> None:
        """Take a value [m] and rate [m/s] as those of now, each (n,)."""
        self.value, self.rate = value, rate
