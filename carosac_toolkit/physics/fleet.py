"""Several robots of one kind, one for each row of a batch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.robot.robot import Robot


class Fleet:
    """Robots with the same number of cables and the same gravity, whose numbers may differ.

    Stands for one robot in the physics at rest where each row of the batch has its own. Its
    attributes are those of `Robot`, stacked along a first axis.

    Attributes:
        robots: The robots.
        n: Number of cables of each.
        gravity: [m/s^2].
        mass: [kg], shape (B,).
        weight: [N], shape (B,).
        center_of_mass: In P [m], shape (B, 3).
        inertia: About the centre of mass, axes of P [kg m^2], shape (B, 3, 3).
        anchor_points: In P [m], shape (B, n, 3).
        run_length: [m], shape (B, n).
        linear_density: [kg/m], shape (B, n).
        axial_stiffness: [N], shape (B, n).
        tension_min: [N], shape (B, n).
        length_min: [m], shape (B, n).
        length_max: [m], shape (B, n).
        home_position: In W [m], shape (B, 3).
        home_rotation: From P to W, shape (B, 3, 3).
    """

    def __init__(self, robots: Sequence[Robot]) -> None:
        """Stack the robots.

        Raises:
            InvalidField: No robots, or robots that are too different.
        """
        self.robots = tuple(robots)
        if not self.robots or not all(isinstance(robot, Robot) for robot in self.robots):
            kinds = [type(robot).__name__ for robot in self.robots]
            raise InvalidField("robots", kinds, "at least one Robot, and nothing else")
        first = self.robots[0]
        for i, robot in enumerate(self.robots):
            if robot.n != first.n:
                raise InvalidField(f"robots[{i}]", f"{robot.n} cables", f"{first.n}, as robots[0]")
            if robot.gravity != first.gravity:
                allowed = f"{first.gravity} m/s^2, as robots[0]"
                raise InvalidField(f"robots[{i}].gravity", f"{robot.gravity} m/s^2", allowed)
        self.n = first.n
        self.gravity = first.gravity
        self.mass = self._stacked("mass")
        self.weight = self.mass * self.gravity
        self.center_of_mass = self._stacked("center_of_mass")
        self.inertia = self._stacked("inertia")
        self.anchor_points = self._stacked("anchor_points")
        self.run_length = self._stacked("run_length")
        self.linear_density = self._stacked("linear_density")
        self.axial_stiffness = self._stacked("axial_stiffness")
        self.tension_min = self._stacked("tension_min")
        self.length_min = self._stacked("length_min")
        self.length_max = self._stacked("length_max")
        self.home_position = self._stacked("home_position")
        self.home_rotation = self._stacked("home_rotation")

    def __len__(self) -> int:
        return len(self.robots)

    def rows(self, which: NDArray[Any]) -> Fleet:
        """Return the robots of some rows; a fleet of one serves them all."""
        if len(self) == 1 or np.array_equal(which, np.arange(len(self))):
            return self
        return Fleet([self.robots[int(i)] for i in which])

    def _stacked(self, name: str) -> Array:
        """Stack one field of all robots."""
        values: list[ArrayLike] = [getattr(robot, name) for robot in self.robots]
        return np.array(values, dtype=np.float64)
