"""Straight and hanging cables at one pose, from the toolkit's physics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.loop.values import Belief
from carosac_toolkit.physics.cable.lengths import length_at_tension
from carosac_toolkit.physics.cable.straight_line import straight_length
from carosac_toolkit.robot.robot import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class Geometry:
    """The n cables at one pose, straight.

    Attributes:
        length: Datum to anchor point, wrapped arc included [m], shape (n,).
        jacobian: Of the lengths by the twist (linear first, in W, at the origin), shape (n, 6).
        exits: Where the free part begins, in W [m], shape (n, 3).
        free: Length of the free part [m], shape (n,).
        direction: From there to the anchor point, shape (n, 3).
        valid: Whether all cables exist.
    """

    length: Array
    jacobian: Array
    exits: Array
    free: Array
    direction: Array
    valid: bool


class NoStart(CarosacError):
    """A belief at which the cables cannot be, so that no command can begin there."""


def start_geometry(robot: Robot, position: Array, rotation: Array, *, name: str) -> Geometry:
    """Return straight cables at the pose where a controller starts; see `geometry_at`.

    Raises:
        NoStart: No cables can reach there; `name` is that of the controller.
    """
    geometry = geometry_at(robot, position, rotation)
    low, high = robot.length_min, robot.length_max
    if not (geometry.valid and ((geometry.length > low) & (geometry.length < high)).all()):
        raise NoStart(
            f"{name}: position {position.round(4)} m: cables of {geometry.length.round(3)} m; "
            f"allowed: {low.round(3)} to {high.round(3)} m, outside pulleys"
        )
    return geometry


def first_excess(robot: Robot, belief: Belief, geometry: Geometry, rest: Array) -> Array:
    """Return sag less stretch where a controller starts [m], shape (n,).

    With more cables than six, the believed tensions may be others than those of rest.

    Args:
        robot: Robot description, n cables.
        belief: Of one robot.
        geometry: There.
        rest: Tensions of rest along the chords [N], shape (n,).

    Returns:
        NaN where a cable cannot hang.
    """
    position, rotation = belief.position[0], belief.rotation[0]
    excess = excess_at(robot, position, rotation, rest, geometry)
    if belief.tension is not None:
        told = excess_under(robot, position, rotation, belief.tension[0], geometry)
        excess = np.where(np.isfinite(told), told, excess)
    return excess


def geometry_at(robot: Robot, position: Array, rotation: Array) -> Geometry:
    """Return straight cables at a pose.

    Args:
        robot: Robot description, n cables.
        position: Platform origin in W [m], shape (3,).
        rotation: From P to W, shape (3, 3).
    """
    cables = straight_length(robot, position[None], rotation[None])
    length, direction = cables.length[0], cables.direction[0]
    arm = robot.anchor_points @ rotation.T
    free = length - robot.pulley_radius * cables.wrap[0]
    return Geometry(
        length=length,
        jacobian=np.hstack([direction, np.cross(arm, direction)]),
        exits=position + arm - free[:, None] * direction,
        free=free,
        direction=direction,
        valid=bool(cables.valid[0].all()) and bool((free > 1e-6).all()),
    )


def excess_at(
    robot: Robot, position: Array, rotation: Array, tension: Array, geometry: Geometry
) -> Array:
    """Return what unstrained cables have beyond straight ones: sag less stretch [m].

    Args:
        robot: Robot description, n cables.
        position: Platform origin in W [m], shape (3,).
        rotation: From P to W, shape (3, 3).
        tension: Along the chord of each cable [N], shape (n,).
        geometry: At the same pose.

    Returns:
        Shape (n,); NaN where the cable is too slack to hang there.
    """
    pull = -tension[:, None] * geometry.direction
    pull[:, 2] -= 0.5 * robot.weight_per_length * geometry.free
    return excess_under(robot, position, rotation, np.linalg.norm(pull, axis=1), geometry)


def excess_under(
    robot: Robot, position: Array, rotation: Array, tension: Array, geometry: Geometry
) -> Array:
    """Return the same as `excess_at` for tensions at the platform [N], shape (n,)."""
    cables = length_at_tension(robot, position[None], rotation[None], tension[None])
    return np.asarray(cables.unstrained_length[0] - geometry.length)
