"""Paths of robots with two cables, which can rest on a surface only."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.robot.sizes import SURFACE_CABLES, cable_size
from carosac_toolkit.trajectories.curves import Curve
from carosac_toolkit.trajectories.trajectory import Trajectory

SAMPLES = 60  # positions of the path that are moved to their nearest rest


@dataclass(frozen=True, kw_only=True, eq=False)
class FlatCurve:
    """A curve projected onto a plane.

    Attributes:
        curve: The curve in space.
        normal: Unit normal of the plane in W, shape (3,).
        point: A point of the plane in W [m], shape (3,).
    """

    curve: Curve
    normal: Array
    point: Array

    @property
    def breaks(self) -> Array:
        """Times at which smooth pieces meet [s]."""
        return self.curve.breaks

    def derivatives(self, time: Array) -> Array:
        """Evaluate position and three derivatives, shape (K, 4, 3); see `Curve`."""
        values = self.curve.derivatives(time).copy()
        values[:, 0] -= self.point
        values -= (values @ self.normal)[..., None] * self.normal
        values[:, 0] += self.point
        return values


def onto_rest(robot: Robot, trajectory: Trajectory) -> Trajectory:
    """Move a trajectory onto positions at which the robot can rest.

    Args:
        robot: Robot description; with more than two cables the trajectory stays as it is.
        trajectory: The wanted one.

    Returns:
        The moved trajectory; its `moved` is the longest way of a position.

    Raises:
        InvalidField: No rest near the path, or the positions of rest are not in a plane.
    """
    if robot.n != SURFACE_CABLES:
        return trajectory
    from carosac_toolkit.physics.rest.nearest import PLANE_SHARE, nearest_rest, plane_of_rest

    curve = trajectory.curve
    wanted = curve.derivatives(np.linspace(0.0, float(curve.breaks[-1]), SAMPLES))[:, 0]
    nearest = nearest_rest(robot, wanted)
    rest = nearest.equilibrium
    if not rest.converged.all():
        k = int(np.argmin(rest.converged))
        raise InvalidField(f"trajectory {trajectory.name}", wanted[k], "positions near a rest")
    normal, point = plane_of_rest(robot, rest.position)
    moved = float(nearest.distance.max())
    if moved <= PLANE_SHARE * cable_size(robot):
        moved = 0.0
    flat = FlatCurve(curve=curve, normal=normal, point=point)
    return replace(trajectory, curve=flat, points=None, moved=moved)
