"""Tensions of the null space, by which weak cables are pulled taut.

A platform on more than three cables rests at one place in many attitudes, each with other tensions.
MPC holds none of these against another for long, and small errors of a plan wander among them until
a cable is slack. Tensions in the null space of the force rows of the structure matrix add no force:
they turn the platform slowly, to where weak cables pull more.

References:
    Pott, *Cable-Driven Parallel Robots*, Springer, 2018 (tension distributions).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from baselines.mpc.geometry import Geometry, excess_at, geometry_at
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot
from learned.approximate_mpc.plan_inputs import PlanInputs

# Both were chosen on forty plants of `carosac` that are in no benchmark: with twice as much of
# either, cables were slack as long.
MARGIN = 0.17  # over the least tension, in the weight per cable: below it a cable is weak
GAIN = 0.5  # of what a weak cable misses, in the time in which tensions become usual
AMPLIFICATION_MAX = 10.0  # of a projection on the null space, for cables that it hardly changes
ROUNDING = 1e-9  # of the largest shortfall: smaller changes are none


class TautCables:
    """Adds what weak cables miss to the tensions of a plan.

    A plan of changes from usual tensions follows what is added: usual tensions move at a rate.

    Attributes:
        wanted: Tensions below which a cable is weak [N], shape (n,).
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._margin = MARGIN * robot.weight / robot.n
        self.wanted: Array = robot.tension_min + self._margin

    def pull(self, inputs: PlanInputs, tension: Array, excess: Array) -> tuple[Array, Array]:
        """Return tensions [N] (n,) whose weak cables pull more, and sag less stretch [m] (n,).

        Usual tensions tell which cables are weak; those that are not do not become so, and
        tensions stay within the limits of the robot.

        Args:
            inputs: Of the plan.
            tension: Planned, within the limits [N], shape (n,).
            excess: Sag less stretch of these [m], shape (n,).
        """
        reserve = inputs.usual_tension - self.wanted
        if not reserve.min() < 0.0:
            return tension, excess
        geometry = geometry_at(self._robot, inputs.position, inputs.rotation)
        added = self._added(geometry.direction, reserve, tension)
        if not added.any():
            return tension, excess
        more = tension + added
        return more, excess + excess_change(self._robot, inputs, geometry, tension, more)

    def _added(self, direction: Array, reserve: Array, tension: Array) -> Array:
        """Return what is added [N], shape (n,).

        Args:
            direction: Of the cables in W, shape (n, 3).
            reserve: Of usual tensions over those of weak cables [N], shape (n,).
            tension: Planned [N], shape (n,).
        """
        shortfall = np.clip(-reserve, 0.0, self._margin)
        down = np.maximum(np.minimum(reserve, tension - self._robot.tension_min), 0.0)
        added = _projected(shortfall, direction, blocked=down <= 0.0)
        helped = (shortfall > 0.0) & (added > 0.0)
        if not helped.any():
            return np.zeros(len(tension))
        up = np.maximum(self._robot.tension_max - tension, 0.0)
        added *= GAIN * min(AMPLIFICATION_MAX, float((shortfall[helped] / added[helped]).min()))
        return np.asarray(share_within(added, down, up) * added)


def excess_change(
    robot: Robot, inputs: PlanInputs, geometry: Geometry, before: Array, after: Array
) -> Array:
    """Return how sag less stretch changes with tensions [m], shape (n,); 0 where no cable hangs so.

    Args:
        robot: Robot description.
        inputs: Of the plan, at whose pose the cables hang.
        geometry: There.
        before: Tensions [N], shape (n,).
        after: The same.
    """
    pose = robot, inputs.position, inputs.rotation
    change = excess_at(*pose, after, geometry) - excess_at(*pose, before, geometry)
    return np.where(np.isfinite(change), change, 0.0)


def share_within(added: Array, down: Array, up: Array) -> float:
    """Return the largest share of added tensions, at most 1, that goes no farther than they may.

    Args:
        added: [N], shape (n,).
        down: How far each may fall, from 0 on [N], shape (n,).
        up: The same of rising.
    """
    falls, gains = added < 0.0, added > 0.0
    share = np.concatenate([down[falls] / -added[falls], up[gains] / added[gains]])
    return float(share.min(initial=1.0))


def _projected(wanted: Array, direction: Array, *, blocked: NDArray[np.bool_]) -> Array:
    """Return the nearest tensions to wanted ones that add no force, and lower no blocked cable."""
    n = len(wanted)
    fixed = np.zeros(n, dtype=np.bool_)
    for _ in range(n - 3):
        rows = np.hstack([direction, np.eye(n)[:, fixed]])
        found = wanted - rows @ np.linalg.lstsq(rows, wanted, rcond=None)[0]
        found[np.abs(found) <= ROUNDING * np.abs(wanted).max()] = 0.0
        falls = blocked & (found < 0.0)
        if not falls.any():
            return np.asarray(found)
        fixed |= falls
    return np.zeros(n)
