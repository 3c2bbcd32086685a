"""Tensions of the null space, by which a platform turns back to the attitude in which it rests.

A platform on more than three cables rests at one place in many attitudes, each with other tensions.
MPC plans with those of rest in mind; a network does without, as they take longer to find than its
plan. Its small errors add up in the null space of the force rows of the structure matrix: the
platform keeps the attitude to which they have turned it, and on a plant whose exit points are off
an estimate of the place shifts with it. A slow pull in that null space turns the platform back.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from baselines.mpc.geometry import geometry_at
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot
from learned.approximate_mpc.plan_inputs import PlanInputs
from learned.approximate_mpc.taut_cables import excess_change, share_within

# Of what usual tensions miss, in the time in which tensions become usual. With four times as much
# tracking is the same, and cables of `carosac` go slack as often as those of MPC, which is more.
GAIN = 0.1
MISSED_MAX = 0.25  # of the weight per cable: tensions farther from those of rest come back slower
HELD_CYCLES = 25  # for which a pull is held: it takes several times as long as a plan

RestCallback = Callable[[Array], Array | None]
"""Gives the tensions of rest [N] (n,) at a position (3,) [m]; None: there is no rest."""


class RestingAttitude:
    """A pull from usual tensions to those of rest, by their part that adds no force."""

    def __init__(
        self,
        robot: Robot,
        rest: RestCallback,
        wanted: Array,
        share: float,
        grid: Array,
        period: float,
    ) -> None:
        """Take a robot of n cables.

        Args:
            robot: Robot description.
            rest: Gives tensions of rest.
            wanted: Below which a cable is weak [N], shape (n,): the pull leaves none weak.
            share: Of the way by which tensions become usual, a cycle.
            grid: Times of a plan from now [s], shape (N + 1,).
            period: Of the cycle [s].
        """
        self._robot, self._rest_at, self._wanted = robot, rest, wanted
        self._usual_share = 1.0 - (1.0 - share) ** HELD_CYCLES  # while a pull is held
        self._missed_max = MISSED_MAX * robot.weight / robot.n
        self._ahead = int(np.abs(grid - 0.5 * HELD_CYCLES * period).argmin())
        self.reset()

    def reset(self) -> None:
        """Forget all tensions of rest; usual ones are next taken to be those of rest."""
        none: Array = np.zeros(self._robot.n)
        self._count = 0
        self._rest: Array | None = None
        self._usual_rest: Array = none
        self._pull, self._excess = none, none

    def pull(self, inputs: PlanInputs, tension: Array, excess: Array) -> tuple[Array, Array]:
        """Return tensions [N] (n,) that turn the platform back, and sag less stretch [m] (n,).

        To be called in each cycle. While a pull is held, plans may lead tensions out of the limits
        of the robot.

        Args:
            inputs: Of the plan.
            tension: Planned [N], shape (n,).
            excess: Sag less stretch of these [m], shape (n,).
        """
        if self._count % HELD_CYCLES == 0:
            self._find_rest(inputs)
            self._find_pull(inputs, tension)
        self._count += 1
        return tension + self._pull, excess + self._excess

    def _find_rest(self, inputs: PlanInputs) -> None:
        """Bring tensions of rest up to date; where there is no rest they stay."""
        if self._rest is None:
            first = self._rest_at(inputs.target[0])
            if first is None:
                return
            self._rest = self._usual_rest = first
        self._usual_rest = self._usual_rest + self._usual_share * (self._rest - self._usual_rest)
        found = self._rest_at(inputs.target[self._ahead])
        self._rest = self._rest if found is None else found

    def _find_pull(self, inputs: PlanInputs, tension: Array) -> None:
        """Find what is added in the next cycles to tensions (n,) [N] and to sag less stretch.

        Args:
            inputs: Of the plan.
            tension: Planned [N], shape (n,).
        """
        self._pull = self._excess = np.zeros(self._robot.n)
        if self._rest is None:
            return
        geometry = geometry_at(self._robot, inputs.position, inputs.rotation)
        direction, missed = geometry.direction, self._usual_rest - inputs.usual_tension
        missed = missed - direction @ np.linalg.lstsq(direction, missed, rcond=None)[0]
        pull = GAIN * missed * self._missed_max / max(self._missed_max, np.abs(missed).max())
        low, high = self._robot.tension_min, self._robot.tension_max
        down = np.minimum(inputs.usual_tension - self._wanted, tension - low)
        pull *= share_within(pull, np.maximum(down, 0.0), np.maximum(high - tension, 0.0))
        if pull.any():
            self._pull = pull
            self._excess = excess_change(self._robot, inputs, geometry, tension, tension + pull)
