"""Target of the plan: the reference at the plan's times, with the tensions of rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from baselines.lookahead import interpolated
from baselines.mpc.planner import PlanTarget
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.scaled import Scaled
from carosac_toolkit.loop.values import Pose, Reference
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.tension_problem import DistributionName, check_distribution
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

# From farther away the reference is not chased, but approached.
CHASE_DISTANCE_MAX = Scaled(0.3, "m")
APPROACH_SPEED = Scaled(0.7, "m/s")
WAY_HOME = np.linspace(0.0, 1.0, 21)[1:] ** 2  # shares of it at which a rest is looked for


class TargetReader:
    """Reads references; tensions of rest are solved for when the reference moves.

    Attributes:
        no_rest: References at which there was no rest, since the reset.
    """

    def __init__(
        self, robot: Robot, grid: Array, distribution: DistributionName = "least_squares"
    ) -> None:
        """Take the times of a plan from now [s], shape (N + 1,), and which tensions to choose."""
        check_distribution(distribution, robot.n)
        self._distribution = distribution
        self._robot, self._grid, ratios = robot, grid, Scales(robot).ratios
        self._near, self._speed = CHASE_DISTANCE_MAX.of(ratios), APPROACH_SPEED.of(ratios)
        self.reset()

    def reset(self) -> None:
        """Forget the tensions of rest."""
        self._where: Array = np.full((2, 3), np.nan)
        self._tension: Array | None = None
        self._found = np.zeros(2, dtype=np.bool_)
        self.no_rest = 0

    def at(self, position: Array) -> Array:
        """Return tensions of rest at a position (3,) [N], shape (n,).

        Where there is none, they are as `rests` has them.
        """
        return np.asarray(self._rest(np.stack([position, position]))[0])

    def rest_at(self, position: Array) -> Array | None:
        """Return tensions of rest at a position (3,) [N], shape (n,); None: there is no rest."""
        tension = self.at(position)
        return tension if self._found.all() else None

    def read(self, reference: Reference) -> PlanTarget:
        """Interpolate the reference between its rows; hold the last row beyond them."""
        when, rows = reference.time[0, 0] + self._grid, reference.time[0]
        position, velocity = (
            interpolated(when[None], reference.time, values)[0]
            for values in (reference.position, reference.velocity)
        )
        rotation = None
        if self._robot.n >= 6:
            rotation = np.broadcast_to(self._robot.home_rotation, (len(when), 3, 3))
            if reference.rotation is not None:
                nearest = np.abs(when[:, None] - rows).argmin(axis=1)
                rotation = reference.rotation[0, nearest]
        first, last = self._rest(position[[0, -1]])
        share = (self._grid[:-1] / self._grid[-1])[:, None]
        tension = (1.0 - share) * first + share * last
        return PlanTarget(position=position, velocity=velocity, rotation=rotation, tension=tension)

    def nearer(self, target: PlanTarget, position: Array) -> PlanTarget:
        """Return the target itself, or a slow way there from where the platform is.

        Args:
            target: As read.
            position: Of the platform now in W [m], shape (3,).
        """
        if float(np.linalg.norm(position - target.position[0])) <= self._near:
            return target
        way, here = [position], position
        for goal, step in zip(target.position[1:], np.diff(self._grid), strict=True):
            left = goal - here
            here = here + left * min(
                1.0, self._speed * step / max(float(np.linalg.norm(left)), 1e-9)
            )
            way.append(here)
        places = np.array(way)
        velocity = np.diff(places, axis=0) / np.diff(self._grid)[:, None]
        velocity = np.vstack([velocity, velocity[-1:]])
        return replace(target, position=places, velocity=velocity, calm=True)

    def _rest(self, ends: Array) -> Array:
        """Return the tensions of rest at both positions [N], shape (2, n)."""
        if self._tension is None or not np.array_equal(self._where, ends):
            self._where = ends
            self._tension, self._found = rests(self._robot, ends, self._tension, self._distribution)
            self.no_rest += int((~self._found).sum())
        return self._tension


def rests(
    robot: Robot, places: Array, last: Array | None,
    distribution: DistributionName = "least_squares",
) -> tuple[Array, NDArray[np.bool_]]:  # fmt: skip
    """Return the tensions of rest at some places [N] (K, n), and where there are any, (K,).

    Elsewhere they are the last ones. At first there are none: then they are those of the first
    rest on the way home, and without any equal shares of the weight.

    Args:
        robot: Of n cables.
        places: Of the platform in W [m], shape (K, 3).
        last: The last ones [N], shape (K, n).
        distribution: Which tensions to choose.
    """
    guess = None
    if robot.n < 6:
        guess = Pose(position=places, rotation=np.tile(robot.home_rotation, (len(places), 1, 1)))
    rest = statics.inverse_kinematics(robot, places, guess=guess, distribution=distribution)
    tension, found = rest.tension.copy(), rest.converged
    if last is not None:
        tension[~found] = last[~found]
    elif not found.all():
        tension[~found] = _on_the_way_home(robot, places[~found], distribution)
    return tension, found


def _on_the_way_home(robot: Robot, places: Array, distribution: DistributionName) -> Array:
    """Return the tensions (K, n) [N] of the first rest on the way home from places (K, 3)."""
    way = places[:, None] + WAY_HOME[:, None] * (robot.home_position - places)[:, None]
    rest = statics.inverse_kinematics(robot, way.reshape(-1, 3), distribution=distribution)
    found = rest.converged.reshape(way.shape[:2])
    tension = rest.tension.reshape(*way.shape[:2], robot.n)
    first = tension[np.arange(len(places)), found.argmax(axis=1)]
    equal = np.clip(robot.weight / robot.n, robot.tension_min, robot.tension_max)
    return np.asarray(np.where(found.any(axis=1, keepdims=True), first, equal))
